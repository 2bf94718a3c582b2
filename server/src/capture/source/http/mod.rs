//! `http://…` – network cameras that send JPEGs: a stream (multipart/x-mixed-replace), or one JPEG for each request.
//!
//! A thread with its own single-threaded runtime receives and keeps the newest picture; the worker decodes its luma.
//! The capture time is the arrival, or, if the camera stamps its pictures (X-Timestamp), the camera's counter mapped to
//! the server's clock. Any error ends the connection and the source, and the worker's supervisor opens both again.

mod connection;
pub mod jpeg_splitter;

use std::{
    convert::Infallible,
    sync::Arc,
    time::{Duration, Instant},
};

use http_body_util::{BodyExt, Limited};
use hyper::body::Incoming;
use roundel_core::time::Timestamp;
use tokio::{runtime::Builder, time::timeout};

use self::{
    connection::{RESPONSE_TIMEOUT, ResponseKind, describe, request},
    jpeg_splitter::{JpegSplitter, StampedJpeg},
};
use super::{
    FrameInfo, FrameSource, LentFrame, SourceError, SourceParts,
    jpeg::LumaDecoder,
    mailbox::{Mailbox, MailboxSender},
    timing::CameraTimeline,
};
use crate::model::{
    address::HttpAddress, capture_clock::CaptureClock, clock::Clock, source_rules::SourceRules,
};

/// Timeout of the connection, the answer and the first picture, in addition to the stall timeout.
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
    /// `rules`: those that bind the source, if it is not one of the configuration file.
    pub(super) fn open(
        address: &HttpAddress,
        rules: Option<Arc<SourceRules>>,
        parts: SourceParts,
    ) -> Result<Self, SourceError> {
        let (requested, clock) = (address.clone(), parts.clock);
        let receive = move |sink: &MailboxSender<StampedJpeg>| {
            SourceError::Failed(receive(&requested, rules.as_deref(), clock, sink))
        };
        // The stall timeout must exceed the interval between snapshots.
        let interval = Duration::from_secs_f64(1.0 / address.snapshot_hz);
        let stall = address.stall.max(interval.mul_f64(2.0).min(Duration::from_secs(3600)));
        Ok(Self {
            mailbox: Mailbox::start("http camera", parts.stop, receive)?,
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
        let (begun, mut skipped, mut broken) = (Instant::now(), 0, 0);
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

/// Receives until an error or until the source is dropped, and returns the reason.
fn receive(
    address: &HttpAddress,
    rules: Option<&SourceRules>,
    clock: Clock,
    sink: &MailboxSender<StampedJpeg>,
) -> String {
    let runtime = match Builder::new_current_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => return format!("cannot receive from {address}: {error}"),
    };
    let why = runtime.block_on(async {
        tokio::select! {
            Err(why) = run_connection(address, rules, clock, sink) => why,
            () = sink.cancelled() => "the source was closed".to_owned(),
        }
    });
    // A name lookup may still block.
    runtime.shutdown_background();
    why
}

async fn run_connection(
    address: &HttpAddress,
    rules: Option<&SourceRules>,
    clock: Clock,
    sink: &MailboxSender<StampedJpeg>,
) -> Result<Infallible, String> {
    let interval = Duration::from_secs_f64(1.0 / address.snapshot_hz);
    loop {
        let due = tokio::time::Instant::now() + interval;
        // One connection per picture: many cameras close it after one, some without announcing it.
        match request(address, rules).await? {
            ResponseKind::Stream(body) => return stream(address, body, clock, sink).await,
            ResponseKind::Snapshot(body) => {
                sink.send(snapshot(address, body, clock.now()).await?);
            }
        }
        tokio::time::sleep_until(due).await;
    }
}

async fn stream(
    address: &HttpAddress,
    mut body: Incoming,
    clock: Clock,
    sink: &MailboxSender<StampedJpeg>,
) -> Result<Infallible, String> {
    let mut parts = JpegSplitter::default();
    sink.hint("the camera accepted the request but sends nothing");
    while let Some(frame) = body.frame().await {
        let frame = frame.map_err(|error| describe(address, &error))?;
        let Some(bytes) = frame.data_ref() else { continue };
        parts.push(bytes, clock.now());
        let mut is_picture = false;
        while let Some(part) = parts.pop() {
            sink.send(part);
            is_picture = true;
        }
        sink.count_broken(parts.take_broken());
        sink.hint(if is_picture {
            "the connection is open but nothing arrives (for a slow camera append `#stall=SECONDS` to its address)"
        } else {
            "the received data contain no complete JPEG"
        });
    }
    Err(format!("{} ended the stream", address.authority()))
}

async fn snapshot(
    address: &HttpAddress,
    body: Incoming,
    arrival: Timestamp,
) -> Result<StampedJpeg, String> {
    match timeout(RESPONSE_TIMEOUT, Limited::new(body, MAX_SNAPSHOT).collect()).await {
        Ok(Ok(body)) => Ok(StampedJpeg { jpeg: body.to_bytes().into(), arrival, stamp_ns: None }),
        Ok(Err(error)) => Err(match error.downcast_ref() {
            Some(error) => describe(address, error),
            None => format!("{address}: a picture of more than {MAX_SNAPSHOT} bytes"),
        }),
        Err(_) => Err(format!(
            "{address}: its picture did not arrive within {} s",
            RESPONSE_TIMEOUT.as_secs()
        )),
    }
}
