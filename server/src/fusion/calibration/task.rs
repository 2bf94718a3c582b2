//! The calibration thread: records, solves, and applies the result.

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

/// The hub holds the frames of a quarter of a second.
const POLL_INTERVAL: Duration = Duration::from_millis(5);
const PROGRESS_INTERVAL: Duration = Duration::from_millis(200);

/// Lenses of the fixed cameras.
type Lenses = BTreeMap<CameraId, Camera>;

/// The last change of the status is that to a final stage, from which on the next calibration may start.
pub(super) fn run(shared: &Shared, request: CalibrationRequest, stop: &StopSignal) {
    let lenses = shared.lenses();
    let recording = record(shared, request.seconds, &lenses, stop);
    let outcome = recording
        .ok_or_else(|| "cancelled".to_owned())
        .and_then(|recording| solve(shared, &request, &recording, &lenses, stop));
    match outcome {
        Ok(report) => shared.done(request.apply, report),
        Err(why) => {
            let message = format!("The calibration of the arena failed: {why}.");
            shared.report_event(EventKind::CalibrationFailed, message);
            shared.status.send_modify(|status| {
                status.stage = CalibrationStage::Failed;
                status.error = why;
            });
        }
    }
}

/// Returns `None` if it was cancelled.
fn record(shared: &Shared, seconds: f64, lenses: &Lenses, stop: &StopSignal) -> Option<Recording> {
    let mut frames = shared.hub.observations();
    let mut recorder = DetectionRecorder::new(lenses);
    let report = |recorder: &DetectionRecorder, so_far: Duration| {
        shared.status.send_modify(|status| {
            status.recorded_s = so_far.as_secs_f64();
            status.cameras = recorder.cameras();
        });
    };
    let length = Duration::from_secs_f64(seconds);
    let begun = Instant::now();
    let mut reported = begun;
    loop {
        match frames.try_recv() {
            Ok(frame) => {
                recorder.add(&frame);
                continue;
            }
            // Missed frames do the recording no harm.
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
            report(&recorder, begun.elapsed().min(length));
        }
    }
    report(&recorder, length);
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
    // The other half of the cores serves the cameras.
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let pool = rayon::ThreadPoolBuilder::new().num_threads((cores / 2).max(1)).build();
    let pool = pool.map_err(|error| format!("cannot start the threads of the solver: {error}"))?;
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
        Err(error) => Err(error.message(&InstallationNames(&installation))),
    }
}

impl Shared {
    fn lenses(&self) -> Lenses {
        let states = self.hub.cameras();
        let cameras = lock(&self.cameras);
        let fixed = cameras.iter().filter(|(_, camera)| camera.configured.is_some());
        fixed.filter_map(|(id, _)| Some((*id, states.get(id)?.camera.clone()?))).collect()
    }

    pub(super) fn begin(&self, seconds: f64) {
        let stage = CalibrationStage::Recording;
        self.status.send_replace(CalibrationStatus { stage, seconds, ..Default::default() });
        let message =
            format!("The calibration of the arena records for {seconds:.0} s: let robots drive.");
        self.report_event(EventKind::CalibrationBegun, message);
    }

    fn done(&self, policy: ApplyPolicy, report: CalibrationReport) {
        let report = Arc::new(report);
        let is_applied = match policy {
            ApplyPolicy::Always => true,
            ApplyPolicy::IfSound => report.is_sound(),
            ApplyPolicy::Never => false,
        };
        let mut message =
            format!("The calibration of the arena localized {} cameras", report.cameras.len());
        if !is_applied {
            message.push_str("; check its report before applying it");
        }
        self.status.send_modify(|status| status.report = Some(report.clone()));
        self.report_event(EventKind::CalibrationDone, message + ".");
        if is_applied {
            self.apply(&report);
        }
        self.status.send_modify(|status| status.stage = CalibrationStage::Done);
    }

    pub(super) fn report_event(&self, kind: EventKind, message: String) {
        tracing::info!("{message}");
        self.hub.publish_event(self.clock.now(), kind, message);
    }
}
