//! Repeats the paper's experiments in simulation and prints its tables beside ours, as Markdown: `cargo run --release -p
//! roundel-tests --bin paper [-- [--short] NAME…]`; names as in `roundel_tests::paper`, all without any. What is under
//! way is told on the standard error. OpenCV comes from PyPI; what is missing is skipped by name. A row that is worse than
//! the paper's without a reason ends it with an error. `introduction` is what stands above the tables.

use std::{process::ExitCode, time::Instant};

use roundel_tests::paper::{ALL, INTRODUCTION, Length, machine};

/// What stands above the tables, where names are given.
const HEAD: &str = "introduction";

fn main() -> ExitCode {
    let (options, names): (Vec<String>, Vec<String>) =
        std::env::args().skip(1).partition(|argument| argument.starts_with('-'));
    let is_known = |name: &String| name == HEAD || ALL.iter().any(|(known, _)| known == name);
    let bad_name = names.iter().find(|name| !is_known(name));
    let bad_option = options.iter().find(|option| option.as_str() != "--short");
    if let Some(found) = bad_name.or(bad_option) {
        let known: Vec<_> = ALL.iter().map(|(name, _)| *name).collect();
        eprintln!("expected --short or any of {HEAD} {}; found {found}", known.join(" "));
        return ExitCode::from(2);
    }
    let length = if options.is_empty() { Length::Full } else { Length::Short };
    let is_wanted = |name: &str| names.is_empty() || names.iter().any(|wanted| wanted == name);
    if is_wanted(HEAD) {
        println!("{INTRODUCTION}\n{}", machine());
    }
    let mut failed = false;
    for (name, experiment) in ALL {
        if !is_wanted(name) {
            continue;
        }
        let begun = Instant::now();
        match experiment(length) {
            Ok(table) => {
                println!("{table}");
                for row in table.rows.iter().filter(|row| row.is_unexcused()) {
                    eprintln!(
                        "{name}: {} is worse than the paper's, and no reason is said",
                        row.case
                    );
                    failed = true;
                }
            }
            Err(why) => {
                eprintln!("{name}: {why:#}");
                failed = true;
            }
        }
        eprintln!("{name}: {:.1} s", begun.elapsed().as_secs_f64());
    }
    if failed { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}
