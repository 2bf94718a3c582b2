//! Draws the curves of `core/docs/detector.md`: errors next to the Cramér-Rao bound, and times.
//!
//! `cargo run --release -p roundel-tests --bin curves` takes some minutes and writes SVG files into
//! `core/docs`; `-- --quick` takes fewer trials, `-- errors` or `-- times` draws only those, and every
//! point is printed as well.

mod error;
mod plot;
mod time;

use std::path::Path;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let given = |name: &str| arguments.iter().any(|argument| argument == name);
    if let Some(unknown) =
        arguments.iter().find(|name| !["--quick", "errors", "times"].contains(&name.as_str()))
    {
        anyhow::bail!("expected --quick, errors or times, found {unknown}");
    }
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../core/docs");
    let quick = given("--quick");
    let all = !given("errors") && !given("times");
    if all || given("times") {
        plot::draw(&docs.join("detector-time.svg"), &time::panels(quick))?;
    }
    if all || given("errors") {
        let count = if quick { 20 } else { 120 };
        plot::draw(&docs.join("detector-error.svg"), &error::panels(count))?;
    }
    Ok(())
}
