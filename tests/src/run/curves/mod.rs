//! Draws the curves of `core/docs/detector.md`, errors beside the Cramér-Rao bound and times, as SVG files into
//! `core/docs`. Also prints every point.

mod error;
mod plot;
mod time;

use std::{path::Path, process::ExitCode};

#[derive(clap::Args)]
pub struct Options {
    /// What to draw; both by default
    figure: Option<Figure>,
    /// Fewer trials
    #[arg(long)]
    quick: bool,
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum Figure {
    Errors,
    Times,
}

pub fn run(options: &Options) -> anyhow::Result<ExitCode> {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../core/docs");
    if options.figure != Some(Figure::Errors) {
        plot::draw(&docs.join("detector-time.svg"), &time::panels(options.quick))?;
    }
    if options.figure != Some(Figure::Times) {
        let count = if options.quick { 20 } else { 120 };
        plot::draw(&docs.join("detector-error.svg"), &error::panels(count))?;
    }
    Ok(ExitCode::SUCCESS)
}
