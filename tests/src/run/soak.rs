//! Days of operation in minutes: one table of sizes, and an error if a size grows in the last two thirds of the time.

use std::process::ExitCode;

use roundel_tests::soak;

use super::{exit_code, positive};

#[derive(clap::Args)]
pub struct Options {
    #[arg(default_value = "30", value_parser = positive)]
    days: f64,
}

pub fn run(options: &Options) -> anyhow::Result<ExitCode> {
    println!(
        "| day | memory, MB | handles | tracked | listed | newest id | clock off, ms | stated, ms | history, MB | recordings, MB |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    let samples = soak::run(options.days, |sample| println!("{sample}"))?;
    let mut problems = soak::growths(&samples);
    problems.extend(soak::clock_problems(&samples));
    for problem in &problems {
        eprintln!("{problem}");
    }
    Ok(exit_code(problems.is_empty()))
}
