//! Sources of pictures for a lens calibration: a running camera, whose frames are copied, or a source that is opened for the
//! calibration.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use roundel_core::{frame::Frame, id::CameraId};

use crate::{
    capture::source::{OpenSource, Playback, SourceError, SourceOpener},
    model::{
        address::SourceAddress, hub::Hub, simulated::simulated_camera, source_rules::SourceRules,
        stop::StopSignal,
    },
};

/// Size to request from a source that supports several.
const DEFAULT_SIZE: (usize, usize) = (1280, 720);
/// Minimum interval between two pictures of a running camera, whose worker copies each one.
const MIN_INTERVAL: Duration = Duration::from_millis(100);
const POLL_INTERVAL: Duration = Duration::from_millis(10);
/// A request for a picture is repeated after this time, because a restarted worker loses it.
const REQUEST_INTERVAL: Duration = Duration::from_millis(500);
/// A missing picture is reported after this time.
const NO_PICTURE_AFTER: Duration = Duration::from_secs(3);

#[derive(Clone, Debug)]
pub enum PictureSource {
    /// A camera of this server, by id and name.
    Camera(CameraId, String),
    Source(Box<OpenedSource>),
}

/// A source that is opened for the calibration.
#[derive(Clone, Debug)]
pub struct OpenedSource {
    pub address: SourceAddress,
    /// Those that bind the source, if a client named it.
    pub rules: Option<Arc<SourceRules>>,
    /// To request from it.
    pub size: Option<(usize, usize)>,
}

/// Handles one frame; returns whether no more frames are needed.
pub type FrameHandler<'a> = &'a mut dyn FnMut(&Frame<'_>) -> Result<bool, String>;

/// Passes a running camera's frames to `handle_frame`. It pauses as long as the handler takes, so that a slow computer keeps up
/// with its cameras. While no picture arrives, `report_wait` is called with the reason.
pub(super) fn for_each_camera_frame(
    hub: &Hub,
    (id, name): (CameraId, &str),
    stop: &StopSignal,
    handle_frame: FrameHandler<'_>,
    report_wait: &mut dyn FnMut(String) -> Result<(), String>,
) -> Result<(), String> {
    let request = || hub.request_picture(id).ok_or_else(|| format!("camera {name} was removed"));
    let mut pictures = request()?;
    loop {
        let requested = Instant::now();
        let (mut request_at, mut report_at) =
            (requested + REQUEST_INTERVAL, requested + NO_PICTURE_AFTER);
        while !pictures.has_changed().unwrap_or(false) {
            if stop.wait(POLL_INTERVAL) {
                return Ok(());
            }
            let now = Instant::now();
            if now >= request_at {
                request_at += REQUEST_INTERVAL;
                request()?;
            }
            if now >= report_at {
                report_at += NO_PICTURE_AFTER;
                let why = hub.camera(id).map(|state| state.error).unwrap_or_default();
                let why = if why.is_empty() { "is it running?" } else { &why };
                report_wait(format!("no picture from camera {name}: {why}"))?;
            }
        }
        let newest = pictures.borrow_and_update().clone();
        let received = Instant::now();
        if let Some(picture) = newest {
            let (width, height) = (picture.width, picture.height);
            let frame = Frame::new(&picture.pixels, width, height, width);
            if handle_frame(&frame.map_err(|error| error.to_string())?)? {
                return Ok(());
            }
        }
        if stop.wait(received.elapsed().max(MIN_INTERVAL.saturating_sub(requested.elapsed()))) {
            return Ok(());
        }
        request()?;
    }
}

/// Opens a source and passes its frames to `handle_frame` until that returns `true` or the source ends. If no size is
/// requested and the pictures do not have the default size, the source is opened again with their size.
pub fn for_each_source_frame(
    source: &OpenedSource,
    stop: &StopSignal,
    handle_frame: FrameHandler<'_>,
) -> Result<(), SourceError> {
    let failed = |error: String| SourceError::Failed(error);
    let OpenedSource { address, rules, size: requested } = source;
    let (clock, playback) =
        Playback::begin(std::iter::once(address)).map_err(|error| failed(error.to_string()))?;
    let mut size = requested.unwrap_or(DEFAULT_SIZE);
    if let SourceAddress::Sim(sim) = address {
        let camera = simulated_camera(sim).map_err(|error| failed(error.to_string()))?.camera;
        size = (camera.width(), camera.height());
    }
    let mut seen = false;
    loop {
        let opener = SourceOpener::new(address.clone(), size, clock, playback, stop.clone());
        let mut opener = opener.with_rules(rules.clone());
        let outcome = opener.open().and_then(|mut source| {
            loop {
                let lent = source.next_frame()?;
                seen = true;
                if handle_frame(&lent.frame).map_err(failed)? {
                    return Ok(());
                }
            }
        });
        match outcome {
            Err(SourceError::Size { found, .. })
                if requested.is_none() && !seen && found != size =>
            {
                size = found;
            }
            Err(SourceError::Finished) => return Ok(()),
            outcome => return outcome,
        }
    }
}
