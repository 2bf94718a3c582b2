//! Deadlines of gRPC calls, from the header `grpc-timeout`.
//!
//! When the deadline passes, a call without a response is dropped and answered with DEADLINE_EXCEEDED. A response stream
//! ends with it, between two frames of its body; tonic puts whole messages into each.

use std::{
    convert::Infallible,
    future::Future,
    pin::Pin,
    task::{Context, Poll},
    time::Duration,
};

use axum::{
    body::{Body, Bytes},
    http::{HeaderMap, Response},
};
use hyper::body::{Frame, SizeHint};
use tokio::time::{Instant, Sleep, sleep_until, timeout_at};
use tonic::Status;

use super::error::ApiError;

const HEADER: &str = "grpc-timeout";
const MAX_TIMEOUT: Duration = Duration::from_secs(365 * 86_400);

/// Answers a call within its deadline, if it has one.
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
        Ok(Ok(response)) => Ok(response.map(|body| Body::new(DeadlineBody::new(body, at, after)))),
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

/// A body that ends at an instant.
struct DeadlineBody {
    /// `None`: it has ended.
    body: Option<Body>,
    at: Pin<Box<Sleep>>,
    after: Duration,
}

impl DeadlineBody {
    fn new(body: Body, at: Instant, after: Duration) -> Self {
        Self { body: Some(body), at: Box::pin(sleep_until(at)), after }
    }
}

impl hyper::body::Body for DeadlineBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let this = &mut *self;
        let Some(body) = &mut this.body else { return Poll::Ready(None) };
        let is_over = this.at.as_mut().poll(context).is_ready();
        if is_over && !body.is_end_stream() {
            this.body = None;
            let mut trailers = HeaderMap::new();
            // What cannot be a header is left out of the message by tonic, and the code stays.
            let _ = deadline_exceeded(this.after).add_header(&mut trailers);
            return Poll::Ready(Some(Ok(Frame::trailers(trailers))));
        }
        let frame = Pin::new(body).poll_frame(context);
        if let Poll::Ready(Some(Ok(frame))) = &frame
            && frame.is_trailers()
        {
            this.body = None;
        }
        frame
    }

    fn is_end_stream(&self) -> bool {
        self.body.as_ref().is_none_or(|body| body.is_end_stream())
    }

    fn size_hint(&self) -> SizeHint {
        // It may end before the rest has come.
        SizeHint::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(text: &'static str) -> Result<Option<Duration>, ApiError> {
        let mut headers = HeaderMap::new();
        headers.insert(HEADER, text.parse().unwrap());
        parse_timeout(&headers)
    }

    #[tokio::test]
    async fn a_call_without_an_answer_is_given_up() {
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
    fn every_unit_is_read_and_nothing_else() {
        assert_eq!(parse_timeout(&HeaderMap::new()), Ok(None));
        let good =
            [("2H", 7200.0), ("3M", 180.0), ("4S", 4.0), ("5m", 5e-3), ("6u", 6e-6), ("7n", 7e-9)];
        for (text, seconds) in good {
            assert_eq!(said(text), Ok(Some(Duration::from_secs_f64(seconds))), "{text}");
        }
        assert!(said("99999999H").unwrap().unwrap() > MAX_TIMEOUT);
        for text in ["", "5", "m", "-5m", "+5m", "5.0m", "999999999n", "5 m", "5ms", "5x"] {
            let error = said(text).unwrap_err().to_string();
            assert!(
                error.starts_with("grpc-timeout: expected up to eight digits"),
                "{text}: {error}"
            );
        }
    }
}
