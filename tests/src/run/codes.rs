//! How many coded roundels are read, and how many wrongly: `cargo run -p roundel-tests --bin codes`,
//! with the number of roundels of each case as an argument, 20,000 without one.

use roundel_core::marker::CodeLayout;
use roundel_tests::coded::{Case, run};

fn main() {
    let count = std::env::args().nth(1).map_or(20_000, |text| text.parse().expect("a number"));
    println!(
        "bits | distance | diameter    | read             | wrong | yaw wrong | yaw rms, over stated"
    );
    for (bits, min_distance, least_px) in
        [(5, 1, 30.0), (8, 1, 36.0), (8, 2, 36.0), (12, 2, 60.0), (16, 2, 90.0)]
    {
        let layout = CodeLayout { bits, min_distance };
        for diameters_px in [(least_px, least_px), (least_px, 2.0 * least_px)] {
            let score = run(&Case { layout, diameters_px }, count);
            println!(
                "{bits:4} | {min_distance:8} | {:3}-{:3} px  | {:6} of {:6} | {:5} | {:9} | {:.3}° {:.2}",
                diameters_px.0,
                diameters_px.1,
                score.read,
                score.shown,
                score.wrong,
                score.wrong_yaw,
                score.yaw_rms_rad.to_degrees(),
                score.yaw_rms_stated,
            );
            score.unread.iter().take(3).for_each(|why| println!("     unread: {why}"));
        }
    }
}
