//! `roundel info`: summarises and checks a recording.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
    path::PathBuf,
    process::ExitCode,
};

use clap::Args;
use prost::Message;
use roundel_core::time::Timestamp;
use roundel_proto::v1;
use serde::Serialize;

use super::{Format, progress_bar};
use crate::archive::record::{
    file_reader::{Channel, FileReader, RecordedMessage},
    megabytes,
    schema::Topic,
};

/// A pause between two snapshots is a gap if it is this many times the median pause.
const GAP_FACTOR: f64 = 5.0;

/// Summarise and check a recording.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  \
    roundel info recordings/lab-20261122T221055Z-001.mcap\n\n\
    Reads the whole file. The exit code is 1 if a part of it cannot be read.")]
pub struct InfoArgs {
    /// The recording
    file: PathBuf,
    /// Format of the report
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
}

#[derive(Debug, Serialize)]
pub struct Report {
    file: String,
    bytes: u64,
    /// Strings, since nanoseconds exceed the precision of a JSON number.
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

pub(super) fn run(arguments: &InfoArgs) -> anyhow::Result<ExitCode> {
    let report = read(&mut FileReader::open(&arguments.file)?)?;
    arguments.format.print(&report, table)?;
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

    /// Number of gaps and the longest one, in seconds.
    fn gaps(&mut self) -> (u64, f64) {
        self.snapshots.sort_unstable();
        let steps = self.snapshots.windows(2).map(|pair| pair[1].seconds_since(pair[0]));
        let mut steps: Vec<f64> = steps.collect();
        steps.sort_by(f64::total_cmp);
        let usual_s = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
        let gaps = steps.len() - steps.partition_point(|step| *step <= GAP_FACTOR * usual_s);
        (gaps as u64, if gaps > 0 { steps[steps.len() - 1] } else { 0.0 })
    }
}

/// Reads the whole file.
pub fn read(reader: &mut FileReader) -> anyhow::Result<Report> {
    let chunks = reader.chunks().len() as u64;
    let bar = progress_bar(Some(chunks), "reading [{bar:30}] {percent} %")?;
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

pub fn table(report: &Report) -> String {
    let mut text = String::new();
    let Report { file, installation, version, begin_time_ns, end_time_ns, .. } = report;
    let Report { duration_s, objects, gaps, longest_gap_s, .. } = report;
    let _ = writeln!(text, "{file}: {}, {duration_s:.1} s", megabytes(report.bytes));
    let _ = writeln!(text, "installation \"{installation}\", recorded by Roundel {version}");
    let _ = writeln!(text, "from {begin_time_ns} to {end_time_ns} ns Unix time; {objects} objects");
    let _ = writeln!(text, "\n{:<28} {:>9} {:>9} {:>10}", "topic", "messages", "Hz", "raw");
    for TopicReport { topic, messages, rate_hz, bytes } in &report.topics {
        let size = megabytes(*bytes);
        let _ = writeln!(text, "{topic:<28} {messages:>9} {rate_hz:>9.1} {size:>10}");
    }
    if !report.cameras.is_empty() {
        let each = report.cameras.iter().map(|(name, frames)| format!("{name} {frames}"));
        let _ = writeln!(text, "\nframes: {}", each.collect::<Vec<_>>().join(", "));
    }
    if *gaps > 0 {
        let _ = writeln!(text, "\n{gaps} gaps between snapshots, the longest {longest_gap_s:.2} s");
    }
    if !report.can_be_fused_anew {
        let _ = writeln!(
            text,
            "\nThe snapshots can be replayed, but the recording cannot be fused again: it lacks the camera updates that fusion \
             received (it was streamed by `roundel record --output`)."
        );
    }
    for sentence in &report.damage {
        let _ = writeln!(text, "\ndamaged: {sentence}");
    }
    text
}
