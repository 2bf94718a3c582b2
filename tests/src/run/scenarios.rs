//! Runs the scenarios with truth and prints one table: `cargo run --release -p roundel-tests --bin
//! scenarios [-- [--short] [--detail] NAME…]`; names as in `roundel_tests::scenario`, all without any. What is
//! under way is told on the standard error, with `--detail` each row's errors and their mean normalized squares as
//! well. Ends with 1 if a row misses its bar.

use std::{panic::catch_unwind, process::ExitCode, time::Instant};

use roundel_tests::{
    scenario::{ALL, Length, Row, consistency, table},
    score::Score,
};

fn main() -> ExitCode {
    let (options, names): (Vec<String>, Vec<String>) =
        std::env::args().skip(1).partition(|argument| argument.starts_with("--"));
    let unknown = |name: &&String| ALL.iter().all(|(known, _)| known != name);
    let bad_name = names.iter().find(unknown);
    let bad_option =
        options.iter().find(|option| !["--short", "--detail"].contains(&option.as_str()));
    if let Some(found) = bad_name.or(bad_option) {
        let known: Vec<_> = ALL.iter().map(|(name, _)| *name).collect();
        eprintln!("expected --short, --detail or any of {}; found {found}", known.join(" "));
        return ExitCode::from(2);
    }
    let has = |wanted: &str| options.iter().any(|option| option == wanted);
    let length = if has("--short") { Length::Short } else { Length::Full };
    let mut rows = Vec::new();
    for (name, run) in ALL {
        if !names.is_empty() && !names.iter().any(|wanted| wanted == name) {
            continue;
        }
        let begun = Instant::now();
        let panicked = |_| vec![Row::new(name, "").check("panicked", false)];
        let done = catch_unwind(|| run(length)).unwrap_or_else(panicked);
        for row in done.iter().filter(|_| has("--detail")) {
            let score = row.score.as_ref().map_or(String::new(), Score::to_string);
            eprintln!("{}\n{score}", row.scenario);
        }
        rows.extend(done);
        eprintln!("{name}: {:.1} s", begun.elapsed().as_secs_f64());
    }
    rows.push(consistency(&rows));
    print!("{}", table(&rows));
    if rows.iter().all(Row::holds) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
