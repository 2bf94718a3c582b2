//! Probes a source before a camera is configured with it.
//!
//! The source is opened for a few seconds on the caller's thread, while cameras keep running. Nothing is sent to fusion.
//! If no size is given, the first picture determines it.

use std::{
    path::PathBuf,
    sync::{Arc, Mutex, PoisonError, TryLockError},
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
        source_rules::{SourceRuleError, SourceRules},
        stop::StopSignal,
    },
};

const PROBE_DURATION: Duration = Duration::from_secs(2);
/// Longest trial, including the time to the first frame.
const PROBE_TIMEOUT: Duration = Duration::from_secs(15);
/// Requested from a camera that supports several sizes, if no size is given.
const DEFAULT_SIZE: (usize, usize) = (1280, 720);

#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProbeReport {
    /// Why there are no frames, or no more, and what to do; empty without an error.
    pub error: String,
    /// Size of its pictures; 0 before the first one.
    pub width: usize,
    pub height: usize,
    pub frames: u64,
    pub broken: u64,
    /// 0 for fewer than two frames.
    pub rate_hz: f64,
    /// The rate that the source announces; 0: none.
    pub promised_hz: f64,
    pub capture_clock: Option<CaptureClock>,
    /// Roundels in the newest frame.
    pub roundels: usize,
    /// Median of all frames.
    pub decode_ms: f64,
    /// Median of following and searching.
    pub detect_ms: f64,
}

#[derive(Debug, Error)]
pub enum ProbeError {
    #[error(transparent)]
    Address(#[from] AddressError),
    #[error(transparent)]
    Rule(#[from] SourceRuleError),
    #[error(
        "width and height: expected 1 to {MAX_SIDE_PX} pixels each, or neither, found {0} x {1}"
    )]
    Size(usize, usize),
    #[error(
        "a `push:` camera is fed by a program, so there is nothing to open: configure it, and check whether frames arrive"
    )]
    Fed,
    #[error("another source is being tried; try again in a few seconds")]
    Busy,
    #[error("internal error, please report it: {0}")]
    Internal(String),
}

/// Tries sources, one at a time, since each takes a processor.
pub struct SourceProbe {
    kinds: Vec<Kind>,
    /// Base of relative paths.
    folder: PathBuf,
    clock: Clock,
    playback: Playback,
    busy: Mutex<()>,
}

impl SourceProbe {
    pub fn new(kinds: Vec<Kind>, folder: PathBuf, clock: Clock, playback: Playback) -> Self {
        Self { kinds, folder, clock, playback, busy: Mutex::default() }
    }

    /// Opens the source and processes its frames for [`PROBE_DURATION`]; blocks for at most [`PROBE_TIMEOUT`]. `admit`
    /// checks the source and returns the rules that bind it.
    pub fn probe(
        &self,
        source: &str,
        size: Option<(usize, usize)>,
        admit: impl Fn(&SourceAddress) -> Result<Option<Arc<SourceRules>>, SourceRuleError>,
    ) -> Result<ProbeReport, ProbeError> {
        let _alone = match self.busy.try_lock() {
            Ok(guard) => guard,
            Err(TryLockError::WouldBlock) => return Err(ProbeError::Busy),
            Err(TryLockError::Poisoned(poisoned)) => PoisonError::into_inner(poisoned),
        };
        let address = SourceAddress::parse(source, &self.folder)?;
        let rules = admit(&address)?;
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
        // The watchdog ends every wait of the source.
        let (stop, done) = (StopSignal::default(), StopSignal::default());
        let (stopping, waiting) = (stop.clone(), done.clone());
        let watchdog = thread::spawn(move || {
            if !waiting.wait(PROBE_TIMEOUT) {
                stopping.stop();
            }
        });
        let size = own_size.or(size);
        let opener = |size| {
            let (clock, playback) = (self.clock, self.playback);
            SourceOpener::new(address.clone(), size, clock, playback, stop.clone())
                .with_rules(rules.clone())
        };
        let first = size.unwrap_or(DEFAULT_SIZE);
        let mut outcome = self.try_size(first, opener(first));
        if size.is_none()
            && let Ok((_, Some(found))) = outcome
        {
            outcome = self.try_size(found, opener(found));
        }
        done.stop();
        let _ = watchdog.join();
        outcome.map(|(report, _)| report)
    }

