//! What GStreamer lacks, in words that name the package to install.

use gstreamer as gst;

/// Elements, or how their names begin, and Debian's packages of them.
const PACKAGES: [(&str, &str); 21] = [
    ("aravissrc", "libaravis-0.8-0"),
    ("avdec_", "gstreamer1.0-libav"),
    ("appsink", "gstreamer1.0-plugins-base"),
    ("decodebin", "gstreamer1.0-plugins-base"),
    ("h264parse", "gstreamer1.0-plugins-bad"),
    ("h265parse", "gstreamer1.0-plugins-bad"),
    ("jpegdec", "gstreamer1.0-plugins-good"),
    ("libcamerasrc", "gstreamer1.0-libcamera"),
    ("multipartdemux", "gstreamer1.0-plugins-good"),
    ("openh264dec", "gstreamer1.0-plugins-bad"),
    ("rtp", "gstreamer1.0-plugins-good"),
    ("rtspsrc", "gstreamer1.0-plugins-good"),
    ("souphttpsrc", "gstreamer1.0-plugins-good"),
    ("udpsrc", "gstreamer1.0-plugins-good"),
    ("uridecodebin", "gstreamer1.0-plugins-base"),
    ("v4l2", "gstreamer1.0-plugins-good"),
    ("va", "gstreamer1.0-plugins-bad"),
    ("vaapi", "gstreamer1.0-vaapi"),
    ("video", "gstreamer1.0-plugins-base"),
    ("vp8dec", "gstreamer1.0-plugins-good"),
    ("x264enc", "gstreamer1.0-plugins-ugly"),
];
/// What streams hold, as GStreamer calls it, and packages that decode it.
const DECODERS: [(&str, &str); 6] = [
    ("video/x-h264", "gstreamer1.0-libav"),
    ("video/x-h265", "gstreamer1.0-libav"),
    ("video/mpeg", "gstreamer1.0-libav"),
    ("image/jpeg", "gstreamer1.0-plugins-good"),
    ("video/quicktime", "gstreamer1.0-plugins-good"),
    ("application/x-rtp", "gstreamer1.0-plugins-good"),
];

/// An element that is not there.
pub(super) fn element(name: &str) -> String {
    let known = PACKAGES.iter().filter(|(begin, _)| name.starts_with(begin));
    // `vaapi…` begins with `va` too: the longest says most.
    let package = known.max_by_key(|(begin, _)| begin.len()).map(|(_, package)| *package);
    match package {
        Some(package) => format!("GStreamer has no element `{name}`: install {package}"),
        None => format!(
            "GStreamer has no element `{name}`: check its name (`gst-inspect-1.0`), or install the plugin that has it"
        ),
    }
}

/// What a missing-plugin message says; `None`: it is another message.
pub(super) fn missing(structure: &gst::StructureRef) -> Option<String> {
    if structure.name() != "missing-plugin" {
        return None;
    }
    let what = structure.get::<&str>("name").unwrap_or("a plugin");
    let detail = structure.get::<gst::Caps>("detail").ok();
    let media = detail.as_ref().and_then(|caps| caps.structure(0)).map(|it| it.name().to_string());
    if let Ok(name) = structure.get::<&str>("detail") {
        return Some(element(name));
    }
    let known = media.and_then(|media| DECODERS.iter().find(|(known, _)| *known == media));
    let package = known.map_or("the plugin for it", |(_, package)| package);
    Some(format!("GStreamer lacks: {what}; install {package}"))
}

/// What to do about an error, as far as its words tell.
pub(super) fn remedy(what: &str, debug: &str) -> Option<&'static str> {
    let has = |part: &str| what.contains(part) || debug.contains(part);
    if has("401") || has("Unauthorized") {
        Some("user or password is missing or wrong: rtsp://USER:PASSWORD@HOST/…")
    } else if has("404") || has("Not found") && has("rtsp") {
        Some("the camera has no such path; find the address of the stream in its manual")
    } else if has("Could not find camera") {
        Some("check its name or address, power and cable (`arv-tool-0.8` lists those that answer)")
    } else if has("No such file") {
        Some("check the path")
    } else if has("Connection refused") || has("Failed to connect") {
        Some("nothing listens there; check host and port")
    } else if has("Parse error") {
        Some("what came is no RTSP: is it a camera's port, and is the network sound?")
    } else if has("any UDP packets") {
        Some("`#transport=tcp` behind the address has the camera send within its connection")
    } else if has("not-linked") {
        Some("the stream holds no picture that GStreamer can decode")
    } else {
        None
    }
}
