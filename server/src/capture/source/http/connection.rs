//! One request to a camera, and the classification of its answer.
//!
//! Rules bind a source that a client named: its host is resolved once, and the connection goes to an address that the
//! rules allow. Until such a camera has answered, every failure has the same words, so that a client cannot find out
//! which ports of other machines are open. Redirects are never followed.

use std::{io, net::SocketAddr, time::Duration};

use base64::{Engine, prelude::BASE64_STANDARD};
use http_body_util::Empty;
use hyper::{
    HeaderMap, Request, Response, StatusCode,
    body::{Bytes, Incoming},
    client::conn::http1,
    header::{self, HeaderName, HeaderValue},
};
use hyper_util::rt::TokioIo;
use tokio::{
    net::{TcpStream, ToSocketAddrs, lookup_host},
    time::timeout,
};

use crate::model::{
    address::HttpAddress,
    source_rules::{SourceRuleError, SourceRules},
};

/// Timeout of the answer. Cameras may first have to switch on.
pub(super) const RESPONSE_TIMEOUT: Duration = Duration::from_secs(5);
const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
const ACCEPT: &str = "multipart/x-mixed-replace, image/jpeg;q=0.9, */*;q=0.1";

pub(super) enum ResponseKind {
    Stream(Incoming),
    /// One picture; the next one needs another request.
    Snapshot(Incoming),
}

/// Connects and requests the picture or the stream; a task of the current runtime drives the connection.
pub(super) async fn request(
    address: &HttpAddress,
    rules: Option<&SourceRules>,
) -> Result<ResponseKind, String> {
    let response = match rules {
        None => exchange(address, (address.host.as_str(), address.port)).await?,
        Some(rules) => {
            let allowed = resolve(address, rules).await?;
            exchange(address, &allowed[..]).await.map_err(|_| no_answer(address))?
        }
    };
    classify_response(address, response)
}

/// The addresses of the host that the rules allow, at least one.
async fn resolve(address: &HttpAddress, rules: &SourceRules) -> Result<Vec<SocketAddr>, String> {
    let found = timeout(CONNECT_TIMEOUT, lookup_host((address.host.as_str(), address.port))).await;
    let Ok(Ok(found)) = found else { return Err(no_answer(address)) };
    let allowed: Vec<SocketAddr> = found.filter(|it| rules.allows(it.ip())).collect();
    if allowed.is_empty() {
        return Err(SourceRuleError::Network(address.host.clone()).to_string());
    }
    Ok(allowed)
}

/// Connects to one of the addresses, sends the request, and returns the head of the response.
async fn exchange(
    address: &HttpAddress,
    to: impl ToSocketAddrs,
) -> Result<Response<Incoming>, String> {
    let stream = match timeout(CONNECT_TIMEOUT, TcpStream::connect(to)).await {
        Ok(Ok(stream)) => stream,
        Ok(Err(error)) => return Err(unreachable(address, &error)),
        Err(_) => {
            return Err(format!(
                "{} does not answer within {} s: is the camera on, and in this network?",
                address.authority(),
                CONNECT_TIMEOUT.as_secs()
            ));
        }
    };
    // A failure only delays the request.
    let _ = stream.set_nodelay(true);
    let handshake = http1::Builder::new()
        .allow_spaces_after_header_name_in_responses(true)
        .allow_obsolete_multiline_headers_in_responses(true)
        .ignore_invalid_headers_in_responses(true)
        .handshake(TokioIo::new(stream))
        .await;
    let (mut sender, connection) = handshake.map_err(|error| describe(address, &error))?;
    // The response or its body reports the connection's errors too.
    tokio::spawn(connection);
    let request = http_request(address)?;
    let response = async {
        sender.ready().await?;
        sender.send_request(request).await
    };
    match timeout(RESPONSE_TIMEOUT, response).await {
        Ok(Ok(response)) => Ok(response),
        Ok(Err(error)) => Err(describe(address, &error)),
        Err(_) => Err(format!(
            "{address} accepted the connection but does not answer within {} s: many cameras serve one viewer at a \
             time; is another one watching?",
            RESPONSE_TIMEOUT.as_secs()
        )),
    }
}

/// The only error of a bound source before its camera has answered.
fn no_answer(address: &HttpAddress) -> String {
    format!(
        "no camera answers at {}: is it on, in this network, without another viewer, and is the port right? An ESP32-CAM \
         streams on port 81",
        address.authority()
    )
}

