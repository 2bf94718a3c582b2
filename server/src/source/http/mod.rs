//! `http://…` – network cameras that send JPEGs: a stream of them (multipart/x-mixed-replace, as ESP32-CAM and most
//! others), or one for each request.
//!
//! A thread with a small runtime of its own receives and keeps the newest picture; the worker decodes its luma.
//! Capture times are those of arrival, or, where the camera stamps its pictures (X-Timestamp), the camera's counter
//! brought to the server's clock. The connection lives as long as the source: any error ends both, and the worker's
//! supervisor opens them anew.

mod connection;
mod parts;

use std::time::{Duration, Instant};

use http_body_util::BodyExt;
use hyper::body::Incoming;
use tokio::{runtime::Builder, time::timeout};

use self::{
    connection::{ANSWER, Answer, Connection, told},
    parts::{Part, Parts},
};
use super::{
    CaptureClock, FrameInfo, FrameSource, HttpAddress, LentFrame, SourceError,
    feed::{Feed, Sink},
    jpeg::{JpegFault, LumaDecoder},
    timing::CameraTimeline,
    wrong_size,
};
use crate::{clock::Clock, stop::Stop};

/// For the connection, the answer and the first picture together, beyond what a stall is.
const FIRST_PICTURE: Duration = Duration::from_secs(9);
/// So many broken pictures one after the other, and it is no camera to wait for.
const MAX_BROKEN: u64 = 50;
/// A single picture is at most so long.
const MAX_SNAPSHOT: usize = 16 << 20;

/// What a source has to fit into.
#[derive(Clone, Copy, Debug)]
pub(super) struct HttpParts {
    /// Of the camera's calibration.
    pub(super) size: (usize, usize),
    /// The server's.
    pub(super) clock: Clock,
}

/// A camera's JPEGs.
pub(super) struct HttpSource {
    feed: Feed<Part>,
    decoder: LumaDecoder,
    timeline: CameraTimeline,
    name: String,
    size: (usize, usize),
    patience: Duration,
    stall: Duration,
    /// Broken ones since the last whole one.
    broken: u64,
}

impl HttpSource {
    pub(super) fn open(
        address: &HttpAddress,
        parts: HttpParts,
        stop: Stop,
    ) -> Result<Self, SourceError> {
        let asked = address.clone();
        let clock = parts.clock;
        let receive = move |sink: &Sink<Part>| SourceError::Failed(receive(&asked, clock, sink));
        // Single pictures come as often as they are asked for, however patient one is.
        let interval = Duration::from_secs_f64(1.0 / address.snapshot_hz);
        let stall = address.stall.max(interval.mul_f64(2.0).min(Duration::from_secs(3600)));
        Ok(Self {
            feed: Feed::start("http camera", stop, receive)?,
            decoder: LumaDecoder::new(parts.size),
            timeline: CameraTimeline::default(),
            name: address.to_string(),
            size: parts.size,
            patience: FIRST_PICTURE + stall,
            stall,
            broken: 0,
        })
    }
}

impl FrameSource for HttpSource {
    fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
        let mut skipped = 0;
        let mut broken = 0;
        let begun = Instant::now();
        loop {
            // What is broken does not make the wait longer.
            let taken = self.feed.next(begun, self.patience)?;
            (skipped, broken) = (skipped + taken.replaced, broken + taken.broken);
            let decoding = Instant::now();
            let decoded = self.decoder.decode(&taken.item.jpeg);
            let decoding = decoding.elapsed();
            let Part { arrival, stamp_ns, .. } = taken.item;
            match decoded {
                Ok(()) => {
                    (self.patience, self.broken) = (self.stall, 0);
                    let (capture_time, clock) = match stamp_ns {
                        Some(stamp_ns) => {
                            (self.timeline.capture_time(stamp_ns, arrival), CaptureClock::CAMERA)
                        }
                        None => (arrival, CaptureClock::ARRIVAL),
                    };
                    let info = FrameInfo { capture_time, clock, skipped, broken, decoding };
                    return Ok(LentFrame { frame: self.decoder.frame()?, info });
                }
                Err(JpegFault::Size(width, height)) => {
                    return Err(wrong_size(&self.name, self.size, (width, height)));
                }
                Err(JpegFault::Broken(reason)) => {
                    (broken, self.broken) = (broken + 1, self.broken + 1);
                    if self.broken > MAX_BROKEN {
                        return Err(SourceError::Failed(format!(
                            "{}: {MAX_BROKEN} pictures after one another are broken JPEGs: {reason}",
                            self.name
                        )));
                    }
                }
            }
        }
    }
}

