//! R4 under lab realism ([`roundel_tests::lab`]).

use roundel_core::marker::Mode;
use roundel_tests::{arena::realism::LabCondition, lab::Lab};

#[derive(clap::Args)]
pub struct Options {
    /// Length of the run
    #[arg(long, default_value_t = 5.0)]
    seconds: f64,
    #[arg(long, default_value_t = 60.0)]
    rate_hz: f64,
    /// Size of the prints over the configured one
    #[arg(long, default_value_t = 0.97)]
    scale: f64,
    /// Configure the size as printed
    #[arg(long)]
    known: bool,
    /// Plain roundels instead of coded ones
    #[arg(long)]
    plain: bool,
    #[arg(long)]
    fast: bool,
    /// Relative error of the focal lengths
    #[arg(long, default_value_t = 1e-3)]
    lens_error: f64,
    /// Conditions to leave out
    #[arg(long, value_enum, value_delimiter = ',')]
    without: Vec<LabCondition>,
    #[arg(long, default_value_t = 5)]
    seed: u64,
}

pub fn run(options: &Options) -> anyhow::Result<()> {
    let lab = Lab {
        seconds: options.seconds,
        rate_hz: options.rate_hz,
        scale: options.scale,
        knows_scale: options.known,
        is_plain: options.plain,
        mode: if options.fast { Mode::Fast } else { Mode::Precise },
        lens_error: options.lens_error,
        without: options.without.clone(),
        seed: options.seed,
    };
    let outcome = lab.run()?;
    println!("{}", outcome.detections);
    if !lab.knows_scale {
        let size = outcome.print_size;
        println!("prints {:.4} ± {:.4} times as large", size.factor, size.deviation);
    }
    println!("{}", outcome.tracks);
    Ok(())
}
