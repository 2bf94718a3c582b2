//! One try of a source: what it gives, before a camera is configured with it.
//!
//! The source is opened beside everything that runs, for a few seconds, on the caller's thread. Nothing of what it gives
//! goes to fusion. Of a source whose size nobody has said the first picture tells.

use std::{
    path::PathBuf,
    sync::{Mutex, PoisonError, TryLockError},
    thread,
    time::{Duration, Instant},
};

use roundel_core::{
    camera::{Camera, Intrinsics, Lens},
    frame::MAX_SIDE_PX,
    id::CameraId,
    marker::{Kind, Mask, Mode, Params},
};
use thiserror::Error;

use crate::{
    capture::{
        source::{FrameSource, OpenSource, Playback, SourceError, SourceOpener},
        worker::{
            pipeline::{FrameHeader, Pipeline, PipelineParts},
            statistics::RunningMedian,
        },
    },
    model::{
        address::{AddressError, SourceAddress},
        capture_clock::CaptureClock,
        clock::Clock,
        simulated::simulated_camera,
        stop::StopSignal,
    },
};

/// Frames are looked at for so long …
const PROBE_DURATION: Duration = Duration::from_secs(2);
/// … and all together, the first frame included, it takes no longer than this.
const PROBE_TIMEOUT: Duration = Duration::from_secs(15);
/// Asked of a camera that lets one choose, where nobody says a size.
const DEFAULT_SIZE: (usize, usize) = (1280, 720);

#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProbeReport {
    /// Why there are no frames, or no more, and what to do; empty if all is well.
    pub error: String,
    /// Of its pictures; 0 before one.
    pub width: usize,
    pub height: usize,
    pub frames: u64,
    pub broken: u64,
    /// Frames a second; 0 of fewer than two.
    pub rate_hz: f64,
    /// Frames a second that it says it gives; 0: it does not say.
    pub promised_hz: f64,
    pub capture_clock: Option<CaptureClock>,
    /// Roundels in the newest frame.
    pub roundels: usize,
    /// Median, milliseconds.
    pub decode_ms: f64,
    /// Following and searching, median, milliseconds.
    pub detect_ms: f64,
}

#[derive(Debug, Error)]
pub enum ProbeError {
    /// The address is none.
    #[error(transparent)]
    Address(#[from] AddressError),
    /// The size is none.
    #[error(
        "width and height: expected 1 to {MAX_SIDE_PX} pixels each, or neither, found {0} x {1}"
    )]
    Size(usize, usize),
    #[error(
        "a `push:` camera is fed by a program, so there is nothing to be opened: configure it, and look whether frames arrive"
    )]
    Fed,
    /// One at a time: each takes a processor.
    #[error("another source is being tried; try again in a few seconds")]
    Busy,
    /// Kinds of roundel that cannot be searched for, or the like.
    #[error("internal error, please report it: {0}")]
    Internal(String),
}

/// Tries sources, one at a time.
pub struct SourceProbe {
    kinds: Vec<Kind>,
    /// Relative paths begin here.
    folder: PathBuf,
    clock: Clock,
    playback: Playback,
    busy: Mutex<()>,
}

impl SourceProbe {
    /// Searches for these kinds of roundel; relative paths begin in that folder.
    pub fn new(kinds: Vec<Kind>, folder: PathBuf, clock: Clock, playback: Playback) -> Self {
        Self { kinds, folder, clock, playback, busy: Mutex::default() }
    }

