//! Deadlines of gRPC calls, from the header `grpc-timeout`.
//!
//! When the deadline passes, a call without a response is dropped and answered with DEADLINE_EXCEEDED. A response stream
//! ends with that status between two frames of its body, each of which holds whole messages.

use std::{convert::Infallible, time::Duration};

use axum::{
    body::{Body, HttpBody as _},
    http::{HeaderMap, Response},
};
use futures::{StreamExt as _, stream};
use http_body_util::{BodyStream, StreamBody};
use hyper::body::Frame;
use tokio::time::{Instant, sleep_until, timeout_at};
use tonic::Status;

use super::error::ApiError;

const HEADER: &str = "grpc-timeout";
const MAX_TIMEOUT: Duration = Duration::from_secs(365 * 86_400);

/// Applies a call's deadline, if it has one.
pub(super) async fn answer(
    headers: &HeaderMap,
    call: impl Future<Output = Result<Response<Body>, Infallible>>,
) -> Result<Response<Body>, Infallible> {
    let after = match parse_timeout(headers) {
        Ok(Some(after)) if after < MAX_TIMEOUT => after,
        Ok(_) => return call.await,
        Err(error) => return Ok(Status::from(error).into_http()),
    };
    let at = Instant::now() + after;
    match timeout_at(at, call).await {
        Ok(Ok(response)) => Ok(response.map(|body| limited(body, at, deadline_exceeded(after)))),
        Ok(Err(never)) => match never {},
        Err(_) => Ok(deadline_exceeded(after).into_http()),
    }
}

fn deadline_exceeded(after: Duration) -> Status {
    Status::deadline_exceeded(format!("the call's deadline of {after:?} has passed"))
}

/// Parses the header; `None` if it is absent.
fn parse_timeout(headers: &HeaderMap) -> Result<Option<Duration>, ApiError> {
    let Some(value) = headers.get(HEADER) else { return Ok(None) };
    let wrong = || {
        let expected = "up to eight digits and one of H, M, S, m, u, n, such as 500m";
        ApiError::invalid(HEADER, expected, format!("{value:?}"))
    };
    let text = value.to_str().map_err(|_| wrong())?;
    let (digits, unit) = text.split_at_checked(text.len().saturating_sub(1)).ok_or_else(wrong)?;
    let is_number = (1..=8).contains(&digits.len()) && digits.bytes().all(|it| it.is_ascii_digit());
    let number: u64 = digits.parse().ok().filter(|_| is_number).ok_or_else(wrong)?;
    Ok(Some(match unit {
        "H" => Duration::from_secs(number * 3600),
        "M" => Duration::from_secs(number * 60),
        "S" => Duration::from_secs(number),
        "m" => Duration::from_millis(number),
        "u" => Duration::from_micros(number),
        "n" => Duration::from_nanos(number),
        _ => return Err(wrong()),
    }))
}

/// Ends a body at an instant with the trailers of a status.
pub(super) fn limited(body: Body, at: Instant, end: Status) -> Body {
    if body.is_end_stream() {
        return body;
    }
    let mut trailers = HeaderMap::new();
    // A message that is not a valid header is omitted; the code remains.
    let _ = end.add_header(&mut trailers);
    let state = (BodyStream::new(body), trailers);
    let frames = stream::unfold(Some(state), move |state| async move {
        let (mut frames, trailers) = state?;
        let frame = tokio::select! {
            biased;
            () = sleep_until(at) => Ok(Frame::trailers(trailers.clone())),
            frame = frames.next() => frame?,
        };
        let is_last = frame.as_ref().is_ok_and(Frame::is_trailers);
        Some((frame, (!is_last).then_some((frames, trailers))))
    });
    Body::new(StreamBody::new(frames))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &'static str) -> Result<Option<Duration>, ApiError> {
        let mut headers = HeaderMap::new();
        headers.insert(HEADER, text.parse().unwrap());
        parse_timeout(&headers)
    }

    #[tokio::test]
    async fn a_call_without_a_response_is_dropped() {
        let mut headers = HeaderMap::new();
        headers.insert(HEADER, "1m".parse().unwrap());
        let answer = answer(&headers, std::future::pending()).await.unwrap();
        assert_eq!(answer.headers()["grpc-status"], "4");
        assert_eq!(
            answer.headers()["grpc-message"],
            "the%20call's%20deadline%20of%201ms%20has%20passed"
        );
    }

    #[test]
    fn only_valid_timeouts_are_accepted() {
        assert_eq!(parse_timeout(&HeaderMap::new()), Ok(None));
        let good =
            [("2H", 7200.0), ("3M", 180.0), ("4S", 4.0), ("5m", 5e-3), ("6u", 6e-6), ("7n", 7e-9)];
        for (text, seconds) in good {
            assert_eq!(parsed(text), Ok(Some(Duration::from_secs_f64(seconds))), "{text}");
        }
        assert!(parsed("99999999H").unwrap().unwrap() > MAX_TIMEOUT);
        for text in ["", "5", "m", "-5m", "+5m", "5.0m", "999999999n", "5 m", "5ms", "5x"] {
            let error = parsed(text).unwrap_err().to_string();
            assert!(
                error.starts_with("grpc-timeout: expected up to eight digits"),
                "{text}: {error}"
            );
        }
    }
}
