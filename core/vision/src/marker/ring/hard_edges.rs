//! Pictures without blur: simulators without anti-aliasing, drawings, pixels that are repeated to enlarge a picture.
//!
//! Their edges are staircases, which deviate from an ellipse by up to half a pixel, or by a whole one where pixels are
//! doubled. Over two pixels across an edge, with the differences a and b, (a² + b²)/(a + b)² is 1/2 for a smooth edge
//! and 1 for a staircase; anti-aliasing alone brings it to 0.8, a blur of 0.5 px to 0.66. Such a window is softened,
//! which averages over steps, and measured again.

use crate::frame::{Frame, Window};

/// Smallest quotient of the squares for a staircase.
const HARD: f64 = 0.9;
/// Differences below this share of the contrast are not edges.
const EDGE_SHARE: f64 = 0.25;
/// Only one of this many rows is looked at.
const EVERY: usize = 3;
/// The kernel, and the variance that it adds, px².
const KERNEL: [u32; 5] = [1, 4, 6, 4, 1];
const SCALE: u32 = 16;
pub(crate) const SOFTENING_PX2: f64 = 1.0;

/// Whether the edges in a window are staircases.
pub(crate) fn are_hard(frame: &Frame, window: &Window, contrast: f64) -> bool {
    let least = (EDGE_SHARE * contrast).ceil() as i32;
    let (mut parts, mut wholes) = (0u64, 0u64);
    let mut add = |first: u8, second: u8, third: u8| {
        let (a, b) = (i32::from(second) - i32::from(first), i32::from(third) - i32::from(second));
        if (a + b).abs() >= least {
            parts += (a * a + b * b) as u64;
            wholes += ((a + b) * (a + b)) as u64;
        }
    };
    for v in (window.top..window.bottom).step_by(EVERY) {
        let row = &frame.row(v)[window.left..window.right];
        row.windows(3).for_each(|three| add(three[0], three[1], three[2]));
        if v + 2 < window.bottom {
            let [below, last] = [v + 1, v + 2].map(|v| &frame.row(v)[window.left..window.right]);
            row.iter().zip(below).zip(last).for_each(|((&a, &b), &c)| add(a, b, c));
        }
    }
    wholes > 0 && parts as f64 >= HARD * wholes as f64
}

/// Writes the softened window to `softened`, row by row. Beyond the frame its last pixels are repeated.
pub(crate) fn soften(frame: &Frame, window: &Window, softened: &mut Vec<u8>) {
    softened.clear();
    let near = |place: usize, by: usize, size: usize| (place + by).saturating_sub(2).min(size - 1);
    for v in window.top..window.bottom {
        let rows: [&[u8]; KERNEL.len()] =
            std::array::from_fn(|by| frame.row(near(v, by, frame.height())));
        let down = |u: usize| -> u32 {
            rows.iter().zip(KERNEL).map(|(row, weight)| weight * u32::from(row[u])).sum()
        };
        for u in window.left..window.right {
            let sum: u32 = (0..)
                .zip(KERNEL)
                .map(|(by, weight)| weight * down(near(u, by, frame.width())))
                .sum();
            softened.push(((sum + SCALE * SCALE / 2) / (SCALE * SCALE)) as u8);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disc of 12 px, blurred, and each pixel repeated.
    fn disc(blur_px: f64, repeated: usize) -> Vec<u8> {
        let level = |u: usize, v: usize| {
            let r = (u as f64 - 20.3).hypot(v as f64 - 19.8);
            let share = if blur_px > 0.0 {
                1.0 / (1.0 + ((r - 12.0) / (0.6 * blur_px)).exp())
            } else {
                f64::from(r < 12.0)
            };
            (200.0 - 160.0 * share).round() as u8
        };
        let side = 40 * repeated;
        (0..side * side).map(|at| level(at % side / repeated, at / side / repeated)).collect()
    }

    fn is_hard(pixels: &[u8]) -> bool {
        let side = pixels.len().isqrt();
        let frame = Frame::new(pixels, side, side, side).unwrap();
        are_hard(&frame, &Window::of(&frame), 160.0)
    }

    #[test]
    fn staircases_are_hard_and_blurred_edges_are_not() {
        assert!(is_hard(&disc(0.0, 1)));
        assert!(is_hard(&disc(0.7, 2)));
        assert!(is_hard(&disc(0.0, 2)));
        assert!(!is_hard(&disc(0.5, 1)));
        assert!(!is_hard(&disc(1.0, 1)));
        assert!(!is_hard(&[7; 1600]));
    }

    #[test]
    fn softening_keeps_even_light_and_blurs_an_edge() {
        let pixels: Vec<u8> = (0..400).map(|at| if at % 20 < 10 { 16 } else { 32 }).collect();
        let frame = Frame::new(&pixels, 20, 20, 20).unwrap();
        let window = Window { left: 6, top: 0, right: 14, bottom: 3 };
        let mut softened = Vec::new();
        soften(&frame, &window, &mut softened);
        assert_eq!(softened.len(), 24);
        assert_eq!(softened[..8], [16, 16, 17, 21, 27, 31, 32, 32]);
        assert_eq!(softened[16..], softened[..8]);
    }
}
