//! `roundel eval`: a recording beside another system's trajectories.

use std::{
    fmt::Write as _,
    fs,
    io::Write as _,
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::Context;
use clap::{Args, ValueEnum};

use crate::archive::{
    eval::{
        Sample, estimate,
        metrics::{ErrorStatistics, EvalMetrics, EvalSettings, evaluate},
        plots, truth,
    },
    replay::reader::Reader,
};

/// Compare a recording with another system's trajectories.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    roundel eval run.mcap --truth truth.csv\n  \
    roundel eval run.mcap --truth mocap.tum --object 12 --draw pictures --format json\n\n\
    The truth is a table with the columns time_ns (or time_s), x, y, z, perhaps qx, qy, qz, qw and object (a\n\
    name, code or id of the recording), or a trajectory in TUM's form. One time offset and one rigid transform\n\
    are found for everything, unless --offset and --align none say otherwise; figures are those of the `evo` tool,\n\
    and --export writes both trajectories for it, as they were compared.")]
pub struct EvalArgs {
    /// The recording
    file: PathBuf,
    /// What the other system says
    #[arg(long, value_name = "FILE")]
    truth: PathBuf,
    /// Whether the two frames may differ
    #[arg(long, value_enum, default_value_t = Align::Rigid)]
    align: Align,
    /// What the truth's clock is ahead of the recording's, seconds [default: found out]
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    offset: Option<f64>,
    /// How far it may be, either way
    #[arg(long, value_name = "SECONDS", default_value_t = 1.0, value_parser = offset)]
    max_offset: f64,
    /// Samples between the two ends of a move of which the relative error is taken
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..))]
    delta: u32,
    /// The object that the truth is of, by name, code or id, where it does not say
    #[arg(long, value_name = "OBJECT")]
    object: Option<String>,
    /// Draw pictures into this folder
    #[arg(long, value_name = "DIR")]
    draw: Option<PathBuf>,
    /// Write what was compared into this folder, in TUM's form
    #[arg(long, value_name = "DIR")]
    export: Option<PathBuf>,
    /// How to print it
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Align {
    /// By one rotation and translation
    Rigid,
    /// Not at all
    None,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    Table,
    Json,
}

fn offset(text: &str) -> Result<f64, String> {
    let offset = text.parse().ok().filter(|offset: &f64| (0.0..=3600.0).contains(offset));
    offset.ok_or_else(|| format!("expected 0 to 3600 seconds, found `{text}`"))
}

/// Prints the metrics.
pub(super) fn run(arguments: &EvalArgs) -> anyhow::Result<ExitCode> {
    let text = fs::read_to_string(&arguments.truth)
        .with_context(|| format!("cannot read {}", arguments.truth.display()))?;
    let truths = truth::read(&arguments.truth.display().to_string(), &text)?;
    let mut reader = Reader::open(&arguments.file, false)?;
    let estimate = estimate::read(&mut reader)?;
    for sentence in &reader.file().damage().sentences {
        eprintln!("not whole: {sentence}");
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
    let text = match arguments.format {
        Format::Json => format!("{}\n", serde_json::to_string_pretty(&metrics)?),
        Format::Table => table(&metrics),
    };
    std::io::stdout().write_all(text.as_bytes()).context("cannot write to the standard output")?;
    Ok(ExitCode::SUCCESS)
}

fn table(metrics: &EvalMetrics) -> String {
    let mut text = String::new();
    let [x, y, z] = metrics.translation_m;
    let degrees = metrics.truth_from_estimate.rotation.angle().to_degrees();
    // Writing to a string cannot fail.
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
    for object in &metrics.objects {
        let ErrorStatistics { rms, median, p95, max, .. } = object.ate_m;
        let turned = object.ate_deg.map_or("-".to_owned(), |it| format!("{:.3}", it.rms));
        let name =
            if object.name.is_empty() { object.object_id.to_string() } else { object.name.clone() };
        let _ = writeln!(
            text,
            "{name:<16} {:>8.2} {:>8.2} {:>8.2} {:>8.2} {:>8.2} {:>8.3} {turned:>8} {:>5.1}% {:>6}",
            rms * 1e3,
            median * 1e3,
            p95 * 1e3,
            max * 1e3,
            object.rpe_m.rms * 1e3,
            object.jitter_m * 1e3,
            object.seen * 1e2,
            object.gaps
        );
    }
    let ErrorStatistics { rms, median, p95, max, count, .. } = metrics.ate_m;
    let _ = writeln!(
        text,
        "{:<16} {:>8.2} {:>8.2} {:>8.2} {:>8.2} {:>8.2}  ({count} samples; RPE over {} samples)",
        "all",
        rms * 1e3,
        median * 1e3,
        p95 * 1e3,
        max * 1e3,
        metrics.rpe_m.rms * 1e3,
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

/// Each object's trajectories as they were compared, but for the alignment: `NAME.estimate.tum` and `NAME.truth.tum`,
/// with the same times.
fn export(metrics: &EvalMetrics, folder: &Path) -> std::io::Result<()> {
    fs::create_dir_all(folder)?;
    for object in &metrics.objects {
        let tame = |it: char| if it.is_alphanumeric() { it } else { '-' };
        let name: String =
            format!("{}-{}", object.object_id, object.name).chars().map(tame).collect();
        let [mut estimate, mut truth] = [String::new(), String::new()];
        for pair in &object.pairs {
            let ns = pair.estimate.time.as_ns();
            line(&mut estimate, ns, &pair.estimate);
            line(&mut truth, ns, &pair.truth);
        }
        fs::write(folder.join(format!("{name}.estimate.tum")), estimate)?;
        fs::write(folder.join(format!("{name}.truth.tum")), truth)?;
    }
    Ok(())
}

fn line(text: &mut String, ns: i64, sample: &Sample) {
    let (p, q) = (sample.position_m, sample.orientation.unwrap_or_default());
    let (seconds, part) = (ns.div_euclid(1_000_000_000), ns.rem_euclid(1_000_000_000));
    let _ = writeln!(
        text,
        "{seconds}.{part:09} {} {} {} {} {} {} {}",
        p.x, p.y, p.z, q.i, q.j, q.k, q.w
    );
}
