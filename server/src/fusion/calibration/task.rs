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
    Apply, Shared, Stage, Status, Wanted, lock,
    recorder::Recorder,
    report::{Configured, Report, report},
};
use crate::model::{hub::Happening, stop::Stop};

/// Between two looks for new frames; the hub keeps those of a quarter of a second.
const LOOK_EVERY: Duration = Duration::from_millis(5);
/// Between two reports of progress.
const TELL_EVERY: Duration = Duration::from_millis(200);

/// Cameras that stand, with the lenses that they use.
type Lenses = BTreeMap<CameraId, Camera>;

/// Does what is wanted, until the signal comes.
pub(super) fn run(shared: &Shared, wanted: Wanted, stop: &Stop) {
    let lenses = shared.lenses();
    let recording = record(shared, &wanted, &lenses, stop);
    let outcome = recording
        .ok_or_else(|| "cancelled".to_owned())
        .and_then(|recording| solve(shared, &wanted, &recording, &lenses, stop));
    match outcome {
        Ok(report) => shared.done(&wanted, report),
        Err(why) => shared.failed(why),
    }
}

/// `None`: it was cancelled.
fn record(shared: &Shared, wanted: &Wanted, lenses: &Lenses, stop: &Stop) -> Option<Recording> {
    let mut frames = shared.hub.observations();
    let mut recorder = Recorder::new(lenses.iter().map(|(id, lens)| (*id, lens.clone())));
    let length = Duration::from_secs_f64(wanted.seconds);
    let begun = Instant::now();
    let mut told = begun;
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
        if stop.wait(LOOK_EVERY) {
            return None;
        }
        if told.elapsed() >= TELL_EVERY {
            told = Instant::now();
            shared.recorded(begun.elapsed().min(length), &recorder);
        }
    }
    shared.recorded(length, &recorder);
    Some(recorder.into_recording())
}

fn solve(
    shared: &Shared,
    wanted: &Wanted,
    recording: &Recording,
    lenses: &Lenses,
    stop: &Stop,
) -> Result<Report, String> {
    shared.status.send_modify(|status| status.stage = Stage::Solving);
    let lens_deviation = wanted.refine_lenses.then(LensDeviation::default);
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
        Err(error) => Err(error.told(&Configured(&installation))),
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

    pub(super) fn begin(&self, wanted: &Wanted) {
        let (stage, seconds) = (Stage::Recording, wanted.seconds);
        self.status.send_replace(Status { stage, seconds, ..Status::default() });
        let message =
            format!("The arena's calibration records for {seconds:.0} s: let robots drive.");
        self.tell(Happening::CalibrationBegun, message);
    }

    fn recorded(&self, so_far: Duration, recorder: &Recorder) {
        self.status.send_modify(|status| {
            status.recorded_s = so_far.as_secs_f64();
            status.cameras = recorder.cameras();
        });
    }

    fn failed(&self, why: String) {
        let message = format!("The arena's calibration gave no result: {why}.");
        self.status.send_modify(|status| {
            status.stage = Stage::Failed;
            status.error = why;
        });
        self.tell(Happening::CalibrationFailed, message);
    }

    fn done(&self, wanted: &Wanted, report: Report) {
        let report = Arc::new(report);
        let is_wanted = match wanted.apply {
            Apply::Always => true,
            Apply::IfSound => report.is_sound(),
            Apply::Never => false,
        };
        let count = report.cameras.len();
        let message = match is_wanted {
            true => format!("The arena's calibration placed {count} cameras."),
            false => format!(
                "The arena's calibration placed {count} cameras; look at its report before they take it over."
            ),
        };
        self.status.send_modify(|status| status.report = Some(report.clone()));
        self.tell(Happening::CalibrationDone, message);
        if is_wanted {
            self.apply(&report);
        }
        self.status.send_modify(|status| status.stage = Stage::Done);
    }

    pub(super) fn tell(&self, happening: Happening, message: String) {
        tracing::info!("{message}");
        self.hub.publish_event(self.clock.now(), happening, message);
    }
}
