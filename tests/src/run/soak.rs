//! Days of operation in minutes: `cargo run --release -p roundel-tests --bin soak -- [DAYS]`, 30 without it. Prints sizes
//! as one table, and exits with 1 if something grows in the last two thirds of the time.

use std::process::ExitCode;

use roundel_tests::soak;

fn main() -> anyhow::Result<ExitCode> {
    let days = match std::env::args().nth(1).map(|it| it.parse::<f64>()) {
        None => 30.0,
        Some(Ok(days)) if days > 0.0 => days,
        Some(_) => {
            eprintln!("expected days above 0");
            return Ok(ExitCode::from(2));
        }
    };
    println!(
        "| day | memory, MB | handles | tracked | listed | newest id | clock off, ms | stated, ms | history, MB | recordings, MB |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    let samples = soak::run(days, |sample| println!("{sample}"))?;
    let mut growths = soak::growths(&samples);
    growths.extend(soak::clock_problems(&samples));
    growths.iter().for_each(|it| eprintln!("{it}"));
    Ok(if growths.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
