//! Where frames come from: [`FrameSource`], opened from a [`SourceAddress`].
//!
//! | module | source, or purpose of a module that sources share |
//! | --- | --- |
//! | `images` | `images:` – image files, played in real time |
//! | `image_list` | the files of a folder or pattern |
//! | `sim` | `sim:` – a simulated camera; clients can drive its robots ([`fleet`]) |
//! | `http` | `http://…` – MJPEG of network cameras, or their snapshots |
//! | [`v4l2`] | `v4l2:` – cameras of this machine; on Linux |
//! | [`push`] | `push:` – frames and detections of a remote program |
//! | `gst` | `rtsp://…`, `file:`, `gst:` – GStreamer; with the Cargo feature `gst` |
//! | `playback` | time line of files and simulation |
//! | `timing` | mapping of a camera's counter to the server's clock |
//! | [`pixels`] | pixel formats of cameras → 8-bit grey |
//! | `jpeg` | JPEG → luma |
//! | `mailbox` | a receiving thread with a mailbox for the newest frame; a stall is an error |
//!
//! Frames never queue: a source returns the newest frame that is due or has arrived, and counts those that it skipped.
//! Broken frames are counted and dropped. An error ends a source, and the worker's supervisor opens it again with
//! backoff.

#[cfg(feature = "gst")]
mod gst;
pub mod http;
pub mod image_list;
mod images;
mod jpeg;
mod mailbox;
pub mod pixels;
mod playback;
pub mod push;
mod sim;
mod timing;
#[cfg(all(target_os = "linux", target_pointer_width = "64"))]
pub mod v4l2;

use std::{sync::Arc, time::Duration};

use roundel_core::{frame::Frame, time::Timestamp, world::FrameObservations};
use thiserror::Error;

pub use playback::{Playback, TimesError};
pub use sim::{SIM_LATENCY_S, fleet};

use crate::model::{
    address::SourceAddress, capture_clock::CaptureClock, clock::Clock, redact::redact,
    source_rules::SourceRules, stop::StopSignal,
};

/// Capture time and counts of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameInfo {
    /// Middle of the exposure at the middle row, on the server's clock.
    pub capture_time: Timestamp,
    pub clock: CaptureClock,
    /// Frames skipped since the previous one because they came too fast.
    pub skipped: u64,
    /// Frames dropped since the previous one because they arrived broken.
    pub broken: u64,
    pub decoding: Duration,
}

impl FrameInfo {
    /// Info of a frame without decoding, skipped or broken frames.
    pub fn at(capture_time: Timestamp) -> Self {
        let (clock, decoding) = (CaptureClock::EXACT, Duration::ZERO);
        Self { capture_time, clock, skipped: 0, broken: 0, decoding }
    }
}

/// A frame, valid until the source returns the next one.
#[derive(Clone, Copy, Debug)]
pub struct LentFrame<'a> {
    pub frame: Frame<'a>,
    pub info: FrameInfo,
}

/// Why there is no further frame.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum SourceError {
    #[error("stopped")]
    Stopped,
    #[error("no more frames")]
    Finished,
    #[error(
        "{what}: expected an image of {} x {} pixels as the camera file says, found {} x {}",
        .expected.0, .expected.1, .found.0, .found.1
    )]
    Size { what: String, expected: (usize, usize), found: (usize, usize) },
    /// What failed and what to do. May quote an address, so it is shown without secrets.
    #[error("{}", redact(.0))]
    Failed(String),
}

/// Detections of a frame that was searched elsewhere.
#[derive(Clone, Debug)]
pub struct RemoteDetections {
    /// The worker replaces the camera and the frame number.
    pub observations: FrameObservations,
    pub clock: CaptureClock,
    /// Frames missing since the previous one.
    pub skipped: u64,
    pub figures: Option<push::RemoteStats>,
}

#[derive(Debug)]
pub enum SourceOutput<'a> {
    /// A frame to search.
    Frame(LentFrame<'a>),
    Detections(Box<RemoteDetections>),
}

/// A stream of 8-bit grey frames.
pub trait FrameSource: Send {
    /// Waits for the next frame and lends it. The frame has the size of the camera's calibration. A stop signal ends
    /// the wait at once.
    fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError>;

    /// Like [`Self::next_frame`], for sources that also yield detections.
    fn next(&mut self) -> Result<SourceOutput<'_>, SourceError> {
        self.next_frame().map(SourceOutput::Frame)
    }

    /// Whether frames come at a pace of their own. Otherwise each waits until the worker takes it.
    fn is_paced(&self) -> bool {
        true
    }

    /// Frame rate that the camera announces; known after the first frame at the latest.
    fn promised_hz(&self) -> Option<f64> {
        None
    }
}

/// What every source is opened with.
#[derive(Clone, Debug)]
struct SourceParts {
    /// Columns and rows of the camera's calibration; images of another size are an error.
    size: (usize, usize),
    clock: Clock,
    stop: StopSignal,
}

/// Opens a worker's source, and opens it again after a failure.
pub trait OpenSource: Send {
    fn open(&mut self) -> Result<Box<dyn FrameSource>, SourceError>;