/// Receives until nobody wants more or it fails, and says why.
fn receive(address: &HttpAddress, clock: Clock, sink: &Sink<Part>) -> String {
    let runtime = match Builder::new_current_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => return format!("cannot receive from {address}: {error}"),
    };
    let why = runtime.block_on(async {
        tokio::select! {
            why = converse(address, clock, sink) => why,
            () = sink.cancelled() => "nobody wants more".to_owned(),
        }
    });
    // Looking a name up may block longer than anybody waits.
    runtime.shutdown_background();
    why
}

async fn converse(address: &HttpAddress, clock: Clock, sink: &Sink<Part>) -> String {
    let interval = Duration::from_secs_f64(1.0 / address.snapshot_hz);
    loop {
        let due = tokio::time::Instant::now() + interval;
        // A new one for each picture: many cameras close after one, and some without saying so.
        let outcome = match Connection::open(address).await {
            Ok(connection) => connection.ask(address).await,
            Err(why) => Err(why),
        };
        let part = match outcome {
            Ok(Answer::Stream(body)) => return stream(address, body, clock, sink).await,
            Ok(Answer::Snapshot(body)) => snapshot(address, body, clock.now()).await,
            Err(why) => Err(why),
        };
        match part {
            Ok(part) => sink.put(part),
            Err(why) => return why,
        }
        tokio::time::sleep_until(due).await;
    }
}

async fn stream(
    address: &HttpAddress,
    mut body: Incoming,
    clock: Clock,
    sink: &Sink<Part>,
) -> String {
    let mut parts = Parts::default();
    sink.hint("the camera took the request and sends nothing");
    while let Some(frame) = body.frame().await {
        let frame = match frame {
            Ok(frame) => frame,
            Err(error) => return told(address, &error),
        };
        let Some(bytes) = frame.data_ref() else { continue };
        parts.push(bytes, clock.now());
        let mut is_picture = false;
        while let Some(part) = parts.pop() {
            sink.put(part);
            is_picture = true;
        }
        match parts.take_broken() {
            0 => {}
            broken => sink.count_broken(broken),
        }
        if is_picture {
            sink.hint("the connection stands and nothing comes (a slow camera: `#stall=SECONDS` behind its address)");
        } else {
            sink.hint("what comes holds no JPEG, or not its end");
        }
    }
    format!("{} ended the stream", address.authority())
}

async fn snapshot(
    address: &HttpAddress,
    mut body: Incoming,
    arrival: roundel_core::time::Timestamp,
) -> Result<Part, String> {
    let mut jpeg = Vec::new();
    let read = async {
        while let Some(frame) = body.frame().await {
            let frame = frame.map_err(|error| told(address, &error))?;
            jpeg.extend_from_slice(frame.data_ref().map_or(&[], |bytes| bytes));
            if jpeg.len() > MAX_SNAPSHOT {
                return Err(format!("{address}: a picture of more than {MAX_SNAPSHOT} bytes"));
            }
        }
        Ok(())
    };
    match timeout(ANSWER, read).await {
        Ok(outcome) => outcome?,
        Err(_) => {
            return Err(format!(
                "{address}: its picture was not there after {} s",
                ANSWER.as_secs()
            ));
        }
    }
    Ok(Part { jpeg, arrival, stamp_ns: None })
}
