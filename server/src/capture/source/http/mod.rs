//! `http://…` – network cameras that send JPEGs: a stream (multipart/x-mixed-replace), or one JPEG for each request.
//!
//! A thread with its own single-threaded runtime receives and keeps the newest picture; the worker decodes its luma.
//! The capture time is the arrival, or, where the camera stamps its pictures (X-Timestamp), the camera's counter mapped
//! to the server's clock. Any error ends the connection and the source, and the worker's supervisor opens both again.

mod connection;
mod jpeg_splitter;

use std::time::{Duration, Instant};

use http_body_util::BodyExt;
use hyper::body::Incoming;
use tokio::{runtime::Builder, time::timeout};

use self::{
    connection::{Connection, RESPONSE_TIMEOUT, ResponseKind, describe},
    jpeg_splitter::{JpegSplitter, StampedJpeg},
};
use super::{
    FrameInfo, FrameSource, LentFrame, SourceError, SourceParts,
    jpeg::LumaDecoder,
    mailbox::{Mailbox, MailboxSender},
    timing::CameraTimeline,
};
use crate::model::{address::HttpAddress, capture_clock::CaptureClock};
use crate::model::{clock::Clock, stop::StopSignal};

/// Time for the connection, the answer and the first picture, in addition to the stall timeout.
const FIRST_PICTURE: Duration = Duration::from_secs(9);
/// Longest single picture, bytes.
const MAX_SNAPSHOT: usize = 16 << 20;

pub(super) struct HttpSource {
    mailbox: Mailbox<StampedJpeg>,
    decoder: LumaDecoder,
    timeline: CameraTimeline,
    name: String,
    patience: Duration,
    stall: Duration,
}

impl HttpSource {
    pub(super) fn open(
        address: &HttpAddress,
        parts: SourceParts,
        stop: StopSignal,
    ) -> Result<Self, SourceError> {
        let asked = address.clone();
        let clock = parts.clock;
        let receive = move |sink: &MailboxSender<StampedJpeg>| {
            SourceError::Failed(receive(&asked, clock, sink))
        };
        // The stall timeout must exceed the interval between snapshots.
        let interval = Duration::from_secs_f64(1.0 / address.snapshot_hz);
        let stall = address.stall.max(interval.mul_f64(2.0).min(Duration::from_secs(3600)));
        Ok(Self {
            mailbox: Mailbox::start("http camera", stop, receive)?,
            decoder: LumaDecoder::new(parts.size),
            timeline: CameraTimeline::default(),
            name: address.to_string(),
            patience: FIRST_PICTURE + stall,
            stall,
        })
    }
}

impl FrameSource for HttpSource {
    fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
        let mut skipped = 0;
        let mut broken = 0;
        let begun = Instant::now();
        loop {
            // A broken picture does not restart the timeout.
            let taken = self.mailbox.next(begun, self.patience)?;
            (skipped, broken) = (skipped + taken.replaced, broken + taken.broken);
            let decoding = Instant::now();
            let decoded = self.decoder.decode(&taken.item.jpeg);
            let decoding = decoding.elapsed();
            if !self.decoder.accept(decoded, || self.name.clone())? {
                broken += 1;
                continue;
            }
            self.patience = self.stall;
            let StampedJpeg { arrival, stamp_ns, .. } = taken.item;
            let (capture_time, clock) = match stamp_ns {
                Some(stamp_ns) => {
                    (self.timeline.capture_time(stamp_ns, arrival), CaptureClock::CAMERA)
                }
                None => (arrival, CaptureClock::ARRIVAL),
            };
            let info = FrameInfo { capture_time, clock, skipped, broken, decoding };
            return Ok(LentFrame { frame: self.decoder.frame()?, info });
        }
    }
}

/// Receives until it fails or the source is dropped, and returns the reason.
fn receive(address: &HttpAddress, clock: Clock, sink: &MailboxSender<StampedJpeg>) -> String {
    let runtime = match Builder::new_current_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => return format!("cannot receive from {address}: {error}"),
    };
    let why = runtime.block_on(async {
        tokio::select! {
            why = run_connection(address, clock, sink) => why,
            () = sink.cancelled() => "the source was closed".to_owned(),
        }
    });
    // A name lookup may still block.
    runtime.shutdown_background();
    why
}

async fn run_connection(
    address: &HttpAddress,
    clock: Clock,
    sink: &MailboxSender<StampedJpeg>,
) -> String {
    let interval = Duration::from_secs_f64(1.0 / address.snapshot_hz);
    loop {
        let due = tokio::time::Instant::now() + interval;
        // One connection per picture: many cameras close it after one, some without announcing it.
        let outcome = match Connection::open(address).await {
            Ok(connection) => connection.send_request(address).await,
            Err(why) => Err(why),
        };
        let part = match outcome {
            Ok(ResponseKind::Stream(body)) => return stream(address, body, clock, sink).await,
            Ok(ResponseKind::Snapshot(body)) => snapshot(address, body, clock.now()).await,
            Err(why) => Err(why),
        };
        match part {
            Ok(part) => sink.send(part),
            Err(why) => return why,
        }
        tokio::time::sleep_until(due).await;
    }
}

async fn stream(
    address: &HttpAddress,
    mut body: Incoming,
    clock: Clock,
    sink: &MailboxSender<StampedJpeg>,
) -> String {
    let mut parts = JpegSplitter::default();
    sink.hint("the camera took the request and sends nothing");
    while let Some(frame) = body.frame().await {
        let frame = match frame {
            Ok(frame) => frame,
            Err(error) => return describe(address, &error),
        };
        let Some(bytes) = frame.data_ref() else { continue };
        parts.push(bytes, clock.now());
        let mut is_picture = false;
        while let Some(part) = parts.pop() {
            sink.send(part);
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
) -> Result<StampedJpeg, String> {
    let mut jpeg = Vec::new();
    let read = async {
        while let Some(frame) = body.frame().await {
            let frame = frame.map_err(|error| describe(address, &error))?;
            jpeg.extend_from_slice(frame.data_ref().map_or(&[], |bytes| bytes));
            if jpeg.len() > MAX_SNAPSHOT {
                return Err(format!("{address}: a picture of more than {MAX_SNAPSHOT} bytes"));
            }
        }
        Ok(())
    };
    match timeout(RESPONSE_TIMEOUT, read).await {
        Ok(outcome) => outcome?,
        Err(_) => {
            return Err(format!(
                "{address}: its picture was not there after {} s",
                RESPONSE_TIMEOUT.as_secs()
            ));
        }
    }
    Ok(StampedJpeg { jpeg, arrival, stamp_ns: None })
}
