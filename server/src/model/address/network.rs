//! `http://USER:PASSWORD@HOST:PORT/PATH?QUERY#OPTIONS`: the options after `#` are Roundel's own.

use std::{fmt, time::Duration};

use hyper::Uri;
use percent_encoding::percent_decode_str;

use super::{AddressError, Options};
use crate::model::redact::redact;

const HTTP_EXAMPLE: &str = "`http://192.168.1.20:81/stream`";
const DEFAULT_SNAPSHOT_HZ: f64 = 10.0;

/// `http://HOST/PATH`: a stream of JPEGs, or a JPEG to poll.
#[derive(Clone, PartialEq)]
pub struct HttpAddress {
    /// Host and port as a connection takes them; IPv6 addresses without brackets.
    pub host: String,
    pub port: u16,
    pub target: String,
    pub credentials: Option<(String, String)>,
    /// Requests a second to a camera that sends single pictures.
    pub snapshot_hz: f64,
    /// A pause of this length is a failure.
    pub stall: Duration,
}

impl fmt::Debug for HttpAddress {
    /// Without secrets.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "HttpAddress({self})")
    }
}

impl fmt::Display for HttpAddress {
    /// Without secrets and options.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&redact(&format!("http://{}{}", self.authority(), self.target)))
    }
}

impl HttpAddress {
    /// Host and port for the Host header.
    pub fn authority(&self) -> String {
        let host =
            if self.host.contains(':') { format!("[{}]", self.host) } else { self.host.clone() };
        if self.port == 80 { host } else { format!("{host}:{}", self.port) }
    }
}

/// A source's URL without user and password. The rest stays as the camera needs it.
fn without_credentials(url: &str) -> String {
    let Some((scheme, rest)) = url.split_once("://") else { return url.to_owned() };
    let end = rest.find(['/', '?', '#']).unwrap_or(rest.len());
    // A password may contain an unescaped @.
    match rest[..end].rfind('@') {
        Some(at) => format!("{scheme}://{}", &rest[at + 1..]),
        None => url.to_owned(),
    }
}

/// A URL of a network camera, split into its parts.
pub(super) struct NetworkUrl<'u> {
    /// Without user, password and options.
    pub(super) shown: String,
    pub(super) uri: Uri,
    pub(super) credentials: Option<(String, String)>,
    pub(super) query: &'u str,
}

impl<'u> NetworkUrl<'u> {
    pub(super) fn parse(url: &'u str, example: &'static str) -> Result<Self, AddressError> {
        let wrong = |reason: String| {
            let found = redact(url);
            AddressError::Network { found, reason, example }
        };
        let (plain, query) = url.split_once('#').unwrap_or((url, ""));
        let credentials = credentials(plain).map_err(wrong)?;
        let shown = without_credentials(plain);
        let uri: Uri = shown.parse().map_err(|error| wrong(format!("{error}")))?;
        if uri.host().is_none_or(str::is_empty) {
            return Err(wrong("it names no host".to_owned()));
        }
        // `Uri` ignores a port that is not a number.
        let authority = uri.authority().map_or("", |authority| authority.as_str());
        let port = authority.rsplit_once(':').map(|(_, port)| port);
        if let Some(port) = port.filter(|port| !port.ends_with(']') && port.parse::<u16>().is_err())
        {
            // It may be a password with an unescaped delimiter.
            let found = if url.contains('@') { "no number" } else { port };
            return Err(wrong(format!("its port must be a number up to 65535, found `{found}`")));
        }
        Ok(Self { shown, uri, credentials, query })
    }
}

pub(super) fn http(url: &str) -> Result<HttpAddress, AddressError> {
    let NetworkUrl { uri, credentials, query, .. } = NetworkUrl::parse(url, HTTP_EXAMPLE)?;
    let options = Options::parse("http", &["fps", "stall"], query)?;
    Ok(HttpAddress {
        host: host(&uri),
        port: uri.port_u16().unwrap_or(80),
        target: uri.path_and_query().map_or("/", |target| target.as_str()).to_owned(),
        credentials,
        snapshot_hz: options.frame_rate()?.unwrap_or(DEFAULT_SNAPSHOT_HZ),
        stall: options.stall()?,
    })
}

/// Without the brackets of an IPv6 address.
pub(super) fn host(uri: &Uri) -> String {
    uri.host().unwrap_or_default().trim_matches(['[', ']']).to_owned()
}

/// User and password of a URL.
pub(super) fn credentials(url: &str) -> Result<Option<(String, String)>, String> {
    let rest = url.split_once("://").map_or(url, |(_, rest)| rest);
    let authority = &rest[..rest.find(['/', '?', '#']).unwrap_or(rest.len())];
    let Some((user_info, _)) = authority.rsplit_once('@') else { return Ok(None) };
    let (user, password) = user_info.split_once(':').unwrap_or((user_info, ""));
    Ok(Some((unescape(user)?, unescape(password)?)))
}

/// Decodes %XX.
fn unescape(text: &str) -> Result<String, String> {
    let is_escape = |after: &str| {
        after.as_bytes().get(..2).is_some_and(|digits| digits.iter().all(u8::is_ascii_hexdigit))
    };
    // The crate accepts a % that begins no escape.
    if !text.split('%').skip(1).all(is_escape) {
        return Err(
            "its password has a % that is not followed by two hex digits (write %25)".to_owned()
        );
    }
    let plain = percent_decode_str(text).decode_utf8();
    plain.map(Into::into).map_err(|_| "its user or password is no UTF-8".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passwords_are_not_shown() {
        for (url, shown) in [
            ("http://u:p@h/x", "http://h/x"),
            ("http://u:p@q@h:81", "http://h:81"),
            ("http://h/x@y", "http://h/x@y"),
            ("images:a@b/*.png", "images:a@b/*.png"),
        ] {
            assert_eq!(without_credentials(url), shown);
        }
    }
}
