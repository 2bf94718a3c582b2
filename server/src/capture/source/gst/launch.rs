//! From an address to a pipeline that is ready to play.

use std::time::Duration;

use gstreamer as gst;
use gstreamer::prelude::*;
use gstreamer_app::AppSink;

use super::{decode_timer::DecodeTimer, plugin};
use crate::model::address::MediaAddress;

/// What the sink takes: formats whose luma can be used as it lies. Others are converted to the first of them that
/// loses nothing.
const FORMATS: &str = "video/x-raw,format=(string){GRAY8,I420,NV12,NV21,YV12,Y42B,NV16,Y444,YUY2,YVYU,UYVY,GRAY16_LE}";
const SINK: &str = "roundel";
pub(super) const ORIGIN: &str = "origin";
const BACKLOG: &str = "backlog";
/// Sources that stamp frames by their camera's counter.
const OWN_COUNTERS: [&str; 1] = ["aravissrc"];
/// What waits to be decoded at most: more of it means that decoding is slower than the camera.
const BACKLOG_TIME: gst::ClockTime = gst::ClockTime::from_seconds(2);
const BACKLOG_BYTES: u32 = 32 << 20;
/// What GStreamer waits for packets beyond a stall.
const PAST_STALL: Duration = Duration::from_secs(1);

/// A pipeline, its end, and what its decoder takes.
pub(super) struct Launched {
    pub(super) pipeline: gst::Pipeline,
    pub(super) sink: AppSink,
    pub(super) decoding: DecodeTimer,
}

pub(super) fn launch(address: &MediaAddress) -> Result<Launched, String> {
    let begin = match address {
        MediaAddress::Rtsp { .. } => {
            // Of a camera with sound, only the picture.
            format!(
                "rtspsrc name={ORIGIN} ! application/x-rtp,media=video ! queue name={BACKLOG} max-size-buffers=0 \
                 max-size-time={} max-size-bytes={BACKLOG_BYTES} ! decodebin",
                BACKLOG_TIME.nseconds()
            )
        }
        MediaAddress::File { .. } => format!("filesrc name={ORIGIN} ! decodebin"),
        MediaAddress::Pipeline(pipeline) => pipeline.clone(),
    };
    // A file is played in its own time, or waits for whoever searches it; what is live comes in time by itself, and
    // the newest wins.
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
    let of_later = decoding.clone();
    pipeline.connect_deep_element_added(move |_, _, element| prepare(element, &of_later));
    pipeline.iterate_recurse().into_iter().flatten().for_each(|it| prepare(&it, &decoding));
    if let Some(backlog) = pipeline.by_name(BACKLOG) {
        backlog.connect("overrun", false, |values| {
            let backlog = values.first()?.get::<gst::Element>().ok()?;
            let words =
                "decoding falls behind: ask the camera for a smaller picture or a lower rate";
            gst::element_error!(backlog, gst::StreamError::Decode, ("{words}"));
            None
        });
    }
    let sink = pipeline.by_name(SINK).and_then(|sink| sink.downcast::<AppSink>().ok());
    let sink = sink.ok_or_else(|| format!("{address}: the pipeline has no element `{SINK}`"))?;
    if let Some(origin) = pipeline.by_name(ORIGIN) {
        set_origin(&origin, address);
    }
    Ok(Launched { pipeline, sink, decoding })
}

/// Whether frames are stamped by a counter of the camera's own.
pub(super) fn has_camera_timestamps(pipeline: &gst::Pipeline) -> bool {
    let counts = |element: gst::Element| {
        element.factory().is_some_and(|it| OWN_COUNTERS.contains(&it.name().as_str()))
    };
    pipeline.iterate_recurse().into_iter().flatten().any(counts)
}

/// Of those that the address names and those that GStreamer adds.
fn prepare(element: &gst::Element, decoding: &DecodeTimer) {
    // A frame whose predecessors are missing is no picture of anything.
    for (property, value) in
        [("output-corrupt", false), ("wait-for-keyframe", true), ("request-keyframe", true)]
    {
        if element.has_property(property) {
            element.set_property(property, value);
        }
    }
    decoding.watch(element);
}

/// Properties rather than text, so that no character of an address has a meaning of its own.
fn set_origin(origin: &gst::Element, address: &MediaAddress) {
    match address {
        MediaAddress::Rtsp { url, credentials, transport, latency, stall } => {
            origin.set_property("location", url);
            if let Some((user, password)) = credentials {
                origin.set_property("user-id", user);
                origin.set_property("user-pw", password);
            }
            origin.set_property_from_str("protocols", transport.name());
            // What comes in order goes on at once: this is how long a missing packet is waited for.
            let latency_ms = u32::try_from(latency.as_millis()).unwrap_or(u32::MAX);
            origin.set_property("latency", latency_ms);
            // Frames that come out of their order, as H.264's do, look like hours of delay to it.
            origin.set_property("drop-on-latency", false);
            origin.set_property("add-reference-timestamp-meta", true);
            // A camera that does not answer is the supervisor's to retry, and soon.
            origin.set_property("tcp-timeout", 5_000_000_u64);
            // Of packets on their own. Somewhat longer than a stall, which has words of its own.
            let silence_us = (*stall + PAST_STALL).as_micros();
            origin.set_property("timeout", u64::try_from(silence_us).unwrap_or(u64::MAX));
        }
        MediaAddress::File { path, .. } => {
            origin.set_property("location", path.to_string_lossy().as_ref());
        }
        MediaAddress::Pipeline(_) => {}
    }
}
