//! One calibration of a lens, on its thread: pictures until there is enough, then the solution.

use std::{sync::Arc, time::Instant};

use roundel_core::{
    calib::lens::{LensCalibrationError, View, calibrate},
    frame::Frame,
};

use super::{
    LensResult, LensRun, PictureSource, Shared,
    annotated_picture::AnnotatedPicture,
    board_search::{BoardSearch, CalibrationTarget, CollectedViews},
    picture_source::{self, PicturesEnd},
    report::{LensReport, Stage},
};
use crate::model::stop::StopSignal;

/// From the first picture to a lens, or to the reason why there is none.
pub(super) fn run(shared: &Arc<Shared>, run: LensRun, stop: &StopSignal) {
    let outcome = BoardSearch::new(&CalibrationTarget::Roundels(run.board.clone()), true)
        .map_err(|error| error.to_string())
        .and_then(|mut search| {
            gather(shared, &run, stop, &mut search)?;
            if shared.lock().cancelled {
                return Ok(None);
            }
            shared.lock().status.stage = Stage::Solving;
            let gathered = search.into_gathered().ok_or("no picture came")?;
            solve(&run, &gathered)
                .map(Some)
                .map_err(|error| format!("no lens was found: {}: {error}", gathered.describe()))
        });
    let mut state = shared.lock();
    if state.cancelled {
        state.status.stage = Stage::Idle;
        return;
    }
    match outcome {
        Ok(found) => {
            state.status.stage = Stage::Done;
            state.status.report = found.as_ref().map(|found| LensReport::of(&found.lens));
            state.status.error.clear();
            state.found = found;
        }
        Err(error) => {
            tracing::warn!(%error, "the calibration of a lens ended without one");
            state.status.stage = Stage::Failed;
            state.status.error = error;
        }
    }
}

/// Looks at pictures until there are enough views, the source ends, or somebody ends it.
fn gather(
    shared: &Arc<Shared>,
    run: &LensRun,
    stop: &StopSignal,
    search: &mut BoardSearch,
) -> Result<(), String> {
    let is_left = || shared.lock().last_request.elapsed() > shared.idle_timeout;
    let left = || {
        let seconds = shared.idle_timeout.as_secs_f64();
        format!("nobody asked about it for {seconds} s, so it was ended: start again")
    };
    let mut look = |frame: &Frame<'_>| -> Result<bool, String> {
        let (verdict, rings) = search.look(frame).map_err(|error| error.to_string())?;
        let view = View::of_rings(&run.board, frame, rings);
        let shown = AnnotatedPicture::of(frame, rings);
        let Some(gathered) = search.gathered() else { return Ok(false) };
        let mut state = shared.lock();
        state.status.update(gathered, verdict, &view);
        state.shown = Some(Arc::new(shown));
        drop(state);
        if is_left() {
            return Err(left());
        }
        if let Some(error) = gathered.other_print(false) {
            return Err(error.to_string());
        }
        Ok(gathered.is_complete() || gathered.chooser.taken().len() >= run.most)
    };
    let end = match &run.picture_source {
        PictureSource::Camera(id, name) => {
            let mut wait = |why: String| {
                shared.lock().status.error = why;
                is_left()
            };
            picture_source::of_camera(&shared.hub, (*id, name.as_str()), stop, &mut look, &mut wait)
        }
        PictureSource::Source(address, size) => {
            picture_source::of_source(address, *size, stop, &mut look)
        }
    };
    match end {
        PicturesEnd::Over if is_left() && !stop.is_stopped() && search.gathered().is_none() => {
            Err(left())
        }
        PicturesEnd::Over | PicturesEnd::Finished => Ok(()),
        PicturesEnd::Failed(error) => Err(error),
    }
}

fn solve(run: &LensRun, gathered: &CollectedViews) -> Result<LensResult, LensCalibrationError> {
    let begun = Instant::now();
    let taken = gathered.chooser.taken();
    let target = gathered.chooser.target();
    let lens = Arc::new(calibrate(target, gathered.size, taken, run.model)?);
    let seconds = begun.elapsed().as_secs_f64();
    tracing::info!(views = taken.len(), rms_px = lens.rms_px, seconds, "a lens was found");
    let camera = match &run.picture_source {
        PictureSource::Camera(_, name) => Some(name.clone()),
        PictureSource::Source(..) => None,
    };
    Ok(LensResult { camera, name: run.name.clone(), lens })
}
