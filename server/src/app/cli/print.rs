//! `roundel print`: roundels and the calibration board on paper.

mod job;

use std::{
    fmt::Write as _,
    fs,
    io::{self, IsTerminal, Write as _},
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::{Context, bail};
use clap::Args;
use roundel_core::marker::CodeLayout;

use super::Format;
use crate::lab::print::{
    self, Page, PageLayoutError, PageSize, PrintJob,
    spec::{self, CodeNumbers, Diameters, PolarityArg},
};

/// Default resolution of PNG files.
const DPI: f64 = 300.0;

/// Print roundels, true to scale.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    roundel print --marker 160 --code 8:2 --ids 1-24 robots.pdf\n  \
    roundel print --marker 122:50 --copies 6 --page Letter plain.pdf\n  \
    roundel print --config lab.toml lab.pdf           for its objects and references\n  \
    roundel print --config lab.toml --kind robot --ids 30-40 more.pdf\n  \
    roundel print --marker 600 --code 8:2 --ids 1 --page A3 drone.pdf     on several pages\n  \
    roundel print --board 7x5 board.pdf               for `roundel calibrate lens`\n  \
    roundel print --code 8:2 --list                   numbers and Hamming distances\n\n\
    The ending of FILE selects the format: .pdf has all pages, .svg and .png a file for each. Print at 100 %, \
    measure the rulers, and keep the white margin round the ring when cutting: the detector needs it.")]
pub struct PrintArgs {
    /// Output file: .pdf, .svg or .png
    #[arg(value_name = "FILE", required_unless_present = "list", conflicts_with = "list")]
    file: Option<PathBuf>,
    /// Diameters in millimetres: outer and inner; for coded roundels only outer (inner is 0.6 of it); for an elliptical
    /// disc outer, longer inner and shorter inner
    #[arg(long, value_name = "OUTER_MM[:INNER_MM[:MINOR_MM]]", value_parser = spec::diameters, allow_hyphen_values = true)]
    marker: Option<Diameters>,
    /// Codes: bits and minimum Hamming distance [default distance: 1]
    #[arg(long, value_name = "BITS[:DISTANCE]", value_parser = spec::code)]
    code: Option<CodeLayout>,
    /// Code numbers, such as 1-24,30 [default: all]
    #[arg(long, value_name = "NUMBERS", value_parser = spec::numbers)]
    ids: Option<CodeNumbers>,
    /// Copies of each roundel [default: 1]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1000), conflicts_with_all = ["list", "board"])]
    copies: Option<u16>,
    /// Whether ring or disc is black; a white ring is printed on black [default: black-ring]
    #[arg(long, value_enum)]
    polarity: Option<PolarityArg>,
    /// Print the roundels of this installation
    #[arg(long, value_name = "FILE", conflicts_with_all = ["marker", "code", "polarity", "board"])]
    config: Option<PathBuf>,
    /// With --config: only this kind of roundel
    #[arg(long, value_name = "NAME", requires = "config", conflicts_with = "board")]
    kind: Option<String>,
    /// A board for lens calibration: columns and rows of coded roundels [default with it: --marker 30 --code 9]
    #[arg(long, value_name = "COLUMNSxROWS", value_parser = spec::sides, conflicts_with_all = ["ids", "polarity"])]
    board: Option<(usize, usize)>,
    /// With --board: distance from centre to centre, millimetres [default: 1.2 of the outer diameter]
    #[arg(long, value_name = "MM", requires = "board", allow_negative_numbers = true)]
    pitch: Option<f64>,
    /// A2, A3, A4, A5, Letter, Legal, or WIDTHxHEIGHT in millimetres
    #[arg(long, default_value = "A4", value_parser = PageSize::parse)]
    page: PageSize,
    /// Dots per inch of .png [default: 300]
    #[arg(long, conflicts_with = "list", allow_negative_numbers = true)]
    dpi: Option<f64>,
    /// List the codes of --ids, or all, with their distances instead of printing
    #[arg(long, requires = "code", conflicts_with_all = ["board", "config"])]
    list: bool,
    /// Format of the list [default: table]
    #[arg(long, value_enum, requires = "list")]
    format: Option<Format>,
}

/// Writes the files and prints what they contain.
pub(super) fn run(arguments: &PrintArgs) -> anyhow::Result<ExitCode> {
    if let (true, Some(layout)) = (arguments.list, arguments.code) {
        let text = list(layout, arguments.ids.as_ref(), arguments.format)?;
        return print(&text).map(|()| ExitCode::SUCCESS);
    }
    let Some(file) = &arguments.file else { bail!("expected a file to write, such as sheet.pdf") };
    let ending = file.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    if !["pdf", "svg", "png"].contains(&ending.as_str()) {
        bail!("{}: expected a name that ends in .pdf, .svg or .png", file.display());
    }
    if arguments.dpi.is_some() && ending != "png" {
        bail!("--dpi applies only to .png, not to {}: leave it out", file.display());
    }
    let job = job::print_job(arguments)?;
    let pages = job.pages(arguments.page)?;
    let stem = file.file_stem().unwrap_or_default();
    let mut written = Vec::new();
    if ending == "pdf" {
        write(file, &print::pdf(&pages, &stem.to_string_lossy()))?;
        written.push(file.clone());
    } else {
        // A file for each page, numbered if there are several.
        for (index, page) in pages.iter().enumerate() {
            let mut bytes = Vec::new();
            match ending.as_str() {
                "svg" => bytes = page.svg().into_bytes(),
                _ => print::png(page, arguments.dpi.unwrap_or(DPI), &mut bytes)?,
            }
            let mut name = stem.to_os_string();
            if pages.len() > 1 {
                name.push(format!("-{}", index + 1));
            }
            name.push(".");
            name.push(file.extension().unwrap_or_default());
            let target = file.with_file_name(name);
            write(&target, &bytes)?;
            written.push(target);
        }
    }
    print(&report(&written, &pages, &job))?;
    Ok(ExitCode::SUCCESS)
}

fn write(file: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    fs::write(file, bytes).with_context(|| format!("cannot write {}", file.display()))
}

fn report(written: &[PathBuf], pages: &[Page], job: &PrintJob) -> String {
    let prints: usize = pages.iter().map(|page| page.prints.len()).sum();
    let sheets =
        if pages.len() == 1 { "one page".to_owned() } else { format!("{} pages", pages.len()) };
    let names = match written {
        [first, .., last] => format!("{} … {}", first.display(), last.display()),
        [only] => only.display().to_string(),
        [] => String::new(),
    };
    let size = pages.first().map_or_else(String::new, |page| page.size.name());
    let mut lines = vec![
        format!("{names}: {sheets} of {size}, {}", job::describe(job, prints)),
        "Print at 100 %, not fitted to the page, and measure the rulers.".to_owned(),
    ];
    lines.extend(job::next_steps(job));
    lines.push(String::new());
    lines.join("\n")
}

fn list(
    layout: CodeLayout,
    wanted: Option<&CodeNumbers>,
    format: Option<Format>,
) -> anyhow::Result<String> {
    let CodeLayout { bits, min_distance } = layout;
    let mut listed = print::list_codes(layout)?;
    if let Some(CodeNumbers(wanted)) = wanted {
        let count = listed.len();
        if let Some(&number) = wanted.iter().find(|number| usize::from(**number) > count) {
            return Err(PageLayoutError::Number { number, bits, min_distance, count }.into());
        }
        listed.retain(|code| wanted.contains(&code.number));
    }
    if format == Some(Format::Json) {
        return Ok(serde_json::to_string_pretty(&listed)? + "\n");
    }
    let mut text =
        format!("{} codes of {bits} bits, {min_distance} bits or more apart\n", listed.len());
    let width = usize::from(bits).max(4);
    writeln!(text, "{:>6}  {:<width$}  {:>8}  {:>6}", "number", "bits", "distance", "turned")?;
    for print::CodeListing { number, word, distance, own_distance } in listed {
        writeln!(text, "{number:>6}  {word:<width$}  {distance:>8}  {own_distance:>6}")?;
    }
    if io::stdout().is_terminal() {
        text += "distance: minimum number of bit errors that yield another code; turned: that yield the same code rotated\n";
    }
    Ok(text)
}

/// Prints a text. It is not an error if the reader closes the pipe.
fn print(text: &str) -> anyhow::Result<()> {
    match io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        printed => printed.context("cannot write to the standard output"),
    }
}
