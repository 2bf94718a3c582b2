//! Error messages for missing GStreamer plugins, with the package to install.

use gstreamer as gst;

/// Debian's packages, and the prefixes of their elements' names.
const PACKAGES: [(&str, &[&str]); 8] = [
    ("libaravis-0.8-0", &["aravissrc"]),
    ("gstreamer1.0-libav", &["avdec_"]),
    ("gstreamer1.0-libcamera", &["libcamerasrc"]),
    ("gstreamer1.0-plugins-bad", &["h264parse", "h265parse", "openh264dec", "va"]),
    ("gstreamer1.0-plugins-base", &["appsink", "decodebin", "uridecodebin", "video"]),
    (
        "gstreamer1.0-plugins-good",
        &["jpegdec", "multipartdemux", "rtp", "rtspsrc", "souphttpsrc", "udpsrc", "v4l2", "vp8dec"],
    ),
    ("gstreamer1.0-plugins-ugly", &["x264enc"]),
    ("gstreamer1.0-vaapi", &["vaapi"]),
];
/// Media types, and the packages that decode them.
const DECODERS: [(&str, &str); 6] = [
    ("video/x-h264", "gstreamer1.0-libav"),
    ("video/x-h265", "gstreamer1.0-libav"),
    ("video/mpeg", "gstreamer1.0-libav"),
    ("image/jpeg", "gstreamer1.0-plugins-good"),
    ("video/quicktime", "gstreamer1.0-plugins-good"),
    ("application/x-rtp", "gstreamer1.0-plugins-good"),
];

/// The error of a missing element.
pub(super) fn element(name: &str) -> String {
    let known = PACKAGES
        .iter()
        .flat_map(|(package, prefixes)| prefixes.iter().map(move |prefix| (prefix, package)))
        .filter(|(prefix, _)| name.starts_with(**prefix));
    // The longest prefix counts: `vaapi…` begins with `va` too.
    match known.max_by_key(|(prefix, _)| prefix.len()) {
        Some((_, package)) => format!("GStreamer has no element `{name}`: install {package}"),
        None => format!(
            "GStreamer has no element `{name}`: check its name (`gst-inspect-1.0`), or install the plugin that has it"
        ),
    }
}

/// The error of a missing-plugin message; `None` for other messages.
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

/// What to do about an error, judged by its text.
pub(super) fn remedy(what: &str, debug: &str) -> Option<&'static str> {
    let has = |part: &str| what.contains(part) || debug.contains(part);
    if has("401") || has("Unauthorized") {
        Some("user or password is missing or wrong; write rtsp://USER:PASSWORD@HOST/…")
    } else if has("404") || has("Not found") && has("rtsp") {
        Some("the camera has no such path; find the address of the stream in its manual")
    } else if has("Could not find camera") {
        Some("check its name or address, power and cable (`arv-tool-0.8` lists those that answer)")
    } else if has("No such file") {
        Some("check the path")
    } else if has("Connection refused") || has("Failed to connect") {
        Some("nothing listens there; check host and port")
    } else if has("Parse error") {
        Some("the answer is not RTSP: check the port and the network")
    } else if has("any UDP packets") {
        Some(
            "append `#transport=tcp` to the address, so that the camera sends over its TCP connection",
        )
    } else if has("not-linked") {
        Some("the stream contains no pictures that GStreamer can decode")
    } else {
        None
    }
}
