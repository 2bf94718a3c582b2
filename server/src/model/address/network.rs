//! `http://USER:PASSWORD@HOST:PORT/PATH?QUERY#OPTIONS`: what stands after `#` is for Roundel, the rest for the
//! camera.

use std::{fmt, time::Duration};

use hyper::Uri;
use percent_encoding::percent_decode_str;

use super::{AddressError, frame_rate, options};

const HTTP_KEYS: [&str; 2] = ["fps", "stall"];
const HTTP_EXAMPLE: &str = "`http://192.168.1.20:81/stream`";
/// Snapshots a second, where a camera gives no stream and nothing else is said.
const SNAPSHOT_HZ: f64 = 10.0;
/// A stall, where nothing else is said, seconds; and the longest that may be said.
pub(super) const STALL_S: f64 = 1.0;
const MAX_STALL_S: f64 = 3600.0;

/// `http://HOST/PATH`: a stream of JPEGs, or a JPEG that is asked for again and again.
#[derive(Clone, PartialEq)]
pub struct HttpAddress {
    /// Host and port as a connection takes them; IPv6 addresses without brackets.
    pub host: String,
    pub port: u16,
    pub target: String,
    pub credentials: Option<(String, String)>,
    /// How often a camera that gives single pictures is asked for one, 1/s.
    pub snapshot_hz: f64,
    /// No picture for so long is a failure.
    pub stall: Duration,
}

impl fmt::Debug for HttpAddress {
    /// Passwords stay out of logs.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "HttpAddress({self})")
    }
}

impl fmt::Display for HttpAddress {
    /// The address without user, password and options.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "http://{}{}", self.authority(), self.target)
    }
}

impl HttpAddress {
    /// Host and port for the Host header.
    pub fn authority(&self) -> String {
        let host = match self.host.contains(':') {
            true => format!("[{}]", self.host),
            false => self.host.clone(),
        };
        if self.port == 80 { host } else { format!("{host}:{}", self.port) }
    }
}

/// A source's URL without user and password, safe to show.
pub fn without_credentials(url: &str) -> String {
    let Some((scheme, rest)) = url.split_once("://") else { return url.to_owned() };
    let end = rest.find(['/', '?', '#']).unwrap_or(rest.len());
    // A password may hold an @ that was not escaped: the last one counts.
    match rest[..end].rfind('@') {
        Some(at) => format!("{scheme}://{}", &rest[at + 1..]),
        None => url.to_owned(),
    }
}

/// Reads the address of a camera that speaks HTTP.
pub(super) fn http(url: &str) -> Result<HttpAddress, AddressError> {
    let wrong = |reason: String| AddressError::Network {
        found: without_credentials(url),
        reason,
        example: HTTP_EXAMPLE,
    };
    let (plain, query) = url.split_once('#').unwrap_or((url, ""));
    let credentials = credentials(plain).map_err(wrong)?;
    let uri: Uri = without_credentials(plain).parse().map_err(|error| wrong(format!("{error}")))?;
    let host = uri.host().filter(|host| !host.is_empty());
    let host = host.ok_or_else(|| wrong("it names no host".to_owned()))?;
    check_port(&uri).map_err(wrong)?;
    let mut address = HttpAddress {
        host: host.trim_matches(['[', ']']).to_owned(),
        port: uri.port_u16().unwrap_or(80),
        target: uri.path_and_query().map_or("/", |target| target.as_str()).to_owned(),
        credentials,
        snapshot_hz: SNAPSHOT_HZ,
        stall: Duration::from_secs_f64(STALL_S),
    };
    for option in options("http", &HTTP_KEYS, query) {
        match option? {
            ("fps", value) => address.snapshot_hz = frame_rate(value)?,
            (_, value) => address.stall = stall(value)?,
        }
    }
    Ok(address)
}

/// A port that is no number is none to the parser.
pub(super) fn check_port(uri: &Uri) -> Result<(), String> {
    let authority = uri.authority().map_or("", |authority| authority.as_str());
    let port = authority.rsplit_once(':').map(|(_, port)| port).filter(|port| !port.ends_with(']'));
    match port {
        Some(port) if port.parse::<u16>().is_err() => {
            Err(format!("its port must be a number up to 65535, found `{port}`"))
        }
        _ => Ok(()),
    }
}

pub(super) fn stall(value: &str) -> Result<Duration, AddressError> {
    let seconds: Option<f64> = value.parse().ok().filter(|s| *s > 0.0 && *s <= MAX_STALL_S);
    seconds.map(Duration::from_secs_f64).ok_or_else(|| AddressError::Value {
        option: "stall",
        expected: format!("seconds above 0, at most {MAX_STALL_S}"),
        found: value.to_owned(),
    })
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
    // The crate keeps a % that begins no escape.
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
    fn addresses_are_taken_apart() {
        let address = http("http://lab:p%40ss%3A@cam-1:81/stream?res=9#stall=5&fps=2.5").unwrap();
        assert_eq!(address.to_string(), "http://cam-1:81/stream?res=9");
        assert_eq!((address.host.as_str(), address.port), ("cam-1", 81));
        assert_eq!(address.credentials, Some(("lab".to_owned(), "p@ss:".to_owned())));
        assert_eq!((address.snapshot_hz, address.stall), (2.5, Duration::from_secs(5)));
        assert!(!format!("{address:?}").contains("p@ss"));
        let address = http("http://[::1]").unwrap();
        assert_eq!(
            (address.host.as_str(), address.port, address.target.as_str()),
            ("::1", 80, "/")
        );
        assert_eq!(address.authority(), "[::1]");
        assert_eq!(address.credentials, None);
    }

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
        let error = http("http://u:secret@").unwrap_err().to_string();
        assert!(error.contains("`http://` is no address of a camera"), "{error}");
    }

    #[test]
    fn wrong_addresses_say_what_to_write() {
        for (url, expected) in [
            ("http://", "write it as `http://192.168.1.20:81/stream`"),
            (
                "http://host:port/",
                "`http://host:port/` is no address of a camera: its port must be a number up to 65535, found `port`",
            ),
            ("http://u:%zz@host/", "two hex digits (write %25)"),
            (
                "http://host/#stall=0",
                "option `stall` must be seconds above 0, at most 3600, found `0`",
            ),
            ("http://host/#fps=fast", "option `fps` must be a number above 0, at most 1000"),
            (
                "http://host/#fsp=3",
                "unknown option `fsp` of an `http:` source; did you mean `fps`?",
            ),
        ] {
            let error = http(url).expect_err(url).to_string();
            assert!(error.contains(expected), "{url}: {error}");
        }
    }
}
