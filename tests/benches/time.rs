//! Times with poses in both modes, one thread: `cargo bench -p roundel-tests --bench time`.
//!
//! Minimum times of many repetitions. The column "a roundel" divides the frame's time by the number of roundels;
//! "rings" is the part of it without poses.

use roundel_tests::{
    precision::MODES,
    timing::{Case, times},
};

const HD: (usize, usize) = (1920, 1080);
const UHD: (usize, usize) = (3840, 2160);

fn main() {
    println!(
        "roundels |   px |       image | mode    | followed, a frame (a roundel; of it rings) | \
         first search, a frame"
    );
    for ((width, height), count, diameter_px) in [
        (HD, 1, 15.0),
        (HD, 1, 30.0),
        (HD, 1, 60.0),
        (HD, 1, 110.0),
        (HD, 100, 30.0),
        (HD, 400, 30.0),
        (UHD, 100, 30.0),
        (UHD, 400, 30.0),
    ] {
        let case = Case { width, height, count, diameter_px };
        let times = times(&case, if count == 1 { 2000 } else { 60 });
        for (mode, times) in MODES.into_iter().zip(times) {
            println!(
                "{count:>8} | {diameter_px:>4} | {width:>4} x {height:>4} | {:<7} | \
                 {:>8.4} ms ({:>6.2} µs; {:>5.2} µs){:>12} | {:>8.3} ms",
                format!("{mode:?}"),
                1e3 * times.track_s,
                1e6 * times.track_s / count as f64,
                1e6 * times.rings_s / count as f64,
                "",
                1e3 * times.search_s,
            );
        }
    }
}
