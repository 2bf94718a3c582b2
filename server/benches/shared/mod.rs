//! Pictures of moving roundels, and the processor time of this process.

use std::fs;

pub const SIZE: (usize, usize) = (1280, 720);
pub const ROUNDELS: usize = 20;
/// Outer diameter in the picture.
const DIAMETER_PX: f64 = 30.0;
/// Frames after which all roundels are back at their first position.
pub const ROUND: usize = 60;
/// Radius of each roundel's circular path: 31 px/s at most.
const PATH_PX: f64 = 10.0;
/// Clock ticks in `/proc/self/stat`, equal on all common Linux systems.
const TICKS_PER_S: f64 = 100.0;

/// Draws roundels on a grid, each moving on a circle, with a little noise.
pub fn draw(number: usize) -> Vec<u8> {
    let turn = std::f64::consts::TAU * number as f64 / ROUND as f64;
    let centers: Vec<(f64, f64)> = (0..ROUNDELS)
        .map(|index| {
            let (column, row) = (index % 5, index / 5);
            let (sin, cos) = (turn + index as f64).sin_cos();
            let (u, v) = (128.0 + 256.0 * column as f64, 90.0 + 180.0 * row as f64);
            (u + PATH_PX * cos, v + PATH_PX * sin)
        })
        .collect();
    let (outer, inner) = (0.5 * DIAMETER_PX, 0.2 * DIAMETER_PX);
    let mut noise = 0x9e37_79b9_u32.wrapping_mul(number as u32 + 1) | 1;
    let mut pixels = Vec::with_capacity(SIZE.0 * SIZE.1);
    for v in 0..SIZE.1 {
        for u in 0..SIZE.0 {
            // Xorshift, for reproducible noise of about 2 grey levels.
            noise ^= noise << 13;
            noise ^= noise >> 17;
            noise ^= noise << 5;
            let (column, row) = ((u / 256).min(4), (v / 180).min(3));
            let (center_u, center_v) = centers[row * 5 + column];
            let radius = (u as f64 - center_u).hypot(v as f64 - center_v);
            let within = |rim: f64| (rim - radius + 0.5).clamp(0.0, 1.0);
            let level = 210.0 - 180.0 * (within(outer) - within(inner));
            pixels.push((level + f64::from(noise % 7) - 3.0).round() as u8);
        }
    }
    pixels
}

/// Processor time of this process, seconds.
pub fn processor_s() -> f64 {
    let line = fs::read_to_string("/proc/self/stat").expect("Linux' /proc/self/stat");
    // Fields are counted after the name, which may contain anything: utime and stime are the 14th and 15th.
    let fields = line.rsplit(')').next().unwrap_or_default().split_whitespace();
    let ticks: f64 = fields.skip(11).take(2).filter_map(|field| field.parse::<f64>().ok()).sum();
    ticks / TICKS_PER_S
}
