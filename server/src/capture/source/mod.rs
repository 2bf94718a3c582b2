//! Where frames come from: [`FrameSource`], opened from a [`SourceAddress`].
//!
//! | module | source |
//! | --- | --- |
//! | `images` | `images:` – files played in real time |
//! | `sim` | `sim:` – a simulated camera, rendered while it is watched; its robots can be driven ([`fleet`]) |
//! | `playback` | when each of their frames is due |
//! | `http` | `http://…` – MJPEG of network cameras, or their snapshots |
//! | [`v4l2`] | `v4l2:` – cameras of this machine; on Linux |
//! | [`push`] | `push:` – frames and detections of a remote program |
//! | `gst` | `rtsp://…`, `file:`, `gst:` – what GStreamer plays; with the Cargo feature `gst` |
//!
//! Shared modules:
//!
//! | module | purpose |
//! | --- | --- |
//! | `timing` | clocks of capture times, and the mapping of a camera's counter to the server's clock |
//! | [`pixels`] | pixel formats of cameras → 8-bit grey |
//! | `jpeg` | JPEG → luma |
//! | `mailbox` | a receiving thread with a mailbox for the newest frame; a stall is an error |
//!
//! Frames never queue: a source returns the newest frame that is due or has arrived, and counts those that it skipped.
//! Broken frames are counted and dropped. An error ends a source, and the worker's supervisor opens it again with
//! backoff.

#[cfg(feature = "gst")]
mod gst;
mod http;
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

use crate::model::{address::SourceAddress, capture_clock::CaptureClock};
use crate::model::{clock::Clock, stop::StopSignal};

/// Capture time and counts of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameInfo {
    /// Middle of the exposure at the middle row, on the server's clock.
    pub capture_time: Timestamp,
    /// Clock of the capture time, and its accuracy.
    pub clock: CaptureClock,
    /// Frames skipped since the one before, because they came too fast.
    pub skipped: u64,
    /// Frames dropped since the one before, because they arrived broken.
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
    /// The pixels.
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
    /// Pictures of another size than the camera file's.
    #[error(
        "{what}: expected an image of {} x {} pixels as the camera file says, found {} x {}",
        .expected.0, .expected.1, .found.0, .found.1
    )]
    Size {
        what: String,
        /// Columns and rows, as the camera file says.
        expected: (usize, usize),
        found: (usize, usize),
    },
    /// What failed and what to do.
    #[error("{0}")]
    Failed(String),
}

/// What was seen in a frame that was searched elsewhere.
#[derive(Clone, Debug)]
pub struct RemoteDetections {
    /// What was seen; the worker gives it its camera and number.
    pub observations: FrameObservations,
    /// Where its times come from, and how far off they may be.
    pub clock: CaptureClock,
    /// Frames that never came since the one before.
    pub skipped: u64,
    /// How the camera does there, if that is known.
    pub figures: Option<push::RemoteStats>,
}

#[derive(Debug)]
pub enum SourceOutput<'a> {
    /// A frame, to be searched.
    Frame(LentFrame<'a>),
    Detections(Box<RemoteDetections>),
}

/// A stream of 8-bit grey frames.
pub trait FrameSource: Send {
    /// Waits for the next frame and lends it, of the size of the camera's calibration. A stop signal
    /// ends the wait at once.
    fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError>;

    /// The same of a source that may have searched its frames already.
    fn next(&mut self) -> Result<SourceOutput<'_>, SourceError> {
        self.next_frame().map(SourceOutput::Frame)
    }

    /// Frames a second that the camera says it gives, as far as is known once a frame has come; `None`: it does not
    /// say.
    fn promised_hz(&self) -> Option<f64> {
        None
    }
}

/// What every camera source is opened with.
#[derive(Clone, Copy, Debug)]
struct SourceParts {
    /// Columns and rows of the camera's calibration.
    size: (usize, usize),
    clock: Clock,
}

/// What a worker opens its source with, and opens it again after a failure.
pub trait OpenSource: Send {
    fn open(&mut self) -> Result<Box<dyn FrameSource>, SourceError>;

