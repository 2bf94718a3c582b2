//! Builds the pipeline of an address.

use std::time::Duration;

use gstreamer as gst;
use gstreamer::prelude::*;
use gstreamer_app::AppSink;

use super::{decode_timer::DecodeTimer, plugin};
use crate::model::address::MediaAddress;

/// Formats that the sink accepts: those whose luma is used in place or gathered in one pass. GStreamer converts others
/// to the first of them that loses nothing.
const FORMATS: &str = "video/x-raw,format=(string){GRAY8,I420,NV12,NV21,YV12,Y42B,NV16,Y444,YUY2,YVYU,UYVY,GRAY16_LE}";
const SINK: &str = "roundel";
pub(super) const ORIGIN: &str = "origin";
const BACKLOG: &str = "backlog";
/// Limits of the queue before the decoder; if it overflows, decoding is slower than the camera.
const BACKLOG_TIME: gst::ClockTime = gst::ClockTime::from_seconds(2);
const BACKLOG_BYTES: u32 = 32 << 20;
/// GStreamer's timeout in addition to the stall timeout.
const PAST_STALL: Duration = Duration::from_secs(1);

/// The pipeline, its sink, and a timer of its decoder.
pub(super) fn launch(
    address: &MediaAddress,
) -> Result<(gst::Pipeline, AppSink, DecodeTimer), String> {
    let begin = match address {
        MediaAddress::Rtsp { .. } => {
            // Without the sound.
            format!(
                "rtspsrc name={ORIGIN} ! application/x-rtp,media=video ! queue name={BACKLOG} max-size-buffers=0 \
                 max-size-time={} max-size-bytes={BACKLOG_BYTES} ! decodebin",
                BACKLOG_TIME.nseconds()
            )
        }
        MediaAddress::File { .. } => format!("filesrc name={ORIGIN} ! decodebin"),
        MediaAddress::Pipeline(pipeline) => pipeline.clone(),
    };
    // A file is played in real time, or as fast as the worker takes frames. A live source sets its own pace, and its
    // newest frame wins.
    let hurry = matches!(address, MediaAddress::File { hurry: true, .. });
    let sync = matches!(address, MediaAddress::File { .. }) && !hurry;
    let end = format!(
        "videoconvert ! {FORMATS} ! appsink name={SINK} max-buffers=1 drop={} sync={sync} \
         qos=false enable-last-sample=false",
        !hurry
    );
    let mut context = gst::ParseContext::new();
    let flags = gst::ParseFlags::FATAL_ERRORS;
    let parsed = gst::parse::launch_full(&format!("{begin} ! {end}"), Some(&mut context), flags);
    let element = parsed.map_err(|error| {
        let missing = context.missing_elements();
        match missing.first() {
            Some(missing) => format!("{address}: {}", plugin::element(missing)),
            None => format!("{address}: GStreamer cannot read the pipeline: {error}"),
        }
    })?;
    let pipeline = element
        .downcast::<gst::Pipeline>()
        .map_err(|_| format!("{address}: expected a pipeline of elements linked by `!`"))?;
    let decoding = DecodeTimer::default();
    let timer = decoding.clone();
    pipeline.connect_deep_element_added(move |_, _, element| prepare(element, &timer));
    pipeline.iterate_recurse().into_iter().flatten().for_each(|it| prepare(&it, &decoding));
    if let Some(backlog) = pipeline.by_name(BACKLOG) {
        backlog.connect("overrun", false, |values| {
            let backlog = values.first()?.get::<gst::Element>().ok()?;
            let message =
                "decoding falls behind: ask the camera for a smaller picture or a lower rate";
            gst::element_error!(backlog, gst::StreamError::Decode, ("{message}"));
            None
        });
    }
    let sink = pipeline.by_name(SINK).and_then(|sink| sink.downcast::<AppSink>().ok());
    let sink = sink.ok_or_else(|| format!("{address}: the pipeline has no element `{SINK}`"))?;
    if let Some(origin) = pipeline.by_name(ORIGIN) {
        set_origin(&origin, address);
    }
    Ok((pipeline, sink, decoding))
}

/// Whether the camera's own counter stamps the frames.
pub(super) fn has_camera_timestamps(pipeline: &gst::Pipeline) -> bool {
    let counts = |element: gst::Element| {
        element.factory().is_some_and(|factory| factory.name().as_str() == "aravissrc")
    };
    pipeline.iterate_recurse().into_iter().flatten().any(counts)
}

/// Sets up an element that the address names or GStreamer adds.
fn prepare(element: &gst::Element, decoding: &DecodeTimer) {
    // A frame that is decoded without its predecessors is corrupt.
    for (property, value) in
        [("output-corrupt", false), ("wait-for-keyframe", true), ("request-keyframe", true)]
    {
        if element.has_property(property) {
            element.set_property(property, value);
        }
    }
    decoding.watch(element);
}

/// Sets properties instead of writing the values into the pipeline's text, where they would need escapes.
fn set_origin(origin: &gst::Element, address: &MediaAddress) {
    match address {
        MediaAddress::Rtsp { url, credentials, transport, latency, stall, .. } => {
            origin.set_property("location", url);
            if let Some((user, password)) = credentials {
                origin.set_property("user-id", user);
                origin.set_property("user-pw", password);
            }
            origin.set_property_from_str("protocols", transport.name());
            // Timeout of a missing packet; packets in order pass at once.
            let latency_ms = u32::try_from(latency.as_millis()).unwrap_or(u32::MAX);
            origin.set_property("latency", latency_ms);
            // Reordered frames, as in H.264, would look like hours of delay.
            origin.set_property("drop-on-latency", false);
            origin.set_property("add-reference-timestamp-meta", true);
            // Short, because the supervisor retries.
            origin.set_property("tcp-timeout", 5_000_000_u64);
            // Longer than the stall timeout, whose message is better.
            let silence_us = (*stall + PAST_STALL).as_micros();
            origin.set_property("timeout", u64::try_from(silence_us).unwrap_or(u64::MAX));
        }
        MediaAddress::File { path, .. } => {
            origin.set_property("location", path.to_string_lossy().as_ref());
        }
        MediaAddress::Pipeline(_) => {}
    }
}
