//! `rtsp:` sources that rules bind: GStreamer gets an address that the rules allow in place of the host's name, sends
//! nothing after a redirect, and failures to connect have the same words.

use std::{
    net::{IpAddr, SocketAddr, ToSocketAddrs},
    sync::mpsc::{RecvTimeoutError, channel},
    thread,
    time::{Duration, Instant},
};

use gstreamer as gst;
use gstreamer::{glib, prelude::*};
use hyper::Uri;

use super::{SourceError, launch::ORIGIN};
use crate::model::{
    address::MediaAddress,
    source_rules::{SourceRuleError, SourceRules},
    stop::StopSignal,
};

const LOOKUP_TIMEOUT: Duration = Duration::from_secs(3);
const POLL_INTERVAL: Duration = Duration::from_millis(20);
const DEFAULT_PORT: u16 = 554;

/// The address with an address that the rules allow in place of the host.
pub(super) fn pin(
    address: &MediaAddress,
    rules: &SourceRules,
    stop: &StopSignal,
) -> Result<MediaAddress, SourceError> {
    let mut pinned = address.clone();
    let MediaAddress::Rtsp { url, host, .. } = &mut pinned else { return Ok(pinned) };
    let failed = SourceError::Failed;
    let uri: Uri = url.parse().map_err(|error| failed(format!("{address}: {error}")))?;
    let found = look_up(host, uri.port_u16().unwrap_or(DEFAULT_PORT), stop)?;
    let Some(found) = found else { return Err(failed(no_answer(address))) };
    let allowed = found.into_iter().map(|it| it.ip()).find(|it| rules.allows(*it));
    let allowed =
        allowed.ok_or_else(|| failed(SourceRuleError::Network(host.clone()).to_string()))?;
    let authority = match allowed {
        IpAddr::V4(address) => address.to_string(),
        IpAddr::V6(address) => format!("[{address}]"),
    };
    let port = uri.port().map(|port| format!(":{port}")).unwrap_or_default();
    let target = uri.path_and_query().map_or("", |target| target.as_str());
    *url = format!("rtsp://{authority}{port}{target}");
    Ok(pinned)
}

/// The addresses of a host; `None` if there are none, or not in time.
fn look_up(
    host: &str,
    port: u16,
    stop: &StopSignal,
) -> Result<Option<Vec<SocketAddr>>, SourceError> {
    let (sender, receiver) = channel();
    let host = host.to_owned();
    // The operating system's lookup cannot be cancelled.
    let lookup = thread::Builder::new().name("name lookup".to_owned()).spawn(move || {
        let found = (host.as_str(), port).to_socket_addrs();
        let _ = sender.send(found.ok().map(Iterator::collect));
    });
    lookup.map_err(|error| SourceError::Failed(format!("cannot start a thread: {error}")))?;
    let deadline = Instant::now() + LOOKUP_TIMEOUT;
    loop {
        match receiver.recv_timeout(POLL_INTERVAL) {
            Ok(found) => return Ok(found),
            Err(RecvTimeoutError::Timeout) if stop.is_stopped() => {
                return Err(SourceError::Stopped);
            }
            Err(RecvTimeoutError::Timeout) if Instant::now() < deadline => {}
            Err(_) => return Ok(None),
        }
    }
}

/// Sends nothing more once the source has another location than at the start.
pub(super) fn reject_redirects(pipeline: &gst::Pipeline) {
    let Some(origin) = pipeline.by_name(ORIGIN) else { return };
    let has_signal = glib::subclass::SignalId::lookup("before-send", origin.type_()).is_some();
    if !has_signal {
        return;
    }
    let first: Option<String> = origin.property("location");
    origin.connect("before-send", false, move |values| {
        let origin = values.first()?.get::<gst::Element>().ok()?;
        let is_same = origin.property::<Option<String>>("location") == first;
        if !is_same {
            let message = "the camera redirects to another address: use that address as the source";
            gst::element_error!(origin, gst::ResourceError::NotFound, ("{message}"));
        }
        Some(is_same.to_value())
    });
}

/// Whether an error shows that a camera has answered.
pub(super) fn is_answer(error: &glib::Error) -> bool {
    let connection = error.kind::<gst::ResourceError>();
    connection.is_none_or(|it| {
        matches!(it, gst::ResourceError::NotAuthorized | gst::ResourceError::NotFound)
    })
}

/// The only error of a bound source before its camera has answered.
pub(super) fn no_answer(address: &MediaAddress) -> String {
    format!("no camera answers at {address}: is it on, in this network, and is the port right?")
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::model::address::SourceAddress;

    #[test]
    fn the_host_is_replaced_by_an_allowed_address() {
        let rules =
            SourceRules { folders: Vec::new(), networks: vec!["127.0.0.0/8".parse().unwrap()] };
        let pin = |url: &str| {
            let Ok(SourceAddress::Media(address)) = SourceAddress::parse(url, Path::new("")) else {
                panic!("{url} is no rtsp")
            };
            pin(&address, &rules, &StopSignal::default()).map(|address| address.to_string())
        };
        let url = "rtsp://u:p@localhost:8554/live?ch=1#stall=2";
        assert_eq!(pin(url), Ok("rtsp://127.0.0.1:8554/live?ch=1".to_owned()));
        assert_eq!(pin("rtsp://127.0.0.2/live"), Ok("rtsp://127.0.0.2/live".to_owned()));
        let error = pin("rtsp://0.0.0.0/live").unwrap_err().to_string();
        assert!(error.contains("0.0.0.0 is in no network"), "{error}");
        let error = pin("rtsp://camera.invalid/live").unwrap_err().to_string();
        assert!(error.starts_with("no camera answers at rtsp://camera.invalid/live"), "{error}");
    }
}
