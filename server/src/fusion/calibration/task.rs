//! Recording → solving → taking over, on a thread of its own.

use std::{
    collections::BTreeMap,
    sync::Arc,
    time::{Duration, Instant},
};

use roundel_core::{
    calib::arena::{ArenaCamera, ArenaError, ArenaParams, LensDeviation, Recording, calibrate},
    camera::Camera,
    id::CameraId,
};
use tokio::sync::broadcast::error::TryRecvError;

use super::{
    ApplyPolicy, CalibrationRequest, CalibrationStage, CalibrationStatus, Shared, lock,
    recorder::DetectionRecorder,
    report::{CalibrationReport, InstallationNames, report},
};
use crate::model::{hub::EventKind, stop::StopSignal};

/// Between two looks for new frames; the hub keeps those of a quarter of a second.
const POLL_INTERVAL: Duration = Duration::from_millis(5);
/// Between two reports of progress.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(200);

/// Cameras that stand, with the lenses that they use.
type Lenses = BTreeMap<CameraId, Camera>;

/// Answers requests until the signal comes.
pub(super) fn run(shared: &Shared, request: CalibrationRequest, stop: &StopSignal) {
    let lenses = shared.lenses();
    let recording = record(shared, &request, &lenses, stop);
    let outcome = recording
        .ok_or_else(|| "cancelled".to_owned())
        .and_then(|recording| solve(shared, &request, &recording, &lenses, stop));
    match outcome {
        Ok(report) => shared.done(&request, report),
        Err(why) => shared.failed(why),
    }
}

/// `None`: it was cancelled.
fn record(
    shared: &Shared,
    request: &CalibrationRequest,
    lenses: &Lenses,
    stop: &StopSignal,
) -> Option<Recording> {
    let mut frames = shared.hub.observations();
    let mut recorder = DetectionRecorder::new(lenses.iter().map(|(id, lens)| (*id, lens.clone())));
    let length = Duration::from_secs_f64(request.seconds);
    let begun = Instant::now();
    let mut reported = begun;
    loop {
        match frames.try_recv() {
            Ok(frame) => {
                recorder.add(&frame);
                continue;
            }
            // Those that are missed are missing in the recording, which does it no harm.
            Err(TryRecvError::Lagged(_)) => continue,
            Err(TryRecvError::Empty | TryRecvError::Closed) => {}
        }
        if begun.elapsed() >= length {
            break;
        }
        if stop.wait(POLL_INTERVAL) {
            return None;
        }
        if reported.elapsed() >= PROGRESS_INTERVAL {
            reported = Instant::now();
            shared.recorded(begun.elapsed().min(length), &recorder);
        }
    }
    shared.recorded(length, &recorder);
    Some(recorder.into_recording())
}

fn solve(
    shared: &Shared,
    request: &CalibrationRequest,
    recording: &Recording,
    lenses: &Lenses,
    stop: &StopSignal,
) -> Result<CalibrationReport, String> {
    shared.status.send_modify(|status| status.stage = CalibrationStage::Solving);
    let lens_deviation = request.refine_lenses.then(LensDeviation::default);
    let camera = |(id, lens): (&CameraId, &Camera)| ArenaCamera {
        id: *id,
        lens: lens.clone(),
        lens_deviation,
    };
    let cameras: Vec<ArenaCamera> = lenses.iter().map(camera).collect();
    // The other half of the cores is for those who are being served.
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let pool = rayon::ThreadPoolBuilder::new().num_threads((cores / 2).max(1)).build();
    let pool = pool.map_err(|error| format!("the solver gets no threads: {error}"))?;
    let begun = Instant::now();
    let found = pool.install(|| {
        calibrate(recording, &cameras, &shared.landmarks, &ArenaParams::default(), |progress| {
            shared.status.send_modify(|status| status.steps = progress.step);
            !stop.is_stopped()
        })
    });
    let installation = shared.hub.installation();
    match found {
        Ok(found) => {
            let states = shared.hub.cameras();
            Ok(report(found, &installation, &states, begun.elapsed().as_secs_f64()))
        }
        Err(ArenaError::Cancelled) => Err("cancelled".to_owned()),
        Err(error) => Err(error.told(&InstallationNames(&installation))),
    }
}

impl Shared {
    /// Those that stand and whose lens is known.
    fn lenses(&self) -> Lenses {
        let states = self.hub.cameras();
        let cameras = lock(&self.cameras);
        let standing = cameras.iter().filter(|(_, camera)| camera.configured.is_some());
        standing.filter_map(|(id, _)| Some((*id, states.get(id)?.camera.clone()?))).collect()
    }

    pub(super) fn begin(&self, request: &CalibrationRequest) {
        let (stage, seconds) = (CalibrationStage::Recording, request.seconds);
        self.status.send_replace(CalibrationStatus {
            stage,
            seconds,
            ..CalibrationStatus::default()
        });
        let message =
            format!("The arena's calibration records for {seconds:.0} s: let robots drive.");
        self.report_event(EventKind::CalibrationBegun, message);
    }

    fn recorded(&self, so_far: Duration, recorder: &DetectionRecorder) {
        self.status.send_modify(|status| {
            status.recorded_s = so_far.as_secs_f64();
            status.cameras = recorder.cameras();
        });
    }

    fn failed(&self, why: String) {
        let message = format!("The arena's calibration gave no result: {why}.");
        self.status.send_modify(|status| {
            status.stage = CalibrationStage::Failed;
            status.error = why;
        });
        self.report_event(EventKind::CalibrationFailed, message);
    }

    fn done(&self, request: &CalibrationRequest, report: CalibrationReport) {
        let report = Arc::new(report);
        let is_wanted = match request.apply {
            ApplyPolicy::Always => true,
            ApplyPolicy::IfSound => report.is_sound(),
            ApplyPolicy::Never => false,
        };
        let count = report.cameras.len();
        let message = match is_wanted {
            true => format!("The arena's calibration placed {count} cameras."),
            false => format!(
                "The arena's calibration placed {count} cameras; look at its report before they take it over."
            ),
        };
        self.status.send_modify(|status| status.report = Some(report.clone()));
        self.report_event(EventKind::CalibrationDone, message);
        if is_wanted {
            self.apply(&report);
        }
        self.status.send_modify(|status| status.stage = CalibrationStage::Done);
    }

    pub(super) fn report_event(&self, kind: EventKind, message: String) {
        tracing::info!("{message}");
        self.hub.publish_event(self.clock.now(), kind, message);
    }
}