    /// Opens the source and looks at what it gives for two seconds; blocks as long, and 15 s at most.
    pub fn probe(
        &self,
        source: &str,
        size: Option<(usize, usize)>,
    ) -> Result<ProbeReport, ProbeError> {
        let _alone = match self.busy.try_lock() {
            Ok(guard) => guard,
            Err(TryLockError::WouldBlock) => return Err(ProbeError::Busy),
            // What panicked left nothing behind that could do harm.
            Err(TryLockError::Poisoned(poisoned)) => PoisonError::into_inner(poisoned),
        };
        let address = SourceAddress::parse(source, &self.folder)?;
        let own_size = match &address {
            SourceAddress::Push(_) => return Err(ProbeError::Fed),
            SourceAddress::Sim(sim) => {
                let camera = simulated_camera(sim)
                    .map_err(|error| ProbeError::Internal(error.to_string()))?
                    .camera;
                Some((camera.width(), camera.height()))
            }
            _ => None,
        };
        if let Some((width, height)) = size
            && ![width, height].iter().all(|side| (1..=MAX_SIDE_PX).contains(side))
        {
            return Err(ProbeError::Size(width, height));
        }
        // Whatever a source waits for ends with this.
        let (stop, done) = (StopSignal::default(), StopSignal::default());
        let (stopping, waiting) = (stop.clone(), done.clone());
        let watchdog = thread::spawn(move || {
            if !waiting.wait(PROBE_TIMEOUT) {
                stopping.stop();
            }
        });
        let report = self.with_size(&address, own_size.or(size), &stop);
        done.stop();
        // It waits for nothing else.
        let _ = watchdog.join();
        report
    }

    fn with_size(
        &self,
        address: &SourceAddress,
        size: Option<(usize, usize)>,
        stop: &StopSignal,
    ) -> Result<ProbeReport, ProbeError> {
        let (report, found) = self.open_and_measure(address, size.unwrap_or(DEFAULT_SIZE), stop)?;
        match found {
            Some(found) if size.is_none() => Ok(self.open_and_measure(address, found, stop)?.0),
            _ => Ok(report),
        }
    }

    /// What pictures of that size give, or another size that they have.
    fn open_and_measure(
        &self,
        address: &SourceAddress,
        size: (usize, usize),
        stop: &StopSignal,
    ) -> Result<(ProbeReport, Option<(usize, usize)>), ProbeError> {
        let mut pipeline = self.pipeline(size)?;
        let mut report = ProbeReport::default();
        let (clock, playback) = (self.clock, self.playback);
        let mut opener = SourceOpener::new(address.clone(), size, clock, playback, stop.clone());
        let outcome = opener
            .open()
            .and_then(|mut source| self.measure(&mut *source, &mut pipeline, &mut report));
        let found = match outcome {
            Ok(()) => None,
            Err(SourceError::Size { found, .. }) if report.frames == 0 => Some(found),
            Err(error) => {
                // That a recording has an end is no failure.
                let finished = error == SourceError::Finished && report.frames > 0;
                if !finished {
                    report.error = error_message(&error);
                }
                None
            }
        };
        if let Some(found) = found {
            let (width, height) = size;
            report.error = format!(
                "expected pictures of {width} x {height} pixels, found {} x {}",
                found.0, found.1
            );
        }
        Ok((report, found))
    }

    fn measure(
        &self,
        source: &mut dyn FrameSource,
        pipeline: &mut Pipeline,
        report: &mut ProbeReport,
    ) -> Result<(), SourceError> {
        let (mut decode_ms, mut detect_ms) = (RunningMedian::default(), RunningMedian::default());
        let (mut begun, mut came): (Option<Instant>, u64) = (None, 0);
        loop {
            let lent = source.next_frame()?;
            let now = Instant::now();
            let since = *begun.get_or_insert(now);
            let info = &lent.info;
            if report.frames > 0 {
                came += 1 + info.skipped + info.broken;
                report.rate_hz = came as f64 / (now - since).as_secs_f64().max(1e-3);
            }
            report.frames += 1;
            report.broken += info.broken;
            report.capture_clock = Some(info.clock);
            (report.width, report.height) = (lent.frame.width(), lent.frame.height());
            let seen = pipeline.process(
                &lent.frame,
                &FrameHeader {
                    camera: CameraId(0),
                    calibration_version: 0,
                    frame: report.frames,
                    capture_time: info.capture_time,
                    received_time: self.clock.now(),
                },
            );
            pipeline.seek(&lent.frame);
            report.roundels = seen.detections.len();
            decode_ms.add(info.decoding.as_secs_f64() * 1e3);
            detect_ms.add(pipeline.times().find_ms);
            (report.decode_ms, report.detect_ms) = (decode_ms.value(), detect_ms.value());
            report.promised_hz = source.promised_hz().unwrap_or(0.0);
            if since.elapsed() >= PROBE_DURATION {
                return Ok(());
            }
        }
    }

