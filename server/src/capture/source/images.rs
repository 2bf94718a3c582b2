//! `images:` – image files, played in real time.

use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use roundel_core::time::Timestamp;

use super::{
    FrameInfo, FrameSource, LentFrame, Playback, SourceError, bad_frame,
    playback::{mean_interval_ns, read_times},
    wrong_size,
};
use crate::model::address::ImagesAddress;
use crate::{
    capture::image_file::{self, GreyImage},
    model::{clock::Clock, stop::StopSignal},
};

/// Endings of the files that are played of a folder.
const ENDINGS: [&str; 5] = ["png", "jpg", "jpeg", "pgm", "bmp"];

/// Which file is due when.
#[derive(Debug)]
pub(super) struct Schedule {
    files: Vec<PathBuf>,
    timing: Timing,
    repeat: bool,
}

#[derive(Debug)]
enum Timing {
    Rate { start: Timestamp, fps: f64 },
    Times { times: Vec<Timestamp>, cycle_ns: i64 },
}

impl Schedule {
    /// Lists the files and their times; `start` is when the first one is due where a rate is given.
    pub(super) fn read(
        address: &ImagesAddress,
        playback: &Playback,
        start: Timestamp,
    ) -> Result<Self, SourceError> {
        let files = list_files(&address.pattern).map_err(SourceError::Failed)?;
        let timing = match &address.times {
            None => Timing::Rate { start, fps: address.rate_hz() },
            Some(path) => {
                let mut times =
                    read_times(path).map_err(|error| SourceError::Failed(error.to_string()))?;
                if times.len() != files.len() {
                    return Err(SourceError::Failed(format!(
                        "{}: expected one capture time for each of the {} images of {}, found {}",
                        path.display(),
                        files.len(),
                        address.pattern,
                        times.len()
                    )));
                }
                let shift_ns = playback.origin.ns_since(playback.zero.unwrap_or(times[0]));
                let own_round_ns =
                    times[times.len() - 1].ns_since(times[0]) + mean_interval_ns(&times);
                for time in &mut times {
                    *time = time.plus_ns(shift_ns);
                }
                Timing::Times { times, cycle_ns: playback.cycle_ns.max(own_round_ns) }
            }
        };
        Ok(Self { files, timing, repeat: address.repeat })
    }

    /// When frame number `frame` is due, from 0; `None` after the last one.
    fn due(&self, frame: u64) -> Option<Timestamp> {
        let count = self.files.len() as u64;
        if frame >= count && !self.repeat {
            return None;
        }
        Some(match &self.timing {
            Timing::Rate { start, fps } => start.plus_seconds(frame as f64 / fps),
            Timing::Times { times, cycle_ns } => {
                let round = i64::try_from(frame / count).unwrap_or(i64::MAX);
                times[(frame % count) as usize].plus_ns(cycle_ns.saturating_mul(round))
            }
        })
    }

    fn file(&self, frame: u64) -> &Path {
        &self.files[(frame % self.files.len() as u64) as usize]
    }

    /// The newest frame from `next` on that is due at `now`, or `next` itself if none is.
    fn newest_due(&self, next: u64, now: Timestamp) -> u64 {
        let is_due = |frame: u64| self.due(frame).is_some_and(|due| due <= now);
        // Doubling steps, then halving: a source that comes back after an hour finds its place.
        let (mut newest, mut step) = (next, 1);
        while is_due(newest + step) {
            newest += step;
            step *= 2;
        }
        while step > 0 {
            if is_due(newest + step) {
                newest += step;
            }
            step /= 2;
        }
        newest
    }
}

pub(super) struct ImageSource {
    schedule: Schedule,
    size: (usize, usize),
    clock: Clock,
    stop: StopSignal,
    image: GreyImage,
    next: u64,
    /// The first frame after opening is never late.
    first: bool,
}

impl ImageSource {
    pub(super) fn new(
        schedule: Schedule,
        size: (usize, usize),
        clock: Clock,
        stop: StopSignal,
    ) -> Self {
        let image = GreyImage::default();
        Self { schedule, size, clock, stop, image, next: 0, first: true }
    }
}

