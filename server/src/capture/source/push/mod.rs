//! `push:` – frames and detections that a remote program sends.
//!
//! Each such camera has a [`PushEndpoint`]. The API puts in what arrives, and acknowledges it to the sender; the
//! camera's worker takes it out on its own thread, as from any other source.

mod endpoint;
mod picture;

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use roundel_core::{time::Timestamp, world::FrameObservations};

pub use endpoint::{PushEndpoint, PushEndpoints, PushError, SenderHello, SenderSession};
pub use picture::SentPicture;

use super::{
    FrameInfo, FrameSource, LentFrame, RemoteDetections, SourceError, SourceOutput, SourceParts,
    jpeg::LumaDecoder, timing::CameraTimeline,
};
use crate::model::capture_clock::CaptureClock;

/// How long after a frame whose delay is new others are awaited, to learn by how much it was late.
const SETTLE: Duration = Duration::from_millis(200);

/// The clock of a sender's time stamps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SenderClock {
    /// No time stamps: the arrival of a message counts.
    #[default]
    Arrival,
    Server,
    /// A counter of the sender's own.
    Counter,
    /// Unix time, synchronized by the sender.
    Unix,
}

#[derive(Debug)]
pub struct PushedItem {
    pub what: Payload,
    pub times: SenderClock,
    /// The clock of the capture times, if the sender names one.
    pub clock: Option<CaptureClock>,
    /// Arrival on the server's clock.
    pub arrived: Timestamp,
}

impl PushedItem {
    /// The sender's stamp of the capture.
    fn stamp(&self) -> Timestamp {
        match &self.what {
            Payload::Frame(_, stamp) => *stamp,
            Payload::Detections(observations, _) => observations.capture_time,
        }
    }

    /// Memory of its pixels or detections.
    fn bytes(&self) -> usize {
        match &self.what {
            Payload::Frame(SentPicture::Jpeg(bytes) | SentPicture::Grey(bytes, _), _) => {
                bytes.len()
            }
            Payload::Detections(seen, _) => size_of_val(seen.detections.as_slice()),
        }
    }
}

#[derive(Debug)]
pub enum Payload {
    /// A frame, and the middle of its exposure.
    Frame(SentPicture, Timestamp),
    /// The worker replaces the camera and the frame number.
    Detections(Box<FrameObservations>, Option<RemoteStats>),
}

/// State of a sender's camera; counts are since the start of the sender.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RemoteStats {
    /// Columns and rows of its frames, pixels.
    pub width: usize,
    pub height: usize,
    /// Frames skipped because they came too fast.
    pub dropped: u64,
    pub broken: u64,
    pub detect_ms: f64,
    pub decode_ms: f64,
    /// Standard deviation of the blur, pixels.
    pub blur_px: f64,
    /// Standard deviation of the noise, grey levels.
    pub noise: f64,
}

pub(super) struct PushSource {
    endpoint: Arc<PushEndpoint>,
    /// Without an item for this long the source fails.
    patience: Duration,
    parts: SourceParts,
    timeline: CameraTimeline,
    decoder: LumaDecoder,
}

/// The next item: a frame in the decoder, or detections.
enum PushStep {
    Frame(FrameInfo),
    Detections(Box<RemoteDetections>),
}

impl PushSource {
    pub(super) fn open(
        endpoint: Arc<PushEndpoint>,
        patience: Duration,
        parts: SourceParts,
    ) -> Result<Self, SourceError> {
        endpoint.ready()?;
        let decoder = LumaDecoder::new(parts.size);
        Ok(Self { endpoint, patience, parts, timeline: CameraTimeline::default(), decoder })
    }

    fn advance(&mut self) -> Result<PushStep, SourceError> {
        let (since, mut skipped, mut broken) = (Instant::now(), 0, 0);
        loop {
            let (pushed, replaced) = self.endpoint.next(since, self.patience, &self.parts.stop)?;
            skipped = u64::saturating_add(skipped, replaced);
            let begun = Instant::now();
            let (capture_time, clock) = self.capture_time(&pushed);
            let decoded = match pushed.what {
                Payload::Frame(picture, _) => picture.decode(&mut self.decoder),
                Payload::Detections(mut observations, figures) => {
                    let move_ns = capture_time.ns_since(observations.capture_time);
                    observations.capture_time = capture_time;
                    for detection in &mut observations.detections {
                        detection.capture_time = detection.capture_time.plus_ns(move_ns);
                    }
                    // The sender's worker received the frame; that time must lie between capture and arrival.
                    let is_valid = pushed.times == SenderClock::Server
                        && observations.received_time >= capture_time
                        && observations.received_time <= pushed.arrived;
                    if !is_valid {
                        observations.received_time = pushed.arrived;
                    }
                    let observations = *observations;
                    let remote = RemoteDetections { observations, clock, skipped, figures };
                    return Ok(PushStep::Detections(Box::new(remote)));
                }
            };
            let what = || format!("a picture of {}", self.endpoint.sender_label());
            if self.decoder.accept(decoded, what)? {
                let decoding = begun.elapsed();
                let info = FrameInfo { capture_time, clock, skipped, broken, decoding };
                return Ok(PushStep::Frame(info));
            }
            broken += 1;
        }
    }

    /// Capture time of an item on the server's clock, and the clock it comes from.
    fn capture_time(&mut self, pushed: &PushedItem) -> (Timestamp, CaptureClock) {
        let stamp = pushed.stamp();
        let (capture_time, usual) = match pushed.times {
            SenderClock::Arrival => (pushed.arrived, CaptureClock::ARRIVAL),
            SenderClock::Counter => {
                (self.counter_time(stamp.as_ns(), pushed.arrived), CaptureClock::CAMERA)
            }
            SenderClock::Server => (stamp, CaptureClock::DRIVER),
            SenderClock::Unix => (stamp, CaptureClock::SYNCHRONIZED),
        };
        (capture_time, pushed.clock.unwrap_or(usual))
    }

    fn counter_time(&mut self, stamp_ns: i64, arrived: Timestamp) -> Timestamp {
        if !self.timeline.is_unsettled(stamp_ns, arrived) {
            return self.timeline.capture_time(stamp_ns, arrived);
        }
        let waited_s = self.parts.clock.now().seconds_since(arrived).max(0.0);
        self.parts.stop.wait(SETTLE.saturating_sub(Duration::from_secs_f64(waited_s)));
        self.timeline.capture_time_before(stamp_ns, arrived, &self.endpoint.queued_stamps())
    }
}

impl FrameSource for PushSource {
    /// Drops detections: [`FrameSource::next`] yields them.
    fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
        loop {
            if let PushStep::Frame(info) = self.advance()? {
                return Ok(LentFrame { frame: self.decoder.frame()?, info });
            }
        }
    }

    fn next(&mut self) -> Result<SourceOutput<'_>, SourceError> {
        match self.advance()? {
            PushStep::Frame(info) => {
                Ok(SourceOutput::Frame(LentFrame { frame: self.decoder.frame()?, info }))
            }
            PushStep::Detections(remote) => Ok(SourceOutput::Detections(remote)),
        }
    }
}