    /// Searches only: no lens is known, and no pose is asked for.
    fn pipeline(&self, (width, height): (usize, usize)) -> Result<Pipeline, ProbeError> {
        let internal = |error: &dyn std::fmt::Display| ProbeError::Internal(error.to_string());
        let camera = Camera::new(Intrinsics {
            width,
            height,
            fx_px: width as f64,
            fy_px: width as f64,
            cx_px: 0.5 * (width as f64 - 1.0),
            cy_px: 0.5 * (height as f64 - 1.0),
            lens: Lens::PlumbBob([0.0; 5]),
        });
        Pipeline::new(PipelineParts {
            kinds: self.kinds.clone(),
            params: Params { mode: Mode::Fast, ..Params::default() },
            mask: Mask::default(),
            camera: camera.map_err(|error| internal(&error))?,
            line_time_s: 0.0,
            counts: Default::default(),
        })
        .map_err(|error| internal(&error))
    }
}

fn error_message(error: &SourceError) -> String {
    match error {
        SourceError::Stopped => {
            format!("no answer: it was given up after {} s", PROBE_TIMEOUT.as_secs())
        }
        SourceError::Finished => "it has no frames".to_owned(),
        error => error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source_probe(folder: &std::path::Path) -> SourceProbe {
        let (clock, playback) = Playback::begin(std::iter::empty()).unwrap();
        let kinds = vec![Kind::plain("robot", 0.16, 0.064)];
        SourceProbe::new(kinds, folder.to_owned(), clock, playback)
    }

    /// White, with a black ring of 20 px round a white disc.
    fn draw(folder: &std::path::Path) {
        let level = |u: f64, v: f64| {
            let radius = (u - 80.0).hypot(v - 60.0);
            let ink = (20.5 - radius).clamp(0.0, 1.0) - (8.5 - radius).clamp(0.0, 1.0);
            (220.0 - 190.0 * ink).round() as u8
        };
        let pixels =
            (0..120).flat_map(|v| (0..160).map(move |u| level(f64::from(u), f64::from(v))));
        let file: Vec<u8> = b"P5\n160 120\n255\n".iter().copied().chain(pixels).collect();
        std::fs::write(folder.join("0.pgm"), &file).unwrap();
    }

    #[test]
    fn a_source_says_its_size_rate_and_what_it_shows() {
        let folder = tempfile::tempdir().unwrap();
        draw(folder.path());
        let source_probe = source_probe(folder.path());
        let report = source_probe.probe("images:*.pgm?fps=20&loop=true", None).unwrap();
        assert_eq!((report.error.as_str(), report.width, report.height), ("", 160, 120));
        assert_eq!((report.roundels, report.capture_clock), (1, Some(CaptureClock::EXACT)));
        assert!(report.frames > 1 && (report.rate_hz / 20.0 - 1.0).abs() < 0.3, "{report:?}");
        // A size that is said is insisted on.
        let report = source_probe.probe("images:*.pgm", Some((320, 240))).unwrap();
        assert_eq!(report.error, "expected pictures of 320 x 240 pixels, found 160 x 120");
        // One picture is no failure.
        let report = source_probe.probe("images:*.pgm", None).unwrap();
        assert_eq!((report.error.as_str(), report.frames, report.rate_hz), ("", 1, 0.0));
    }

    #[test]
    fn what_cannot_be_tried_says_why() {
        let folder = tempfile::tempdir().unwrap();
        let source_probe = source_probe(folder.path());
        let error = |source, size| match source_probe.probe(source, size) {
            Ok(report) => report.error,
            Err(error) => error.to_string(),
        };
        assert!(error("images:*.pgm", None).contains("no file matches"));
        assert!(error("htp://a/b", None).contains("did you mean `http:`?"));
        assert!(error("push:", None).contains("fed by a program"));
        assert!(error("sim:", Some((0, 7))).contains("found 0 x 7"));
        let closed = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let refused = error(&format!("http://{closed}/stream"), None);
        assert!(refused.contains("refused"), "{refused}");
    }
}
