//! The thread of one lens calibration: collects views, then estimates the lens.

use std::{sync::Arc, time::Instant};

use roundel_core::{
    calib::lens::{LensCalibrationError, View, calibrate},
    frame::Frame,
};

use super::{
    LensResult, LensRun, PictureSource, Shared,
    annotated_picture::AnnotatedPicture,
    board_search::{BoardSearch, CalibrationTarget, CollectedViews},
    picture_source::{for_each_camera_frame, for_each_source_frame},
    report::{LensReport, Stage},
};
use crate::{capture::source::SourceError, model::stop::StopSignal};

pub(super) fn run(shared: &Shared, run: LensRun, stop: &StopSignal) {
    let outcome = find_lens(shared, &run, stop);
    let mut state = shared.lock();
    if state.cancelled {
        state.status.stage = Stage::Idle;
        return;
    }
    match outcome {
        Ok(found) => {
            state.status.stage = Stage::Done;
            state.status.report = Some(LensReport::of(&found.lens));
            state.status.error.clear();
            state.found = Some(found);
        }
        Err(error) => {
            tracing::warn!(%error, "lens calibration failed");
            state.status.stage = Stage::Failed;
            state.status.error = error;
        }
    }
}

fn find_lens(shared: &Shared, run: &LensRun, stop: &StopSignal) -> Result<LensResult, String> {
    let target = CalibrationTarget::Roundels(run.board.clone());
    let mut search = BoardSearch::new(&target, true).map_err(|error| error.to_string())?;
    collect_views(shared, run, stop, &mut search)?;
    let mut state = shared.lock();
    if state.cancelled {
        return Err("cancelled".to_owned());
    }
    state.status.stage = Stage::Solving;
    drop(state);
    let gathered = search.into_gathered().ok_or("no picture arrived")?;
    solve(run, &gathered)
        .map_err(|error| format!("no lens was found: {}: {error}", gathered.describe()))
}

/// Searches pictures until there are enough views, the source ends, or a client ends the calibration.
fn collect_views(
    shared: &Shared,
    run: &LensRun,
    stop: &StopSignal,
    search: &mut BoardSearch,
) -> Result<(), String> {
    let check_idle = || {
        if shared.lock().last_request.elapsed() <= shared.idle_timeout {
            return Ok(());
        }
        let timeout_s = shared.idle_timeout.as_secs_f64();
        Err(format!("cancelled: no client read the status for {timeout_s} s; start it again"))
    };
    let mut handle_frame = |frame: &Frame<'_>| -> Result<bool, String> {
        let (verdict, rings) = search.look(frame).map_err(|error| error.to_string())?;
        let view = View::of_rings(&run.board, frame, rings);
        let shown = AnnotatedPicture::of(frame, rings);
        let Some(gathered) = search.gathered() else { return Ok(false) };
        let mut state = shared.lock();
        state.status.update(gathered, verdict, &view);
        state.shown = Some(Arc::new(shown));
        drop(state);
        check_idle()?;
        if let Some(error) = gathered.other_print(false) {
            return Err(error.to_string());
        }
        Ok(gathered.is_complete() || gathered.selector.taken().len() >= run.max_views)
    };
    match &run.picture_source {
        PictureSource::Camera(id, name) => {
            let mut report_wait = |why: String| {
                shared.lock().status.error = why;
                check_idle()
            };
            for_each_camera_frame(
                &shared.hub,
                (*id, name),
                stop,
                &mut handle_frame,
                &mut report_wait,
            )
        }
        PictureSource::Source(source) => {
            // Busy for at most half of the time, as with a running camera.
            let mut handle_and_pause = |frame: &Frame<'_>| -> Result<bool, String> {
                let begun = Instant::now();
                Ok(handle_frame(frame)? || stop.wait(begun.elapsed()))
            };
            match for_each_source_frame(source, stop, &mut handle_and_pause) {
                Ok(()) | Err(SourceError::Stopped) => Ok(()),
                Err(SourceError::Size { expected, found, .. }) if source.size.is_some() => {
                    Err(format!(
                        "expected the requested {} x {} pixels, found {} x {}: request that size, or none",
                        expected.0, expected.1, found.0, found.1
                    ))
                }
                Err(error) => Err(error.to_string()),
            }
        }
    }
}

fn solve(run: &LensRun, gathered: &CollectedViews) -> Result<LensResult, LensCalibrationError> {
    let begun = Instant::now();
    let taken = gathered.selector.taken();
    let target = gathered.selector.target();
    let lens = Arc::new(calibrate(target, gathered.size, taken, run.model)?);
    let seconds = begun.elapsed().as_secs_f64();
    tracing::info!(views = taken.len(), rms_px = lens.rms_px, seconds, "lens found");
    let camera = match &run.picture_source {
        PictureSource::Camera(_, name) => Some(name.clone()),
        PictureSource::Source(..) => None,
    };
    Ok(LensResult { camera, name: run.name.clone(), lens })
}
