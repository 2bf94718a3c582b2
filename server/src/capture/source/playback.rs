//! When recorded and simulated frames are due: one time line for all cameras of an installation.
//!
//! Playback begins at one instant of the server's clock, the *origin*, shortly after the start so
//! that every camera is ready. `images:` with `fps=` shows its first file there; of all `times=`
//! files together the earliest time falls there, and the others keep their distance to it, so that
//! cameras stay as they were to one another. With `clock=file` the server's clock itself is set so
//! that this earliest time *is* the origin: capture times are then those of the files, verbatim, and
//! snapshots are on the same time, which is what comparing with a recorded truth needs.

use std::{
    fs, io,
    path::{Path, PathBuf},
    time::Instant,
};

use roundel_core::time::Timestamp;
use thiserror::Error;

use crate::model::address::SourceAddress;
use crate::model::clock::Clock;

/// From the server's start to the origin.
const START_DELAY_NS: i64 = 500_000_000;

/// The time line of recorded and simulated frames.
#[derive(Clone, Copy, Debug)]
pub struct Playback {
    /// The instant at which it begins, on the server's clock.
    pub origin: Timestamp,
    /// The file time that falls on the origin; `None` without readable times.
    pub zero: Option<Timestamp>,
    /// Length of one round of all `times=` files, for `loop=true`, ns.
    pub cycle_ns: i64,
}

/// Why a file of capture times cannot be used.
#[derive(Debug, Error)]
pub enum TimesError {
    /// It cannot be read.
    #[error("cannot read the capture times {}: {source}", .path.display())]
    Read { path: PathBuf, source: io::Error },
    /// A line is no time.
    #[error("{}:{line}: expected nanoseconds since the Unix epoch, found {found:?}", .path.display())]
    Line {
        path: PathBuf,
        /// From 1.
        line: usize,
        found: String,
    },
    /// Times go backwards or stand still.
    #[error("{}:{line}: expected a time after that of the line before, found {found}", .path.display())]
    Order {
        path: PathBuf,
        /// From 1.
        line: usize,
        found: i64,
    },
    /// There is none.
    #[error("{}: expected capture times, one a line, found none", .path.display())]
    Empty { path: PathBuf },
}

impl Playback {
    /// The server's clock and the time line of these sources. Times that cannot be read are left to
    /// the camera that needs them, which fails and tries again, except where the clock depends on
    /// them.
    pub fn begin<'a>(
        addresses: impl Iterator<Item = &'a SourceAddress> + Clone,
    ) -> Result<(Clock, Self), TimesError> {
        let file_clock = addresses.clone().any(SourceAddress::follows_file_clock);
        let (mut zero, mut end): (Option<Timestamp>, Option<Timestamp>) = (None, None);
        for address in addresses {
            let SourceAddress::Images(images) = address else { continue };
            let Some(path) = &images.times else { continue };
            match read_times(path) {
                Ok(times) => {
                    let (first, last) = (times[0], times[times.len() - 1]);
                    zero = Some(zero.map_or(first, |zero| zero.min(first)));
                    let round_end = last.plus_ns(mean_interval_ns(&times));
                    end = Some(end.map_or(round_end, |end| end.max(round_end)));
                }
                Err(error) if images.file_clock => return Err(error),
                Err(_) => {}
            }
        }
        let clock = match zero.filter(|_| file_clock) {
            Some(zero) => Clock::anchored(Instant::now(), zero.plus_ns(-START_DELAY_NS)),
            None => Clock::anchored_now(),
        };
        let cycle_ns = zero.zip(end).map_or(0, |(zero, end)| end.ns_since(zero));
        Ok((clock, Self { origin: clock.start().plus_ns(START_DELAY_NS), zero, cycle_ns }))
    }
}

/// Mean distance of increasing times; a second for a single one.
pub(super) fn mean_interval_ns(times: &[Timestamp]) -> i64 {
    match times {
        [first, .., last] => last.ns_since(*first) / (times.len() as i64 - 1),
        _ => 1_000_000_000,
    }
}

/// Reads a file of increasing times, at least one; empty lines and `#` comments are skipped.
pub(super) fn read_times(path: &Path) -> Result<Vec<Timestamp>, TimesError> {
    let at = || path.to_owned();
    let text =
        fs::read_to_string(path).map_err(|source| TimesError::Read { path: at(), source })?;
    let mut times: Vec<Timestamp> = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let content = line.split('#').next().unwrap_or_default().trim();
        if content.is_empty() {
            continue;
        }
        let line = index + 1;
        let ns: i64 = content.parse().map_err(|_| TimesError::Line {
            path: at(),
            line,
            found: content.chars().take(40).collect(),
        })?;
        if times.last().is_some_and(|last| last.as_ns() >= ns) {
            return Err(TimesError::Order { path: at(), line, found: ns });
        }
        times.push(Timestamp::from_ns(ns));
    }
    if times.is_empty() {
        return Err(TimesError::Empty { path: at() });
    }
    Ok(times)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(folder: &Path, options: &str) -> SourceAddress {
        SourceAddress::parse(&format!("images:x?{options}"), folder).unwrap()
    }

    #[test]
    fn the_earliest_time_of_all_cameras_is_the_origin() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("a"), "# ns\n1000\n\n3000\n5000 # last\n").unwrap();
        fs::write(folder.path().join("b"), "400\n2400\n").unwrap();
        let path = folder.path();
        let server = [address(path, "times=a"), address(path, "times=b"), address(path, "fps=1")];
        let (clock, playback) = Playback::begin(server.iter()).unwrap();
        assert_eq!(playback.zero, Some(Timestamp::from_ns(400)));
        assert_eq!(playback.cycle_ns, 7000 - 400);
        assert_eq!(playback.origin, clock.start().plus_ns(START_DELAY_NS));

        let file = [address(path, "times=a"), address(path, "times=b&clock=file")];
        let (clock, playback) = Playback::begin(file.iter()).unwrap();
        assert_eq!(playback.origin, Timestamp::from_ns(400));
        assert!(clock.now() >= Timestamp::from_ns(400 - START_DELAY_NS));
        assert!(clock.now().seconds_since(playback.origin) < 3600.0);
    }

    #[test]
    fn a_clock_cannot_follow_a_missing_file() {
        let missing = [address(Path::new("/nowhere"), "times=t&clock=file")];
        let error = Playback::begin(missing.iter()).unwrap_err().to_string();
        assert!(error.contains("cannot read the capture times /nowhere/t"), "{error}");
        let server = [address(Path::new("/nowhere"), "times=t")];
        assert!(Playback::begin(server.iter()).unwrap().1.zero.is_none());
    }

    #[test]
    fn wrong_times_are_named_with_their_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("times.txt");
        for (text, expected) in [
            (
                "1\n2\nthree\n",
                "times.txt:3: expected nanoseconds since the Unix epoch, found \"three\"",
            ),
            ("5\n\n5\n", "times.txt:3: expected a time after that of the line before, found 5"),
            ("# none\n", "times.txt: expected capture times, one a line, found none"),
        ] {
            fs::write(&path, text).unwrap();
            let error = read_times(&path).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
