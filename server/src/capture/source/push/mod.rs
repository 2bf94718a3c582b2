//! `push:` – frames and detections that a remote program sends.
//!
//! Each such camera has a [`PushEndpoint`]. The API puts in what arrives; the camera's worker takes it out, on its own thread,
//! as from any other source. What is put in was taken: it is acknowledged to the sender and never asked for again.

mod endpoint;
mod endpoints;
mod still_image;

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use roundel_core::{frame::Frame, time::Timestamp, world::FrameObservations};

pub use endpoint::{PushEndpoint, PushError, SenderHello, SenderSession};
pub use endpoints::PushEndpoints;
pub use still_image::StillImage;

use super::{
    FrameInfo, FrameSource, LentFrame, RemoteDetections, SourceError, SourceOutput, bad_frame,
    jpeg::{JpegError, LumaDecoder},
    timing::CameraTimeline,
};
use crate::model::capture_clock::CaptureClock;
use crate::model::stop::StopSignal;

/// What the times of a sender are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SenderClock {
    /// Nothing: when a message arrives counts.
    #[default]
    Arrival,
    /// On the server's clock.
    Server,
    Counter,
    /// Unix time that it keeps in step.
    Unix,
}

/// What arrived, and when.
#[derive(Debug)]
pub struct PushedItem {
    pub what: Payload,
    pub times: SenderClock,
    /// Where they come from, if the sender says so.
    pub clock: Option<CaptureClock>,
    /// When it was here, on the server's clock.
    pub arrived: Timestamp,
}

#[derive(Debug)]
pub enum Payload {
    /// 8-bit grey without gaps; columns, rows, and the middle of the exposure.
    Grey(Vec<u8>, (usize, usize), Timestamp),
    Jpeg(Vec<u8>, Timestamp),
    /// What was seen in a frame; the worker gives it its camera and number.
    Detections(Box<FrameObservations>, Option<RemoteStats>),
}

/// How a sender's camera does; counts are since the start of the sender.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RemoteStats {
    /// Columns of its frames, pixels.
    pub width: usize,
    pub height: usize,
    /// Frames that it left out because they came too fast.
    pub dropped: u64,
    /// Frames that came broken to it.
    pub broken: u64,
    /// Detection, milliseconds.
    pub detect_ms: f64,
    /// Decoding, milliseconds.
    pub decode_ms: f64,
    /// Deviation of the blur, pixels.
    pub blur_px: f64,
    /// Deviation of the noise, grey levels.
    pub noise: f64,
}

/// What a push source has to fit into.
#[derive(Clone, Copy, Debug)]
pub(super) struct PushSourceParams {
    /// Of the camera's calibration.
    pub(super) size: (usize, usize),
    /// Nothing for so long is a stall.
    pub(super) patience: Duration,
}

/// Takes what arrives at a port.
pub(super) struct PushSource {
    endpoint: Arc<PushEndpoint>,
    parts: PushSourceParams,
    stop: StopSignal,
    timeline: CameraTimeline,
    decoder: LumaDecoder,
    grey: Vec<u8>,
}

impl PushSource {
    pub(super) fn open(
        endpoint: Arc<PushEndpoint>,
        parts: PushSourceParams,
        stop: StopSignal,
    ) -> Result<Self, SourceError> {
        endpoint.ready()?;
        Ok(Self {
            endpoint,
            parts,
            stop,
            timeline: CameraTimeline::default(),
            decoder: LumaDecoder::new(parts.size),
            grey: Vec::new(),
        })
    }

    /// By how much times of which one is `stamp` are to be moved onto the server's clock, and where they come from
    /// then.
    fn onto_clock(&mut self, by: &StampOrigin, stamp: Timestamp) -> (i64, CaptureClock) {
        let (capture, usual) = match by.times {
            SenderClock::Arrival => (by.arrived, CaptureClock::ARRIVAL),
            SenderClock::Counter => {
                let capture = self.timeline.capture_time(stamp.as_ns(), by.arrived);
                (capture, CaptureClock::CAMERA)
            }
            SenderClock::Server => (stamp, CaptureClock::DRIVER),
            SenderClock::Unix => (stamp, CaptureClock::SYNCHRONIZED),
        };
        (capture.ns_since(stamp), by.clock.unwrap_or(usual))
    }

