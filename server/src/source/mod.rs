//! Where frames come from: [`FrameSource`], opened from a [`SourceAddress`].
//!
//! | module | source |
//! | --- | --- |
//! | `images` | `images:` – files played in real time |
//! | `sim` | `sim:` – a simulated camera, rendered while it is watched |
//! | `playback` | when each of their frames is due |
//!
//! A paced source that is asked too late skips to the newest frame that is due and says how many it
//! left out: frames never queue.

mod address;
mod images;
mod natural;
mod playback;
mod sim;

use roundel_core::time::Timestamp;
use thiserror::Error;

pub use address::{AddressError, ImagesAddress, SimAddress, SimPreset, SourceAddress};
pub use playback::{Playback, TimesError};
pub use sim::{SIM_LATENCY_S, simulated_camera, simulated_scenario};

use crate::{clock::Clock, stop::Stop};

/// What is known about a frame apart from its pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameInfo {
    /// Middle of the exposure at the middle row, on the server's clock.
    pub capture_time: Timestamp,
    /// Columns, pixels.
    pub width: usize,
    /// Rows, pixels.
    pub height: usize,
    /// Frames left out since the one before, because they came too fast.
    pub skipped: u64,
}

/// Why there is no further frame.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum SourceError {
    /// The server goes down.
    #[error("stopped")]
    Stopped,
    /// All frames were played.
    #[error("no more frames")]
    Finished,
    /// What failed and what to do.
    #[error("{0}")]
    Failed(String),
}

/// A stream of 8-bit grey frames.
pub trait FrameSource: Send {
    /// Waits for the next frame and puts it into `pixels`, row by row without gaps. A stop signal
    /// ends the wait at once.
    fn next_frame(&mut self, pixels: &mut Vec<u8>) -> Result<FrameInfo, SourceError>;
}

/// What a worker opens its source with, and opens it again after a failure.
pub trait OpenSource: Send {
    /// Opens the source.
    fn open(&mut self) -> Result<Box<dyn FrameSource>, SourceError>;
}

/// Opens the source of a [`SourceAddress`].
#[derive(Debug)]
pub struct SourceOpener {
    address: SourceAddress,
    /// Of the camera's calibration; images of another size are an error.
    size: (usize, usize),
    clock: Clock,
    playback: Playback,
    stop: Stop,
    /// When the first frame was or will be due; kept from one opening to the next.
    began: Option<Timestamp>,
}

impl SourceOpener {
    /// An opener for a camera whose calibration is for images of `size` (columns, rows).
    pub fn new(
        address: SourceAddress,
        size: (usize, usize),
        clock: Clock,
        playback: Playback,
        stop: Stop,
    ) -> Self {
        Self { address, size, clock, playback, stop, began: None }
    }
}

impl OpenSource for SourceOpener {
    /// A source that is opened again goes on where it would be by now.
    fn open(&mut self) -> Result<Box<dyn FrameSource>, SourceError> {
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
                self.playback.origin,
                self.clock,
                self.stop.clone(),
            )?)),
        }
    }
}
