//! What a soak test measures, and whether it grows.

use std::{fmt, fs, path::Path};

use anyhow::Context;
use roundel_core::{id::CameraId, world::LifeStage};
use roundel_server::model::hub::Hub;

use super::{AHEAD_S, LATE_CAMERA};

/// Growth that is none: measurements vary.
const GROWTH: f64 = 0.05;
const GROWTH_MB: f64 = 4.0;
/// The offset of the estimated clock is known this well, seconds.
const CLOCK_ERROR_S: f64 = 2e-3;
const MB: f64 = 1e6;

/// Sizes at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Days since the start.
    pub day: f64,
    /// Resident memory of the process.
    pub memory_mb: f64,
    /// Open files and sockets of the process.
    pub handles: usize,
    /// Objects of the newest snapshot that are tracked.
    pub tracked: usize,
    /// Lost and current objects that the server lists.
    pub listed: usize,
    /// Largest id so far.
    pub newest_id: u64,
    /// Error of the estimated clock, seconds.
    pub clock_error_s: f64,
    /// Stated deviation of the estimated clock, seconds.
    pub clock_deviation_s: f64,
    /// Files of the history.
    pub history_mb: f64,
    /// Files of recordings.
    pub recordings_mb: f64,
}

impl Sample {
    pub(super) fn now(day: f64, hub: &Hub, folder: &Path) -> anyhow::Result<Self> {
        let status = fs::read_to_string("/proc/self/status")?;
        let memory = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
        let memory_kb = memory.and_then(|it| it.split_whitespace().next()?.parse::<f64>().ok());
        let snapshot = hub.snapshots().borrow().clone();
        let objects = &snapshot.snapshot.objects;
        let clock = hub.camera(CameraId(LATE_CAMERA as u32)).and_then(|camera| camera.clock);
        let clock = clock.context("no clock is estimated")?;
        Ok(Self {
            day,
            memory_mb: memory_kb.context("no VmRSS")? / 1024.0,
            handles: fs::read_dir("/proc/self/fd")?.count(),
            tracked: objects.iter().filter(|it| it.stage == LifeStage::Tracked).count(),
            listed: hub.objects().len(),
            newest_id: objects.iter().map(|it| it.id.0).max().unwrap_or(0),
            clock_error_s: (clock.offset_s - AHEAD_S).abs(),
            clock_deviation_s: clock.deviation_s,
            history_mb: size_mb(folder, "history.sqlite"),
            recordings_mb: size_mb(&folder.join("recordings"), ""),
        })
    }
}

impl fmt::Display for Sample {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "| {:.2} | {:.1} | {} | {} | {} | {} | {:.3} | {:.3} | {:.2} | {:.2} |",
            self.day,
            self.memory_mb,
            self.handles,
            self.tracked,
            self.listed,
            self.newest_id,
            self.clock_error_s * 1e3,
            self.clock_deviation_s * 1e3,
            self.history_mb,
            self.recordings_mb
        )
    }
}

/// Files of a folder whose names begin so.
fn size_mb(folder: &Path, begin: &str) -> f64 {
    let files = fs::read_dir(folder).into_iter().flatten().flatten();
    let sizes = files
        .filter(|file| file.file_name().to_string_lossy().starts_with(begin))
        .filter_map(|file| Some(file.metadata().ok()?.len()));
    sizes.sum::<u64>() as f64 / MB
}

/// What grows, or is wrong, in the last two thirds of the samples: their second half against their first.
pub fn growths(samples: &[Sample]) -> Vec<String> {
    let settled = &samples[samples.len() / 3..];
    let (first, second) = settled.split_at(settled.len() / 2);
    let mut problems = Vec::new();
    let mut compare = |name: &str, slack: f64, value: &dyn Fn(&Sample) -> f64| {
        let most = |part: &[Sample]| part.iter().map(value).fold(0.0, f64::max);
        let (before, after) = (most(first), most(second));
        if after > before * (1.0 + GROWTH) + slack {
            problems.push(format!("{name}: {before:.2} first, {after:.2} later"));
        }
    };
    compare("memory, MB", GROWTH_MB, &|it| it.memory_mb);
    // A file is rotated, and a lost object is listed for a minute.
    compare("handles", 2.0, &|it| it.handles as f64);
    compare("objects listed", 2.0, &|it| it.listed as f64);
    compare("history, MB", 0.0, &|it| it.history_mb);
    // The budget is enforced each second of real time.
    compare("recordings, MB", 20.0, &|it| it.recordings_mb);
    for sample in settled {
        if sample.tracked < 2 {
            problems.push(format!("day {:.1}: {} robots tracked", sample.day, sample.tracked));
        }
        // Three robots, and one id for each time that the hidden one appears again.
        let most_ids = (sample.day * 24.0).ceil() as u64 + 3;
        if sample.newest_id > most_ids {
            problems.push(format!(
                "day {:.1}: {} ids, expected {most_ids}",
                sample.day, sample.newest_id
            ));
        }
    }
    problems
}

/// Samples at which the estimated clock is off.
pub fn clock_problems(samples: &[Sample]) -> Vec<String> {
    let settled = samples[samples.len() / 3..].iter();
    let off = settled.filter(|sample| sample.clock_error_s > CLOCK_ERROR_S);
    off.map(|it| format!("day {:.1}: clock off by {:.4} s", it.day, it.clock_error_s)).collect()
}