fn http_request(address: &HttpAddress) -> Result<Request<Empty<Bytes>>, String> {
    let mut request = Request::builder()
        .uri(&address.target)
        .header(header::HOST, address.authority())
        .header(header::ACCEPT, ACCEPT)
        .header(header::USER_AGENT, concat!("roundel/", env!("CARGO_PKG_VERSION")));
    if let Some((user, password)) = &address.credentials {
        let basic = format!("Basic {}", BASE64_STANDARD.encode(format!("{user}:{password}")));
        if let Ok(mut value) = HeaderValue::try_from(basic) {
            value.set_sensitive(true);
            request = request.header(header::AUTHORIZATION, value);
        }
    }
    request.body(Empty::new()).map_err(|error| format!("{address}: {error}"))
}

fn unreachable(address: &HttpAddress, error: &io::Error) -> String {
    let remedy = match error.kind() {
        io::ErrorKind::ConnectionRefused => {
            "nothing listens on that port; an ESP32-CAM streams on port 81"
        }
        io::ErrorKind::HostUnreachable | io::ErrorKind::NetworkUnreachable => {
            "is the camera on, and in this network?"
        }
        _ => "check host and port",
    };
    format!("cannot reach {}: {error}; {remedy}", address.authority())
}

/// A hyper error with the name of the camera.
pub(super) fn describe(address: &HttpAddress, error: &hyper::Error) -> String {
    if error.is_parse() {
        format!("{} does not speak HTTP: {error}; check the port", address.authority())
    } else if error.is_incomplete_message() || error.is_closed() || error.is_canceled() {
        format!("{} closed the connection", address.authority())
    } else {
        let cause = std::error::Error::source(error).map(|cause| format!(": {cause}"));
        format!("{}: {error}{}", address.authority(), cause.unwrap_or_default())
    }
}

fn classify_response(
    address: &HttpAddress,
    response: Response<Incoming>,
) -> Result<ResponseKind, String> {
    let status = response.status();
    if !status.is_success() {
        return Err(refusal(address, status, response.headers()));
    }
    let kind = text(response.headers(), header::CONTENT_TYPE);
    let main = kind.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    match main.as_str() {
        "image/jpeg" | "image/jpg" => Ok(ResponseKind::Snapshot(response.into_body())),
        // Some cameras send no type, or a generic one.
        "multipart/x-mixed-replace"
        | "multipart/mixed"
        | "application/octet-stream"
        | "video/x-motion-jpeg"
        | "" => Ok(ResponseKind::Stream(response.into_body())),
        _ => Err(format!(
            "{address}: expected multipart/x-mixed-replace or image/jpeg, found {main}: {}",
            remedy_for(&main)
        )),
    }
}

fn remedy_for(kind: &str) -> &'static str {
    if kind == "text/html" {
        "this is a web page; find the address of the stream in the camera's manual (ESP32-CAM: \
         http://HOST:81/stream)"
    } else if kind.starts_with("image/") {
        "set the camera to JPEG"
    } else if kind.starts_with("video/") {
        "set the camera to MJPEG"
    } else {
        "find the address of the MJPEG stream in the camera's manual"
    }
}

fn refusal(address: &HttpAddress, status: StatusCode, headers: &HeaderMap) -> String {
    if status.is_redirection() {
        let to = text(headers, header::LOCATION);
        return format!(
            "{address} redirects to `{to}` ({status}): redirects are not followed, so that no other host gets the \
             password; use that address as the source"
        );
    }
    let why = match status {
        StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN => {
            let scheme = text(headers, header::WWW_AUTHENTICATE);
            let is_digest = scheme.to_ascii_lowercase().starts_with("digest");
            match (&address.credentials, is_digest) {
                (_, true) => {
                    "it requires Digest authentication, which is not supported: set the camera to Basic, or use its \
                     RTSP stream"
                }
                (None, false) => {
                    "it requires a user and a password, as in http://USER:PASSWORD@HOST/…, with %40 for an @ in them"
                }
                (Some(_), false) => "user or password is wrong",
            }
        }
        StatusCode::NOT_FOUND => {
            "it has no such path; find the address of the stream in the camera's manual (ESP32-CAM: \
             http://HOST:81/stream)"
        }
        StatusCode::SERVICE_UNAVAILABLE | StatusCode::TOO_MANY_REQUESTS => {
            "it is busy: many cameras serve one viewer at a time; is another one watching?"
        }
        _ if status.is_server_error() => "the camera has an internal error; switch it off and on",
        _ => "expected 200",
    };
    format!("{address} answers {status}: {why}")
}

/// A header as text, shortened for messages.
fn text(headers: &HeaderMap, name: HeaderName) -> String {
    let value = headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or_default();
    value.chars().take(200).collect()
}
