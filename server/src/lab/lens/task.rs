//! One calibration of a lens, on its thread: pictures until there is enough, then the solution.

use std::{sync::Arc, time::Instant};

use roundel_core::{
    calib::lens::{LensCalibrationError, View, calibrate},
    frame::Frame,
};

use super::{
    Found, Shared, Subject, Wanted,
    drawing::Shown,
    pictures::{self, End},
    report::{LensReport, Stage},
    search::{Gathered, Search, Sought},
};
use crate::model::stop::Stop;

/// From the first picture to a lens, or to the reason why there is none.
pub(super) fn run(shared: &Arc<Shared>, wanted: Wanted, stop: &Stop) {
    let outcome = Search::new(&Sought::Roundels(wanted.board.clone()), true)
        .map_err(|error| error.to_string())
        .and_then(|mut search| {
            gather(shared, &wanted, stop, &mut search)?;
            if shared.lock().cancelled {
                return Ok(None);
            }
            shared.lock().status.stage = Stage::Solving;
            let gathered = search.into_gathered().ok_or("no picture came")?;
            solve(&wanted, &gathered)
                .map(Some)
                .map_err(|error| format!("no lens was found: {}: {error}", gathered.told()))
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
    wanted: &Wanted,
    stop: &Stop,
    search: &mut Search,
) -> Result<(), String> {
    let is_left = || shared.lock().asked.elapsed() > shared.patience;
    let left = || {
        let seconds = shared.patience.as_secs_f64();
        format!("nobody asked about it for {seconds} s, so it was ended: start again")
    };
    let mut look = |frame: &Frame<'_>| -> Result<bool, String> {
        let (verdict, rings) = search.look(frame).map_err(|error| error.to_string())?;
        let view = View::of_rings(&wanted.board, frame, rings);
        let shown = Shown::of(frame, rings);
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
        Ok(gathered.is_complete() || gathered.chooser.taken().len() >= wanted.most)
    };
    let end = match &wanted.subject {
        Subject::Camera(id, name) => {
            let mut wait = |why: String| {
                shared.lock().status.error = why;
                is_left()
            };
            pictures::of_camera(&shared.hub, (*id, name.as_str()), stop, &mut look, &mut wait)
        }
        Subject::Source(address, size) => pictures::of_source(address, *size, stop, &mut look),
    };
    match end {
        End::Over if is_left() && !stop.is_stopped() && search.gathered().is_none() => Err(left()),
        End::Over | End::Finished => Ok(()),
        End::Failed(error) => Err(error),
    }
}

fn solve(wanted: &Wanted, gathered: &Gathered) -> Result<Found, LensCalibrationError> {
    let begun = Instant::now();
    let taken = gathered.chooser.taken();
    let target = gathered.chooser.target();
    let lens = Arc::new(calibrate(target, gathered.size, taken, wanted.model)?);
    let seconds = begun.elapsed().as_secs_f64();
    tracing::info!(views = taken.len(), rms_px = lens.rms_px, seconds, "a lens was found");
    let camera = match &wanted.subject {
        Subject::Camera(_, name) => Some(name.clone()),
        Subject::Source(..) => None,
    };
    Ok(Found { camera, name: wanted.name.clone(), lens })
}
