//! Share of coded roundels that are read, and of wrong readings, by code length and diameter.

use std::process::ExitCode;

use roundel_core::marker::CodeLayout;
use roundel_tests::coded::{Case, run as run_case};

#[derive(clap::Args)]
pub struct Options {
    /// Roundels of each case
    #[arg(default_value_t = 20_000)]
    roundels: usize,
}

pub fn run(options: &Options) -> ExitCode {
    println!(
        "bits | distance | diameter    | read             | wrong | yaw wrong | yaw rms, over stated"
    );
    for (bits, min_distance, min_px) in
        [(5, 1, 30.0), (8, 1, 36.0), (8, 2, 36.0), (12, 2, 60.0), (16, 2, 90.0)]
    {
        let layout = CodeLayout { bits, min_distance };
        for diameters_px in [(min_px, min_px), (min_px, 2.0 * min_px)] {
            let score = run_case(&Case { layout, diameters_px }, options.roundels);
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
            for why in score.unread.iter().take(3) {
                println!("     unread: {why}");
            }
        }
    }
    ExitCode::SUCCESS
}
