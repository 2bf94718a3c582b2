//! `roundel info`: what is in a recording, and what of it can be read.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
    io::Write as _,
    path::PathBuf,
    process::ExitCode,
};

use anyhow::Context;
use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use prost::Message;
use roundel_core::time::Timestamp;
use roundel_proto::v1;
use serde::Serialize;

use crate::archive::record::{
    file_reader::{Channel, FileReader, RecordedMessage},
    megabytes,
    schema::Topic,
};

/// A pause between two snapshots that is so many times as long as usual is a gap.
const GAP_FACTOR: f64 = 5.0;

/// Say what is in a recording, and what of it can be read.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  \
    roundel info recordings/lab-20261122T221055Z-001.mcap\n\n\
    Reads the whole file. The code is 1 if something of it cannot be read.")]
pub struct InfoArgs {
    /// The recording
    file: PathBuf,
    /// How to print it
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    Table,
    Json,
}

/// What is in a recording.
#[derive(Debug, Default, Serialize)]
struct Report {
    file: String,
    bytes: u64,
    /// As strings: nanoseconds exceed what a JSON number holds.
    begin_time_ns: String,
    end_time_ns: String,
    duration_s: f64,
    installation: String,
    version: String,
    source_id: String,
    topics: Vec<TopicReport>,
    cameras: BTreeMap<String, u64>,
    objects: usize,
    gaps: u64,
    longest_gap_s: f64,
    can_be_fused_anew: bool,
    complete: bool,
    lost_bytes: u64,
    damage: Vec<String>,
}

#[derive(Debug, Serialize)]
struct TopicReport {
    topic: String,
    messages: u64,
    rate_hz: f64,
    bytes: u64,
}

/// Prints the report.
pub(super) fn run(arguments: &InfoArgs) -> anyhow::Result<ExitCode> {
    let mut reader = FileReader::open(&arguments.file)?;
    let report = read(&mut reader)?;
    let text = match arguments.format {
        Format::Json => format!("{}\n", serde_json::to_string_pretty(&report)?),
        Format::Table => table(&report),
    };
    std::io::stdout().write_all(text.as_bytes()).context("cannot write to the standard output")?;
    Ok(if report.complete { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

#[derive(Default)]
struct ContentCounts {
    counts: BTreeMap<Channel, (u64, u64)>,
    cameras: BTreeMap<String, u64>,
    objects: BTreeSet<u64>,
    snapshots: Vec<Timestamp>,
    has_calibration: bool,
}

impl ContentCounts {
    fn add(&mut self, raw: &RecordedMessage) {
        let (messages, bytes) = self.counts.entry(raw.channel.clone()).or_default();
        (*messages, *bytes) = (*messages + 1, *bytes + raw.data.len() as u64);
        match &raw.channel {
            Channel::Topic(Topic::Snapshots) => {
                self.snapshots.push(raw.publish_time);
                if let Ok(snapshot) = v1::Snapshot::decode(raw.data.as_slice()) {
                    self.objects.extend(snapshot.objects.iter().map(|object| object.object_id));
                }
            }
            Channel::Topic(Topic::Observations) => {
                if let Ok(frame) = v1::FrameObservations::decode(raw.data.as_slice()) {
                    *self.cameras.entry(frame.camera).or_default() += 1;
                }
            }
            Channel::Topic(Topic::Calibration) => self.has_calibration = true,
            _ => {}
        }
    }

    /// How many pauses are far longer than usual, and the longest one.
    fn gaps(&mut self) -> (u64, f64) {
        self.snapshots.sort_unstable();
        let steps = self.snapshots.windows(2).map(|pair| pair[1].seconds_since(pair[0]));
        let steps: Vec<f64> = steps.collect();
        let mut sorted = steps.clone();
        sorted.sort_by(f64::total_cmp);
        let usual_s = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
        let long = steps.iter().copied().filter(|step| *step > GAP_FACTOR * usual_s);
        long.fold((0, 0.0), |(count, longest), step| (count + 1, f64::max(longest, step)))
    }
}

fn read(reader: &mut FileReader) -> anyhow::Result<Report> {
    let bar = ProgressBar::new(reader.chunks().len() as u64);
    let style = ProgressStyle::with_template("reading [{bar:30}] {percent} %");
    bar.set_style(style.context("the progress bar's template is wrong")?.progress_chars("=> "));
    let mut counts = ContentCounts::default();
    while let Some(messages) = reader.next_chunk()? {
        messages.iter().for_each(|raw| counts.add(raw));
        bar.inc(1);
    }
    bar.finish_and_clear();
    let span = reader.span();
    let duration_s = span.map_or(0.0, |(begin, end)| end.seconds_since(begin));
    let (gaps, longest_gap_s) = counts.gaps();
    let about = |key: &str| reader.metadata().get(key).cloned().unwrap_or_default();
    let ns = |time: Option<Timestamp>| time.map_or(0, |time| time.as_ns()).to_string();
    let topics = counts.counts.iter().map(|(source, (messages, bytes))| TopicReport {
        topic: source.name(),
        messages: *messages,
        rate_hz: if duration_s > 0.0 { *messages as f64 / duration_s } else { 0.0 },
        bytes: *bytes,
    });
    let damage = reader.damage();
    Ok(Report {
        file: reader.path().display().to_string(),
        bytes: reader.length(),
        begin_time_ns: ns(span.map(|(begin, _)| begin)),
        end_time_ns: ns(span.map(|(_, end)| end)),
        duration_s,
        installation: about("installation"),
        version: about("version"),
        source_id: about("source_id"),
        topics: topics.collect(),
        cameras: counts.cameras,
        objects: counts.objects.len(),
        gaps,
        longest_gap_s,
        can_be_fused_anew: counts.has_calibration,
        complete: damage.sentences.is_empty(),
        lost_bytes: damage.bytes,
        damage: damage.sentences.clone(),
    })
}

fn table(report: &Report) -> String {
    let mut text = String::new();
    let Report { file, installation, version, duration_s, objects, .. } = report;
    // Writing to a string cannot fail.
    let _ = writeln!(text, "{file}: {}, {duration_s:.1} s", megabytes(report.bytes));
    let _ = writeln!(text, "installation \"{installation}\", recorded by Roundel {version}");
    let _ = writeln!(
        text,
        "from {} to {} ns since the Unix epoch; {objects} objects",
        report.begin_time_ns, report.end_time_ns
    );
    let _ = writeln!(text, "\n{:<28} {:>9} {:>9} {:>10}", "topic", "messages", "Hz", "raw");
    for TopicReport { topic, messages, rate_hz, bytes } in &report.topics {
        let size = megabytes(*bytes);
        let _ = writeln!(text, "{topic:<28} {messages:>9} {rate_hz:>9.1} {size:>10}");
    }
    if !report.cameras.is_empty() {
        let each = report.cameras.iter().map(|(name, frames)| format!("{name} {frames}"));
        let _ = writeln!(text, "\nframes: {}", each.collect::<Vec<_>>().join(", "));
    }
    if report.gaps > 0 {
        let _ = writeln!(
            text,
            "\n{} gaps between snapshots, the longest of {:.2} s",
            report.gaps, report.longest_gap_s
        );
    }
    if !report.can_be_fused_anew {
        let _ = writeln!(
            text,
            "\nIts snapshots can be played; fused anew it cannot be, since it does not say what fusion was told of \
             cameras (it was streamed by `roundel record --output`)."
        );
    }
    for sentence in &report.damage {
        let _ = writeln!(text, "\nnot whole: {sentence}");
    }
    text
}
