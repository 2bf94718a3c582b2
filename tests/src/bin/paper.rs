//! Repeats the paper's experiments in simulation and prints its tables beside ours, as Markdown: `cargo run --release -p
//! roundel-tests --bin paper [-- [--short] NAME…]`; names as in `roundel_tests::paper`, all without any. What is under
//! way is told on the standard error. OpenCV comes from PyPI; what is missing is skipped by name.

use std::{process::ExitCode, time::Instant};

use roundel_tests::paper::{ALL, INTRODUCTION, Length};

fn main() -> ExitCode {
    let (options, names): (Vec<String>, Vec<String>) =
        std::env::args().skip(1).partition(|argument| argument.starts_with('-'));
    let bad_name = names.iter().find(|name| ALL.iter().all(|(known, _)| known != name));
    let bad_option = options.iter().find(|option| option.as_str() != "--short");
    if let Some(found) = bad_name.or(bad_option) {
        let known: Vec<_> = ALL.iter().map(|(name, _)| *name).collect();
        eprintln!("expected --short or any of {}; found {found}", known.join(" "));
        return ExitCode::from(2);
    }
    let length = if options.is_empty() { Length::Full } else { Length::Short };
    if names.is_empty() {
        println!("{INTRODUCTION}");
    }
    let mut failed = false;
    for (name, experiment) in ALL {
        if !names.is_empty() && !names.iter().any(|wanted| wanted == name) {
            continue;
        }
        let begun = Instant::now();
        match experiment(length) {
            Ok(table) => println!("{table}"),
            Err(why) => {
                eprintln!("{name}: {why:#}");
                failed = true;
            }
        }
        eprintln!("{name}: {:.1} s", begun.elapsed().as_secs_f64());
    }
    if failed { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}