    fn remote(
        &mut self,
        by: &StampOrigin,
        mut observations: FrameObservations,
    ) -> RemoteDetections {
        let (move_ns, clock) = self.onto_clock(by, observations.capture_time);
        observations.capture_time = observations.capture_time.plus_ns(move_ns);
        for detection in &mut observations.detections {
            detection.capture_time = detection.capture_time.plus_ns(move_ns);
        }
        // Its worker is the sender's; but nobody has a frame before it was taken, or after it was here.
        let is_told = by.times == SenderClock::Server
            && observations.received_time >= observations.capture_time
            && observations.received_time <= by.arrived;
        if !is_told {
            observations.received_time = by.arrived;
        }
        RemoteDetections { observations, clock, skipped: 0, figures: None }
    }
}

/// When something was stamped, by which clock, and when it arrived.
struct StampOrigin {
    times: SenderClock,
    clock: Option<CaptureClock>,
    arrived: Timestamp,
}

impl FrameSource for PushSource {
    /// Detections are left out: [`FrameSource::next`] gives them.
    fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
        loop {
            match self.advance()? {
                PushStep::Frame(info) => return self.lend(info),
                PushStep::Detections(_) => {}
            }
        }
    }

    fn next(&mut self) -> Result<SourceOutput<'_>, SourceError> {
        match self.advance()? {
            PushStep::Frame(info) => self.lend(info).map(SourceOutput::Frame),
            PushStep::Detections(remote) => Ok(SourceOutput::Detections(remote)),
        }
    }
}

/// What was taken last: a frame in `grey`, or detections.
enum PushStep {
    Frame(FrameInfo),
    Detections(Box<RemoteDetections>),
}

impl PushSource {
    fn lend(&self, info: FrameInfo) -> Result<LentFrame<'_>, SourceError> {
        let (width, height) = self.parts.size;
        let frame = if self.grey.is_empty() {
            self.decoder.frame()?
        } else {
            Frame::new(&self.grey, width, height, width).map_err(bad_frame)?
        };
        Ok(LentFrame { frame, info })
    }

    fn advance(&mut self) -> Result<PushStep, SourceError> {
        let (since, mut skipped, mut broken) = (Instant::now(), 0, 0);
        loop {
            let (pushed, replaced) = self.endpoint.next(since, self.parts.patience, &self.stop)?;
            skipped += replaced;
            let PushedItem { what, times, clock, arrived } = pushed;
            let by = StampOrigin { times, clock, arrived };
            let begun = Instant::now();
            let (stamp, decoded) = match what {
                Payload::Detections(observations, figures) => {
                    let remote = self.remote(&by, *observations);
                    return Ok(PushStep::Detections(Box::new(RemoteDetections {
                        skipped,
                        figures,
                        ..remote
                    })));
                }
                Payload::Grey(pixels, size, stamp) => (stamp, self.keep(pixels, size)),
                Payload::Jpeg(file, stamp) => (stamp, self.decode(&file)),
            };
            let (move_ns, clock) = self.onto_clock(&by, stamp);
            if self
                .decoder
                .accept(decoded, || format!("a picture of {}", self.endpoint.sender_label()))?
            {
                let (capture_time, decoding) = (stamp.plus_ns(move_ns), begun.elapsed());
                let info = FrameInfo { capture_time, clock, skipped, broken, decoding };
                return Ok(PushStep::Frame(info));
            }
            broken += 1;
        }
    }

    fn keep(&mut self, pixels: Vec<u8>, size: (usize, usize)) -> Result<(), JpegError> {
        let (width, height) = size;
        if size != self.parts.size {
            return Err(JpegError::Size(width, height));
        }
        let expected = width * height;
        if pixels.len() != expected {
            let found = pixels.len();
            let reason =
                format!("expected {expected} pixels for {width} x {height}, found {found}");
            return Err(JpegError::Broken(reason));
        }
        self.grey = pixels;
        Ok(())
    }

    fn decode(&mut self, file: &[u8]) -> Result<(), JpegError> {
        self.grey.clear();
        self.decoder.decode(file)
    }
}
