//! Throughput of fusion: `cargo bench -p roundel-core --bench fusion`.
//!
//! One iteration is one frame set: a frame of every camera, and the snapshot after it. The world is that of
//! `tests/fusion`: R4 with 24 objects, and 64 objects observed by 8 cameras at 100 Hz, synchronized and in order, then
//! 0 to 40 ms late.

use criterion::{Criterion, criterion_group, criterion_main};
use roundel_core::{
    id::CameraId,
    world::{Fusion, FusionParams},
};

// The tests use more of it.
#[allow(dead_code)]
#[path = "../tests/fusion/arena.rs"]
mod arena;
use arena::{Arena, Setting};

const SECONDS: f64 = 4.0;

fn fusion(criterion: &mut Criterion) {
    let r4 = Setting { rate_hz: 60.0, random: true, ..Setting::default() };
    let many = Setting {
        objects: 64,
        cameras: 8,
        rate_hz: 100.0,
        unsynchronized: false,
        jitter_s: 0.0,
        noise_px: 0.5,
        clutter: 0.1,
        ..r4
    };
    let late = Setting { unsynchronized: true, jitter_s: 0.02, ..many };
    for (name, setting) in [
        ("R4: 24 objects, 4 cameras", r4),
        ("64 objects, 8 cameras", many),
        ("64 objects, 8 cameras, 0 to 40 ms late", late),
    ] {
        let arena = Arena::new(setting);
        let frames = arena.frames(SECONDS);
        criterion.bench_function(&format!("fusion, {name}"), |bencher| {
            bencher.iter_custom(|sets| run(&arena, &frames, sets));
        });
    }
}

/// Time of `sets` frame sets; the recorded ones are repeated, each time with a new machine.
fn run(
    arena: &Arena,
    frames: &[roundel_core::world::FrameObservations],
    sets: u64,
) -> std::time::Duration {
    let cameras = arena.setting.cameras;
    let mut left = sets;
    let mut time = std::time::Duration::ZERO;
    while left > 0 {
        let mut fusion = Fusion::new(FusionParams::default());
        for (index, placement) in arena.placements.iter().enumerate() {
            fusion.set_camera(CameraId(index as u32), Some(*placement));
        }
        let start = std::time::Instant::now();
        for set in frames.chunks(cameras).take(left as usize) {
            for frame in set {
                fusion.observe(frame);
            }
            std::hint::black_box(fusion.snapshot(set[cameras - 1].received_time));
            left -= 1;
        }
        time += start.elapsed();
    }
    time
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10).measurement_time(std::time::Duration::from_secs(4));
    targets = fusion
}
criterion_main!(benches);