    /// Waits before it is opened again: so long, unless the source knows better. Whether the server goes down.
    fn pause(&mut self, pause: Duration, stop: &StopSignal) -> bool {
        stop.wait(pause)
    }

    /// Whether there is nothing to be opened: somebody comes, or does not.
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
    /// Size in the camera's calibration; images of another size are an error.
    size: (usize, usize),
    clock: Clock,
    playback: Playback,
    stop: StopSignal,
    /// When the first frame was or will be due; kept from one opening to the next.
    began: Option<Timestamp>,
    /// Where a remote program's frames arrive.
    push_endpoint: Arc<push::PushEndpoint>,
    /// The simulated worlds of this server.
    fleets: Arc<fleet::Fleets>,
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
        let (push_endpoint, fleets) = Default::default();
        Self { address, size, clock, playback, stop, began: None, push_endpoint, fleets }
    }

    /// The same, with the endpoint at which a `push:` source's frames arrive.
    pub fn with_push_endpoint(self, push_endpoint: Arc<push::PushEndpoint>) -> Self {
        Self { push_endpoint, ..self }
    }

    /// The same, with the worlds that `sim:` sources share.
    pub fn with_fleets(self, fleets: Arc<fleet::Fleets>) -> Self {
        Self { fleets, ..self }
    }
}

impl OpenSource for SourceOpener {
    /// A source that is opened again goes on where it would be by now.
    fn open(&mut self) -> Result<Box<dyn FrameSource>, SourceError> {
        let parts = SourceParts { size: self.size, clock: self.clock };
        match &self.address {
            SourceAddress::Images(address) => {
                let start = self.began.unwrap_or(self.playback.origin.max(self.clock.now()));
                let schedule = images::Schedule::read(address, &self.playback, start)?;
                self.began = Some(start);
                Ok(Box::new(images::ImageSource::new(
                    schedule,
                    self.size,
                    self.clock,
                    self.stop.clone(),
                )))
            }
            SourceAddress::Sim(address) => Ok(Box::new(sim::SimSource::open(
                address,
                (&self.fleets, self.playback.origin),
                self.clock,
                self.stop.clone(),
            )?)),
            SourceAddress::Http(address) => {
                Ok(Box::new(http::HttpSource::open(address, parts, self.stop.clone())?))
            }
            SourceAddress::Push(address) => {
                let parts = push::PushSourceParams { size: self.size, patience: address.stall };
                Ok(Box::new(push::PushSource::open(
                    self.push_endpoint.clone(),
                    parts,
                    self.stop.clone(),
                )?))
            }
            #[cfg(all(target_os = "linux", target_pointer_width = "64"))]
            SourceAddress::Device(address) => v4l2::open(address, parts, self.stop.clone()),
            #[cfg(not(all(target_os = "linux", target_pointer_width = "64")))]
            SourceAddress::Device(address) => Err(SourceError::Failed(format!(
                "{address}: `v4l2:` is for Linux on 64-bit machines; use `gst:` with this system's camera source"
            ))),
            #[cfg(feature = "gst")]
            SourceAddress::Media(address) => {
                Ok(Box::new(gst::GstSource::open(address, parts, self.stop.clone())?))
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
        match &self.address {
            SourceAddress::Push(_) => self.push_endpoint.pause(pause, stop),
            _ => stop.wait(pause),
        }
    }

    fn is_pushed(&self) -> bool {
        matches!(self.address, SourceAddress::Push(_))
    }

    fn take_skipped(&mut self) -> u64 {
        self.push_endpoint.take_skipped()
    }
}

/// The image files of a folder or pattern, or the one file, in natural order; the error says what is missing.
pub fn image_files(pattern: &str) -> Result<Vec<std::path::PathBuf>, String> {
    images::list_files(pattern)
}

/// The error of a frame of another size than the camera file's.
fn wrong_size(what: &str, expected: (usize, usize), found: (usize, usize)) -> SourceError {
    SourceError::Size { what: what.to_owned(), expected, found }
}

/// The error of bytes that a source promised to be a picture, which is a bug of it.
fn bad_frame(error: impl std::fmt::Display) -> SourceError {
    SourceError::Failed(format!("internal error, please report it: {error}"))
}
