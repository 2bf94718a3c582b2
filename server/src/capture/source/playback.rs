//! When recorded and simulated frames are due: one time line for all cameras of an installation.
//!
//! Playback begins at one instant of the server's clock, the *origin*, shortly after the start so that every camera is
//! ready. `images:` with `fps=` shows its first file there. The earliest time of all `times=` files falls there, and
//! the others keep their distance to it, so that cameras stay synchronized. With `clock=file` the server's clock is
//! set so that the earliest time *is* the origin: capture times and snapshots then have the times of the files, for
//! comparison with a recorded ground truth.

use std::{path::Path, time::Instant};

use roundel_core::time::Timestamp;
use thiserror::Error;

use crate::model::{address::SourceAddress, clock::Clock, regular_file};

/// From the server's start to the origin.
const START_DELAY_NS: i64 = 500_000_000;
/// A longer file has no capture times.
const MAX_TIMES_BYTES: u64 = 64 << 20;
const EXAMPLE_NS: i64 = 1_700_000_000_123_456_789;

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
#[error("{0}")]
pub struct TimesError(String);

impl Playback {
    /// The server's clock and the time line of these sources. A file that cannot be read is an error only if the clock
    /// depends on it; otherwise its camera fails and retries.
    pub fn begin<'a>(
        addresses: impl Iterator<Item = &'a SourceAddress> + Clone,
    ) -> Result<(Clock, Self), TimesError> {
        let file_clock = addresses.clone().any(SourceAddress::follows_file_clock);
        let mut rounds = Vec::new();
        for address in addresses {
            let SourceAddress::Images(images) = address else { continue };
            let Some(path) = &images.times else { continue };
            match read_times(path) {
                Ok(times) => {
                    let end = times[times.len() - 1].plus_ns(mean_interval_ns(&times));
                    rounds.push((times[0], end));
                }
                Err(error) if images.file_clock => return Err(error),
                Err(_) => {}
            }
        }
        let zero = rounds.iter().map(|(begin, _)| *begin).min();
        let end = rounds.iter().map(|(_, end)| *end).max();
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

/// Reads a file of increasing times, at least one; empty lines and `#` comments are skipped. Errors do not quote the
/// file, since clients can name it.
pub(super) fn read_times(path: &Path) -> Result<Vec<Timestamp>, TimesError> {
    let name = path.display();
    let text = regular_file::read_text(path, MAX_TIMES_BYTES)
        .map_err(|error| TimesError(format!("cannot read the capture times {name}: {error}")))?;
    let mut times: Vec<Timestamp> = Vec::new();
    for (line, text) in (1..).zip(text.lines()) {
        let content = text.split('#').next().unwrap_or_default().trim();
        if content.is_empty() {
            continue;
        }
        let ns: i64 = content.parse().map_err(|_| {
            TimesError(format!(
                "{name}:{line}: expected a whole number of nanoseconds since the Unix epoch, such as {EXAMPLE_NS}"
            ))
        })?;
        if times.last().is_some_and(|last| last.as_ns() >= ns) {
            return Err(TimesError(format!(
                "{name}:{line}: expected a time after that of the line before"
            )));
        }
        times.push(Timestamp::from_ns(ns));
    }
    if times.is_empty() {
        return Err(TimesError(format!("{name}: expected capture times, one a line, found none")));
    }
    Ok(times)
}

#[cfg(test)]
mod tests {
    use std::fs;

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
                "times.txt:3: expected a whole number of nanoseconds since the Unix epoch",
            ),
            ("5\n\n5\n", "times.txt:3: expected a time after that of the line before"),
            ("# none\n", "times.txt: expected capture times, one a line, found none"),
        ] {
            fs::write(&path, text).unwrap();
            let error = read_times(&path).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
            assert!(!error.contains("three"), "{error}");
        }
    }
}
