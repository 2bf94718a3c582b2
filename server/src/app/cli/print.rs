//! `roundel print`: roundels and the calibration board on paper.

mod job;

use std::{
    fs,
    io::{self, BufWriter, IsTerminal, Write},
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use roundel_core::marker::CodeLayout;

use crate::lab::print::{
    self, Page, PageLayoutError, PageSize, PrintJob,
    spec::{self, CodeNumbers, Diameters, PolarityArg},
};

/// Of pictures, if nobody says how many.
const DPI: f64 = 300.0;

/// Print roundels, true to scale.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    roundel print --marker 160 --code 8:2 --ids 1-24 robots.pdf\n  \
    roundel print --marker 122:50 --copies 6 --page Letter plain.pdf\n  \
    roundel print --config lab.toml lab.pdf           what its objects and references carry\n  \
    roundel print --config lab.toml --kind robot --ids 30-40 more.pdf\n  \
    roundel print --marker 600 --code 8:2 --ids 1 --page A3 drone.pdf     on several pages\n  \
    roundel print --board 7x5 board.pdf               for `roundel calibrate lens`\n  \
    roundel print --code 8:2 --list                   numbers and Hamming distances\n\n\
    The ending of FILE says what is written: .pdf has all pages, .svg and .png a file for each. Print at 100 %, \
    measure the rulers, and leave the white round the ring when cutting: the detector takes its level from it.")]
pub struct PrintArgs {
    /// What to write: FILE.pdf, FILE.svg or FILE.png
    #[arg(value_name = "FILE", required_unless_present = "list", conflicts_with = "list")]
    file: Option<PathBuf>,
    /// Diameters in millimetres: outer and inner one, coded ones only the outer one (the inner is then 0.6 of it),
    /// of an elliptical disc the longer and the shorter one
    #[arg(long, value_name = "OUTER_MM[:INNER_MM[:MINOR_MM]]", value_parser = spec::diameters, allow_hyphen_values = true)]
    marker: Option<Diameters>,
    /// Codes: bits, and the least Hamming distance [default distance: 1]
    #[arg(long, value_name = "BITS[:DISTANCE]", value_parser = spec::code)]
    code: Option<CodeLayout>,
    /// Numbers of codes, such as 1-24,30 [default: all]
    #[arg(long, value_name = "NUMBERS", value_parser = spec::numbers)]
    ids: Option<CodeNumbers>,
    /// How many of each [default: 1]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1000), conflicts_with_all = ["list", "board"])]
    copies: Option<u16>,
    /// Which of ring and disc is black; a white ring stands on black [default: black-ring]
    #[arg(long, value_enum)]
    polarity: Option<PolarityArg>,
    /// Print what this installation uses
    #[arg(long, value_name = "FILE", conflicts_with_all = ["marker", "code", "polarity", "board"])]
    config: Option<PathBuf>,
    /// With --config: only this kind of roundel
    #[arg(long, value_name = "NAME", requires = "config", conflicts_with = "board")]
    kind: Option<String>,
    /// The board that lenses are calibrated with: columns and rows of coded roundels [default with it:
    /// --marker 30 --code 9]
    #[arg(long, value_name = "COLUMNSxROWS", value_parser = spec::sides, conflicts_with_all = ["ids", "polarity"])]
    board: Option<(usize, usize)>,
    /// With --board: from centre to centre, millimetres [default: 1.2 of the outer diameter]
    #[arg(long, value_name = "MM", requires = "board", allow_negative_numbers = true)]
    pitch: Option<f64>,
    /// A2, A3, A4, A5, Letter, Legal, or WIDTHxHEIGHT in millimetres
    #[arg(long, default_value = "A4", value_parser = PageSize::parse)]
    page: PageSize,
    /// Dots an inch of .png [default: 300]
    #[arg(long, conflicts_with = "list", allow_negative_numbers = true)]
    dpi: Option<f64>,
    /// List the codes with their distances instead, or those of --ids
    #[arg(long, requires = "code", conflicts_with_all = ["board", "config"])]
    list: bool,
    /// How to print the list [default: table]
    #[arg(long, value_enum, requires = "list")]
    format: Option<Format>,
}

/// How the list is printed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum Format {
    /// For people
    #[default]
    Table,
    /// One JSON array
    Json,
}