impl FrameSource for ImageSource {
    fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
        let frame = self.schedule.newest_due(self.next, self.clock.now());
        let due = self.schedule.due(frame).ok_or(SourceError::Finished)?;
        let skipped = if self.first { 0 } else { frame - self.next };
        // Decoded before it is due, so that decoding costs no latency.
        let path = self.schedule.file(frame);
        let begun = Instant::now();
        self.image =
            image_file::load(path).map_err(|error| SourceError::Failed(error.to_string()))?;
        let decoding = begun.elapsed();
        let found = (self.image.width, self.image.height);
        if found != self.size {
            return Err(wrong_size(&path.display().to_string(), self.size, found));
        }
        if self.stop.wait(self.clock.until(due)) {
            return Err(SourceError::Stopped);
        }
        (self.next, self.first) = (frame + 1, false);
        let info = FrameInfo { skipped, decoding, ..FrameInfo::at(due) };
        Ok(LentFrame { frame: self.image.frame().map_err(bad_frame)?, info })
    }
}

/// The image files of a folder, or those that a pattern matches, in the natural order of their names.
pub(super) fn list_files(pattern: &str) -> Result<Vec<PathBuf>, String> {
    let folder = Path::new(pattern);
    let is_folder = folder.is_dir();
    let mut files: Vec<PathBuf> = if is_folder {
        let entries = folder
            .read_dir()
            .map_err(|error| format!("cannot list the folder {pattern}: {error}"))?;
        entries.flatten().map(|entry| entry.path()).filter(|path| has_image_ending(path)).collect()
    } else {
        glob::glob(pattern)
            .map_err(|error| format!("pattern {pattern}: {error}"))?
            .flatten()
            .filter(|path| path.is_file())
            .collect()
    };
    if files.is_empty() {
        return Err(if is_folder {
            format!("folder {pattern} has no PNG, JPEG, PGM or BMP files: put frames there")
        } else {
            format!("no file matches {pattern}: check the path, or put frames there")
        });
    }
    alphanumeric_sort::sort_path_slice(&mut files);
    Ok(files)
}

fn has_image_ending(path: &Path) -> bool {
    let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
    ENDINGS.iter().any(|known| ending.eq_ignore_ascii_case(known)) && path.is_file()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn schedule(timing: Timing, files: usize, repeat: bool) -> Schedule {
        let files = (0..files).map(|file| PathBuf::from(format!("{file}.png"))).collect();
        Schedule { files, timing, repeat }
    }

    fn ns(ns: i64) -> Timestamp {
        Timestamp::from_ns(ns)
    }

    #[test]
    fn late_callers_get_the_newest_frame_that_is_due() {
        let rate = schedule(Timing::Rate { start: ns(1000), fps: 1e8 }, 100, false);
        assert_eq!(rate.newest_due(0, ns(0)), 0);
        assert_eq!(rate.newest_due(0, ns(1009)), 0);
        for late in [10, 11, 25, 500, 987, 990] {
            let expected = (late / 10) as u64;
            assert_eq!(rate.newest_due(0, ns(1000 + late)), expected, "{late} ns late");
        }
        assert_eq!(rate.newest_due(3, ns(99_999)), 99);
        assert_eq!(rate.newest_due(100, ns(99_999)), 100);
        assert_eq!(rate.due(100), None);
    }

    #[test]
    fn rounds_follow_without_a_gap() {
        let times = vec![ns(10), ns(20), ns(35)];
        let rounds = schedule(Timing::Times { times, cycle_ns: 40 }, 3, true);
        let due: Vec<i64> = (0..7).map(|frame| rounds.due(frame).unwrap().as_ns()).collect();
        assert_eq!(due, [10, 20, 35, 50, 60, 75, 90]);
        assert_eq!(rounds.file(4), Path::new("1.png"));
        assert_eq!(rounds.newest_due(0, ns(40_000_020)), 3_000_001);
    }

    #[test]
    fn files_come_in_natural_order_and_others_are_left_out() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["10.PNG", "9.png", "notes.txt", "1.bmp", "09.png"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let names = |files: Vec<PathBuf>| -> Vec<String> {
            files.iter().map(|f| f.file_name().unwrap().to_string_lossy().into_owned()).collect()
        };
        let path = folder.path().to_str().unwrap();
        assert_eq!(names(list_files(path).unwrap()), ["1.bmp", "9.png", "09.png", "10.PNG"]);
        assert_eq!(names(list_files(&format!("{path}/*.png")).unwrap()), ["9.png", "09.png"]);
        assert!(list_files(&format!("{path}/x*")).unwrap_err().contains("no file matches"));
        let missing = list_files(&format!("{path}/sub")).unwrap_err();
        assert!(missing.contains("no file matches"), "{missing}");
    }
}