    /// Expects pictures of that size; also returns another size that they have.
    fn try_size(
        &self,
        size: (usize, usize),
        mut opener: SourceOpener,
    ) -> Result<(ProbeReport, Option<(usize, usize)>), ProbeError> {
        let mut pipeline = search_pipeline(self.kinds.clone(), size)
            .map_err(|error| ProbeError::Internal(error.to_string()))?;
        let (mut report, mut other_size) = (ProbeReport::default(), None);
        let outcome = opener
            .open()
            .and_then(|mut source| self.measure(&mut *source, &mut pipeline, &mut report));
        report.error = match outcome {
            Ok(()) => String::new(),
            // The end of a recording is no error.
            Err(SourceError::Finished) if report.frames > 0 => String::new(),
            Err(SourceError::Finished) => "the source has no frames".to_owned(),
            Err(SourceError::Stopped) => {
                format!("no answer: the trial timed out after {} s", PROBE_TIMEOUT.as_secs())
            }
            Err(SourceError::Size { found, .. }) if report.frames == 0 => {
                other_size = Some(found);
                let ((width, height), (found_width, found_height)) = (size, found);
                format!(
                    "expected pictures of {width} x {height} pixels, found {found_width} x {found_height}"
                )
            }
            Err(error) => error.to_string(),
        };
        Ok((report, other_size))
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
}

/// A pipeline that only searches: its lens is arbitrary, because nothing uses the poses.
fn search_pipeline(
    kinds: Vec<Kind>,
    (width, height): (usize, usize),
) -> Result<Pipeline, Box<dyn std::error::Error>> {
    let camera = Camera::new(Intrinsics {
        width,
        height,
        fx_px: width as f64,
        fy_px: width as f64,
        cx_px: 0.5 * (width as f64 - 1.0),
        cy_px: 0.5 * (height as f64 - 1.0),
        lens: Lens::PlumbBob([0.0; 5]),
    })?;
    Ok(Pipeline::new(PipelineParts {
        kinds,
        params: Params { mode: Mode::Fast, ..Params::default() },
        mask: Mask::default(),
        camera,
        line_time_s: 0.0,
        counts: Default::default(),
    })?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::worker::pipeline::tests::frame;

    fn source_probe(folder: &std::path::Path) -> SourceProbe {
        let (clock, playback) = Playback::begin(std::iter::empty()).unwrap();
        let kinds = vec![Kind::plain("robot", 0.16, 0.064)];
        SourceProbe::new(kinds, folder.to_owned(), clock, playback)
    }

    #[test]
    fn a_report_has_size_rate_and_roundels() {
        let folder = tempfile::tempdir().unwrap();
        let pixels = frame(&[(80.0, 60.0)]);
        std::fs::write(folder.path().join("0.pgm"), [&b"P5 320 240 255\n"[..], &pixels].concat())
            .unwrap();
        let source_probe = source_probe(folder.path());
        let probe = |source, size| source_probe.probe(source, size, |_| Ok(None));
        let report = probe("images:*.pgm?fps=20&loop=true", None).unwrap();
        assert_eq!((report.error.as_str(), report.width, report.height), ("", 320, 240));
        assert_eq!((report.roundels, report.capture_clock), (1, Some(CaptureClock::EXACT)));
        assert!(report.frames > 1 && (report.rate_hz / 20.0 - 1.0).abs() < 0.3, "{report:?}");
        // A given size is required.
        let report = probe("images:*.pgm", Some((160, 120))).unwrap();
        assert_eq!(report.error, "expected pictures of 160 x 120 pixels, found 320 x 240");
        // A single picture is no error.
        let report = probe("images:*.pgm", None).unwrap();
        assert_eq!((report.error.as_str(), report.frames, report.rate_hz), ("", 1, 0.0));
    }

    #[test]
    fn errors_say_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        let source_probe = source_probe(folder.path());
        let error = |source, size| match source_probe.probe(source, size, |_| Ok(None)) {
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
