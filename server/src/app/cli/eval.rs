//! `roundel eval`: compares a recording with another system's trajectories.

use std::{
    fmt::Write as _,
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::Context;
use clap::{Args, ValueEnum};

use super::{Format, number};
use crate::{
    archive::{
        eval::{
            Sample, estimate,
            metrics::{ErrorStatistics, EvalMetrics, EvalSettings, evaluate},
            plots, truth,
        },
        replay::reader::Reader,
    },
    model::regular_file,
};

/// Larger trajectories are not read.
const MAX_TRUTH_BYTES: u64 = 1 << 30;

/// Compare a recording with another system's trajectories.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    roundel eval run.mcap --truth truth.csv\n  \
    roundel eval run.mcap --truth mocap.tum --object 12 --draw pictures --format json\n\n\
    The truth is a table with the columns time_ns (or time_s), x, y, z, and optionally qx, qy, qz, qw and object (a\n\
    name, code or id of the recording), or a trajectory in the TUM format. One time offset and one rigid transform\n\
    are estimated for all objects, unless --offset or --align none is given. The metrics are those of the `evo` tool;\n\
    --export writes the compared trajectories for it.")]
pub struct EvalArgs {
    /// The recording
    file: PathBuf,
    /// The other system's trajectories
    #[arg(long, value_name = "FILE")]
    truth: PathBuf,
    /// How the two coordinate frames are aligned
    #[arg(long, value_enum, default_value_t = Align::Rigid)]
    align: Align,
    /// Seconds by which the truth's clock is ahead of the recording's [default: estimated]
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    offset: Option<f64>,
    /// Maximum estimated offset in either direction
    #[arg(long, value_name = "SECONDS", default_value_t = 1.0, value_parser = |text: &str| number(text, [0.0, 3600.0]))]
    max_offset: f64,
    /// Number of samples between the poses of a relative error
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..))]
    delta: u32,
    /// The truth's object by name, code or id, if the file does not name it
    #[arg(long, value_name = "OBJECT")]
    object: Option<String>,
    /// Write plots into this folder
    #[arg(long, value_name = "DIR")]
    draw: Option<PathBuf>,
    /// Write the compared trajectories into this folder, in the TUM format
    #[arg(long, value_name = "DIR")]
    export: Option<PathBuf>,
    /// Format of the report
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Align {
    /// One rotation and translation
    Rigid,
    /// No alignment
    None,
}

pub(super) fn run(arguments: &EvalArgs) -> anyhow::Result<ExitCode> {
    let text = regular_file::read_text(&arguments.truth, MAX_TRUTH_BYTES)
        .with_context(|| format!("cannot read {}", arguments.truth.display()))?;
    let truths = truth::read(&arguments.truth.display().to_string(), &text)?;
    let mut reader = Reader::open(&arguments.file, false)?;
    let estimate = estimate::read(&mut reader)?;
    for sentence in &reader.file().damage().sentences {
        eprintln!("damaged: {sentence}");
    }
    let settings = EvalSettings {
        aligns: arguments.align == Align::Rigid,
        offset_s: arguments.offset,
        most_offset_s: arguments.max_offset,
        delta: arguments.delta as usize,
        object: arguments.object.clone(),
    };
    let metrics = evaluate(&estimate, &truths, &settings)?;
    if let Some(folder) = &arguments.draw {
        plots::draw(&metrics, folder)
            .with_context(|| format!("cannot draw into {}", folder.display()))?;
    }
    if let Some(folder) = &arguments.export {
        export(&metrics, folder)
            .with_context(|| format!("cannot write into {}", folder.display()))?;
    }
    arguments.format.print(&metrics, table)?;
    Ok(ExitCode::SUCCESS)
}

fn table(metrics: &EvalMetrics) -> String {
    let mut text = String::new();
    let [x, y, z] = metrics.translation_m;
    let degrees = metrics.truth_from_estimate.rotation.angle().to_degrees();
    let _ = writeln!(
        text,
        "truth's clock ahead by {:.1} ms; truth's frame moved by ({x:.3}, {y:.3}, {z:.3}) m and turned by {degrees:.2}°",
        metrics.offset_s * 1e3
    );
    let _ = writeln!(
        text,
        "\n{:<16} {:>8} {:>8} {:>8} {:>8} {:>8} {:>8} {:>8} {:>6} {:>6}",
        "mm", "rms", "median", "p95", "max", "RPE rms", "jitter", "deg rms", "seen", "gaps"
    );
    let millimetres = |ErrorStatistics { rms, median, p95, max, .. }: &ErrorStatistics| {
        let [rms, median, p95, max] = [rms, median, p95, max].map(|metres| metres * 1e3);
        format!("{rms:>8.2} {median:>8.2} {p95:>8.2} {max:>8.2}")
    };
    for object in &metrics.objects {
        let turned = object.ate_deg.map_or("-".to_owned(), |it| format!("{:.3}", it.rms));
        let id = object.object_id.to_string();
        let name = if object.name.is_empty() { &id } else { &object.name };
        let _ = writeln!(
            text,
            "{name:<16} {} {:>8.2} {:>8.3} {turned:>8} {:>5.1}% {:>6}",
            millimetres(&object.ate_m),
            object.rpe_m.rms * 1e3,
            object.jitter_m * 1e3,
            object.seen * 1e2,
            object.gaps
        );
    }
    let _ = writeln!(
        text,
        "{:<16} {} {:>8.2}  ({} samples; RPE over {} samples)",
        "all",
        millimetres(&metrics.ate_m),
        metrics.rpe_m.rms * 1e3,
        metrics.ate_m.count,
        metrics.rpe_delta
    );
    let late = metrics.latency_ms;
    let _ = writeln!(
        text,
        "\nnewest capture to snapshot: median {:.1}, p95 {:.1}, at most {:.1} ms",
        late.median, late.p95, late.max
    );
    if !metrics.missing.is_empty() {
        let _ = writeln!(text, "not in the recording: {}", metrics.missing.join(", "));
    }
    text
}

/// Writes the compared trajectories of each object, with equal times but without alignment: `NAME.estimate.tum` and
/// `NAME.truth.tum`.
fn export(metrics: &EvalMetrics, folder: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(folder)?;
    for object in &metrics.objects {
        let name = format!("{}-{}", object.object_id, object.name);
        let name = name.replace(|it: char| !it.is_alphanumeric(), "-");
        let [mut estimate, mut truth] = [String::new(), String::new()];
        for pair in &object.pairs {
            let ns = pair.estimate.time.as_ns();
            write_line(&mut estimate, ns, &pair.estimate);
            write_line(&mut truth, ns, &pair.truth);
        }
        std::fs::write(folder.join(format!("{name}.estimate.tum")), estimate)?;
        std::fs::write(folder.join(format!("{name}.truth.tum")), truth)?;
    }
    Ok(())
}

fn write_line(text: &mut String, ns: i64, sample: &Sample) {
    let (p, q) = (sample.position_m, sample.orientation.unwrap_or_default());
    let (seconds, part) = (ns.div_euclid(1_000_000_000), ns.rem_euclid(1_000_000_000));
    let _ = writeln!(
        text,
        "{seconds}.{part:09} {} {} {} {} {} {} {}",
        p.x, p.y, p.z, q.i, q.j, q.k, q.w
    );
}
