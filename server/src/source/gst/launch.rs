//! From an address to a pipeline that is ready to play.

use std::time::Duration;

use gstreamer as gst;
use gstreamer::prelude::*;
use gstreamer_app::AppSink;

use super::{
    super::{MediaAddress, Transport},
    plugin,
};

/// What the sink takes: formats whose luma can be used as it lies. Others are converted to the first of them that
/// loses nothing.
const FORMATS: &str = "video/x-raw,format=(string){GRAY8,I420,NV12,NV21,YV12,Y42B,NV16,Y444,YUY2,YVYU,UYVY,GRAY16_LE}";
const SINK: &str = "roundel";
/// Packets of so much time are kept at most.
const TCP_BACKLOG: Duration = Duration::from_secs(2);

/// The pipeline and its end.
pub(super) fn pipeline(address: &MediaAddress) -> Result<(gst::Pipeline, AppSink), String> {
    let begin = match address {
        MediaAddress::Rtsp { .. } => {
            // Of a camera with sound, only the picture.
            "rtspsrc name=origin ! application/x-rtp,media=video ! decodebin".to_owned()
        }
        MediaAddress::File { .. } => "filesrc name=origin ! decodebin".to_owned(),
        MediaAddress::Pipeline(pipeline) => pipeline.clone(),
    };
    // A file is played in its own time; what is live comes in time by itself, and the newest wins.
    let sync = matches!(address, MediaAddress::File { .. });
    let end = format!(
        "videoconvert ! {FORMATS} ! appsink name={SINK} max-buffers=1 drop=true sync={sync} \
         qos=false enable-last-sample=false"
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
    pipeline.connect_deep_element_added(|_, _, element| {
        // A frame whose predecessors are missing is no picture of anything.
        if element.has_property("output-corrupt") {
            element.set_property("output-corrupt", false);
        }
    });
    let sink = pipeline.by_name(SINK).and_then(|sink| sink.downcast::<AppSink>().ok());
    let sink = sink.ok_or_else(|| format!("{address}: the pipeline has no element `{SINK}`"))?;
    if let Some(origin) = pipeline.by_name("origin") {
        set_origin(&origin, address);
    }
    Ok((pipeline, sink))
}

/// Properties rather than text, so that no character of an address has a meaning of its own.
fn set_origin(origin: &gst::Element, address: &MediaAddress) {
    match address {
        MediaAddress::Rtsp { url, credentials, transport, latency, .. } => {
            origin.set_property("location", url);
            if let Some((user, password)) = credentials {
                origin.set_property("user-id", user);
                origin.set_property("user-pw", password);
            }
            origin.set_property_from_str("protocols", transport.name());
            // What comes in order goes on at once: this is how long the missing is waited for, and how much is kept.
            // Over TCP nothing is missing, and a burst must not be taken for delay: what follows a dropped packet
            // would be decoded wrongly up to the next key frame.
            let kept = match transport {
                Transport::Tcp => TCP_BACKLOG.max(*latency),
                Transport::Udp => *latency,
            };
            origin.set_property("latency", u32::try_from(kept.as_millis()).unwrap_or(u32::MAX));
            origin.set_property("drop-on-latency", true);
            origin.set_property("add-reference-timestamp-meta", true);
            // A camera that does not answer is the supervisor's to retry, and soon.
            origin.set_property("tcp-timeout", 5_000_000_u64);
            origin.set_property("timeout", 2_000_000_u64);
        }
        MediaAddress::File { path, .. } => {
            origin.set_property("location", path.to_string_lossy().as_ref());
        }
        MediaAddress::Pipeline(_) => {}
    }
}
