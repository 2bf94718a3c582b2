//! Where the pictures of a lens calibration come from: a camera that this server runs, whose frames it only looks at, or a
//! source that is opened for it.

use std::{sync::Arc, time::Duration, time::Instant};

use roundel_core::{frame::Frame, id::CameraId};

use crate::{
    capture::source::{OpenSource, Playback, SourceError, SourceOpener},
    model::{address::SourceAddress, hub::Hub, simulated::simulated_camera, stop::StopSignal},
};

/// Asked of a source that lets one choose, where nobody says a size.
const DEFAULT_SIZE: (usize, usize) = (1280, 720);
/// A camera of this server is looked at so often at most: its worker copies a frame each time.
const MIN_INTERVAL: Duration = Duration::from_millis(100);
/// How often a wait for a picture looks whether it is over.
const POLL_INTERVAL: Duration = Duration::from_millis(10);
/// A wish for a picture that went by, or got lost with a worker that began anew, is told again so often.
const REQUEST_INTERVAL: Duration = Duration::from_millis(500);
/// Without a picture for so long, it is told.
const NO_PICTURE_AFTER: Duration = Duration::from_secs(3);

#[derive(Clone, Debug)]
pub enum PictureSource {
    /// A camera that this server runs.
    Camera(CameraId, String),
    /// A source, with the size that is asked of it.
    Source(Box<SourceAddress>, Option<(usize, usize)>),
}

/// Why there are no more pictures.
pub(super) enum PicturesEnd {
    /// Somebody ended it, or has seen enough.
    Over,
    /// The source has an end.
    Finished,
    Failed(String),
}

/// What is done with each picture: whether it was the last; an error ends it, too.
pub(super) type FrameHandler<'a> = &'a mut dyn FnMut(&Frame<'_>) -> Result<bool, String>;

/// Looks at a running camera's frames until it is over. At most half of the time is spent looking, so that a small
/// machine has time for the cameras; `wait` is told why no picture comes.
pub(super) fn of_camera(
    hub: &Arc<Hub>,
    (id, name): (CameraId, &str),
    stop: &StopSignal,
    look: FrameHandler<'_>,
    wait: &mut dyn FnMut(String) -> bool,
) -> PicturesEnd {
    let removed = || PicturesEnd::Failed(format!("camera {name} was removed"));
    let Some(mut pictures) = hub.request_picture(id) else { return removed() };
    loop {
        let asked = Instant::now();
        let (mut request_at, mut report_at) = (asked + REQUEST_INTERVAL, asked + NO_PICTURE_AFTER);
        while !pictures.has_changed().unwrap_or(false) {
            if stop.wait(POLL_INTERVAL) {
                return PicturesEnd::Over;
            }
            let now = Instant::now();
            if now >= request_at {
                request_at += REQUEST_INTERVAL;
                if hub.request_picture(id).is_none() {
                    return removed();
                }
            }
            if now >= report_at {
                report_at += NO_PICTURE_AFTER;
                let why = hub.camera(id).map(|state| state.error).unwrap_or_default();
                let why = if why.is_empty() { "is it running?".to_owned() } else { why };
                if wait(format!("no picture comes from camera {name}: {why}")) {
                    return PicturesEnd::Over;
                }
            }
        }
        let newest = pictures.borrow_and_update().clone();
        let looked = Instant::now();
        if let Some(picture) = newest {
            let (width, height) = (picture.width, picture.height);
            match Frame::new(&picture.pixels, width, height, width).map(|frame| look(&frame)) {
                Ok(Ok(true)) => return PicturesEnd::Over,
                Ok(Ok(false)) => {}
                Ok(Err(error)) => return PicturesEnd::Failed(error),
                Err(error) => return PicturesEnd::Failed(error.to_string()),
            }
        }
        let pause = looked.elapsed().max(MIN_INTERVAL.saturating_sub(asked.elapsed()));
        if stop.wait(pause) {
            return PicturesEnd::Over;
        }
        if hub.request_picture(id).is_none() {
            return removed();
        }
    }
}

/// Opens a source and looks at its frames until it is over. One whose pictures have another size is opened anew with that.
pub(super) fn of_source(
    address: &SourceAddress,
    wanted: Option<(usize, usize)>,
    stop: &StopSignal,
    look: FrameHandler<'_>,
) -> PicturesEnd {
    let (clock, playback) = match Playback::begin(std::iter::once(address)) {
        Ok(begun) => begun,
        Err(error) => return PicturesEnd::Failed(error.to_string()),
    };
    let mut size = match address {
        SourceAddress::Sim(sim) => match simulated_camera(sim) {
            Ok(simulated) => (simulated.camera.width(), simulated.camera.height()),
            Err(error) => return PicturesEnd::Failed(error.to_string()),
        },
        _ => wanted.unwrap_or(DEFAULT_SIZE),
    };
    let mut seen = false;
    loop {
        let mut opener = SourceOpener::new(address.clone(), size, clock, playback, stop.clone());
        let mut error = None;
        let outcome = opener.open().and_then(|mut source| {
            loop {
                let lent = source.next_frame()?;
                seen = true;
                let looked = Instant::now();
                match look(&lent.frame) {
                    Ok(true) => return Ok(()),
                    Ok(false) => {}
                    Err(said) => {
                        error = Some(said);
                        return Ok(());
                    }
                }
                if stop.wait(looked.elapsed()) {
                    return Err(SourceError::Stopped);
                }
            }
        });
        match outcome {
            Ok(()) => return error.map_or(PicturesEnd::Over, PicturesEnd::Failed),
            Err(SourceError::Stopped) => return PicturesEnd::Over,
            Err(SourceError::Finished) => return PicturesEnd::Finished,
            Err(SourceError::Size { found, .. }) if !seen && found != size => {
                if wanted.is_some() {
                    return PicturesEnd::Failed(other_size(size, found));
                }
                size = found;
            }
            Err(error) => return PicturesEnd::Failed(error.to_string()),
        }
    }
}

fn other_size(wanted: (usize, usize), found: (usize, usize)) -> String {
    format!(
        "asked for pictures of {} x {} pixels, found {} x {}: ask for that size, or for none",
        wanted.0, wanted.1, found.0, found.1
    )
}