    /// Waits before the source is opened again; returns whether the stop signal came. A source may end the wait
    /// earlier or later.
    fn pause(&mut self, pause: Duration, stop: &StopSignal) -> bool {
        stop.wait(pause)
    }

    /// Whether a remote program feeds the source, so that opening it only waits for the program.
    fn is_pushed(&self) -> bool {
        false
    }

    /// Lost frames that no later frame has counted; called each time that a source has ended.
    fn take_skipped(&mut self) -> u64 {
        0
    }
}

/// Opens the source of a [`SourceAddress`].
pub struct SourceOpener {
    address: SourceAddress,
    parts: SourceParts,
    playback: Playback,
    /// When the first frame was or will be due; kept from one opening to the next.
    began: Option<Timestamp>,
    push_endpoint: Arc<push::PushEndpoint>,
    fleets: Arc<fleet::Fleets>,
    /// `None`: the source is one of the configuration file.
    rules: Option<Arc<SourceRules>>,
}

impl SourceOpener {
    /// An opener for a camera whose calibration is for images of `size` (columns, rows).
    pub fn new(
        address: SourceAddress,
        size: (usize, usize),
        clock: Clock,
        playback: Playback,
        stop: StopSignal,
    ) -> Self {
        let parts = SourceParts { size, clock, stop };
        let (push_endpoint, fleets) = Default::default();
        Self { address, parts, playback, began: None, push_endpoint, fleets, rules: None }
    }

    /// Sets the endpoint at which a `push:` source's frames arrive.
    pub fn with_push_endpoint(self, push_endpoint: Arc<push::PushEndpoint>) -> Self {
        Self { push_endpoint, ..self }
    }

    /// Sets the rules that bind the source; `None` for one of the configuration file.
    pub fn with_rules(self, rules: Option<Arc<SourceRules>>) -> Self {
        Self { rules, ..self }
    }

    /// Sets the worlds that `sim:` sources share.
    pub fn with_fleets(self, fleets: Arc<fleet::Fleets>) -> Self {
        Self { fleets, ..self }
    }
}

impl OpenSource for SourceOpener {
    /// A source that is opened again continues where it would be by now.
    fn open(&mut self) -> Result<Box<dyn FrameSource>, SourceError> {
        let (parts, origin) = (self.parts.clone(), self.playback.origin);
        match &self.address {
            SourceAddress::Images(address) => {
                let start = self.began.unwrap_or(origin.max(parts.clock.now()));
                let rules = self.rules.as_deref();
                let schedule =
                    images::Schedule::read(address, rules, &self.playback, start, &parts.stop)?;
                self.began = Some(start);
                Ok(Box::new(images::ImageSource::new(schedule, parts)))
            }
            SourceAddress::Sim(address) => {
                Ok(Box::new(sim::SimSource::open(address, &self.fleets, origin, parts)?))
            }
            SourceAddress::Http(address) => {
                Ok(Box::new(http::HttpSource::open(address, self.rules.clone(), parts)?))
            }
            SourceAddress::Push(address) => {
                let endpoint = self.push_endpoint.clone();
                Ok(Box::new(push::PushSource::open(endpoint, address.stall, parts)?))
            }
            #[cfg(all(target_os = "linux", target_pointer_width = "64"))]
            SourceAddress::Device(address) => v4l2::open(address, parts),
            #[cfg(not(all(target_os = "linux", target_pointer_width = "64")))]
            SourceAddress::Device(address) => Err(SourceError::Failed(format!(
                "{address}: `v4l2:` is for Linux on 64-bit machines; use `gst:` with this system's camera source"
            ))),
            #[cfg(feature = "gst")]
            SourceAddress::Media(address) => {
                let rules = self.rules.as_deref();
                Ok(Box::new(gst::GstSource::open(address, rules, parts)?))
            }
            #[cfg(not(feature = "gst"))]
            SourceAddress::Media(address) => Err(SourceError::Failed(format!(
                "{address}: this roundel was built without GStreamer, which plays such sources; build it with \
                 `cargo build --release -p roundel-server --features gst` (Debian: apt-get install \
                 libgstreamer1.0-dev libgstreamer-plugins-base1.0-dev gstreamer1.0-plugins-good \
                 gstreamer1.0-plugins-bad gstreamer1.0-libav)"
            ))),
        }
    }

    fn pause(&mut self, pause: Duration, stop: &StopSignal) -> bool {
        if self.is_pushed() { self.push_endpoint.pause(pause, stop) } else { stop.wait(pause) }
    }

    fn is_pushed(&self) -> bool {
        matches!(self.address, SourceAddress::Push(_))
    }

    fn take_skipped(&mut self) -> u64 {
        self.push_endpoint.take_skipped()
    }
}

/// The error of a frame of another size than the camera file's.
fn wrong_size(what: &str, expected: (usize, usize), found: (usize, usize)) -> SourceError {
    SourceError::Size { what: what.to_owned(), expected, found }
}

/// The error of bytes that contradict the format their source announced, which is a bug.
fn bad_frame(error: impl std::fmt::Display) -> SourceError {
    SourceError::Failed(format!("internal error, please report it: {error}"))
}