/// Writes the files, and says what is in them.
pub(super) fn run(arguments: &PrintArgs) -> anyhow::Result<ExitCode> {
    if let (true, Some(layout)) = (arguments.list, arguments.code) {
        let format = arguments.format.unwrap_or_default();
        return list(layout, arguments.ids.as_ref(), format).map(|()| ExitCode::SUCCESS);
    }
    let Some(file) = &arguments.file else { bail!("expected a file to write, such as sheet.pdf") };
    let ending = file.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    if !["pdf", "svg", "png"].contains(&ending.as_str()) {
        bail!("{}: expected a name that ends in .pdf, .svg or .png", file.display());
    }
    if arguments.dpi.is_some() && ending != "png" {
        bail!("--dpi counts for .png alone, and {} has no dots: leave it out", file.display());
    }
    let job = job::print_job(arguments)?;
    let pages = job.pages(arguments.page)?;
    let written = match ending.as_str() {
        "pdf" => {
            let title = file.file_stem().unwrap_or_default().to_string_lossy();
            write(file, &print::pdf(&pages, &title))?;
            vec![file.clone()]
        }
        _ => each(file, &pages, |page| match ending.as_str() {
            "svg" => Ok(page.svg().into_bytes()),
            _ => {
                let mut bytes = Vec::new();
                print::png(page, arguments.dpi.unwrap_or(DPI), &mut bytes)?;
                Ok(bytes)
            }
        })?,
    };
    let told = report(&written, &pages, &job);
    ignore_broken_pipe(io::stdout().write_all(told.as_bytes()))?;
    Ok(ExitCode::SUCCESS)
}

/// A file for each page, numbered if there are several.
fn each(
    file: &Path,
    pages: &[Page],
    bytes: impl Fn(&Page) -> anyhow::Result<Vec<u8>>,
) -> anyhow::Result<Vec<PathBuf>> {
    let mut written = Vec::with_capacity(pages.len());
    for (index, page) in pages.iter().enumerate() {
        let mut name = file.file_stem().unwrap_or_default().to_os_string();
        if pages.len() > 1 {
            name.push(format!("-{}", index + 1));
        }
        name.push(".");
        name.push(file.extension().unwrap_or_default());
        let target = file.with_file_name(name);
        write(&target, &bytes(page)?)?;
        written.push(target);
    }
    Ok(written)
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

fn list(layout: CodeLayout, wanted: Option<&CodeNumbers>, format: Format) -> anyhow::Result<()> {
    let mut listed = print::list_codes(layout)?;
    if let Some(CodeNumbers(wanted)) = wanted {
        let count = listed.len();
        if let Some(unknown) = wanted.iter().find(|number| usize::from(**number) > count) {
            let (number, CodeLayout { bits, min_distance }) = (*unknown, layout);
            return Err(PageLayoutError::Number { number, bits, min_distance, count }.into());
        }
        listed.retain(|code| wanted.contains(&code.number));
    }
    let mut out = BufWriter::new(io::stdout().lock());
    let printed = match format {
        Format::Json => serde_json::to_writer_pretty(&mut out, &listed)
            .map_err(io::Error::from)
            .and_then(|()| writeln!(out)),
        Format::Table => table(&mut out, layout, &listed),
    };
    ignore_broken_pipe(printed.and_then(|()| out.flush()))
}

/// Who reads what is printed may have seen enough.
fn ignore_broken_pipe(printed: io::Result<()>) -> anyhow::Result<()> {
    match printed {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        printed => printed.context("cannot write to the standard output"),
    }
}

fn table(
    out: &mut impl Write,
    layout: CodeLayout,
    listed: &[print::CodeListing],
) -> io::Result<()> {
    let CodeLayout { bits, min_distance } = layout;
    writeln!(out, "{} codes of {bits} bits, {min_distance} bits or more apart", listed.len())?;
    let width = usize::from(bits).max(4);
    writeln!(out, "{:>6}  {:<width$}  {:>8}  {:>6}", "number", "bits", "distance", "turned")?;
    for code in listed {
        let print::CodeListing { number, word, distance, own_distance } = code;
        writeln!(out, "{number:>6}  {word:<width$}  {distance:>8}  {own_distance:>6}")?;
    }
    if io::stdout().is_terminal() {
        writeln!(
            out,
            "distance: bits that have to be misread to take it for another one; turned: for itself, turned"
        )?;
    }
    Ok(())
}
