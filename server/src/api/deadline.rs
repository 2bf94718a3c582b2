//! Deadlines of gRPC calls: what a client gives up on is not gone on with.
//!
//! A client says in `grpc-timeout` how long it waits. When that time is over, a call that has no answer yet is dropped
//! and answered with DEADLINE_EXCEEDED, and a stream ends with it, between two messages.

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
/// gRPC's header of a message: whether it is compressed, and its length, big-endian.
const MESSAGE_HEADER_BYTES: usize = 5;
/// Who waits longer waits for ever.
const LONGEST: Duration = Duration::from_secs(365 * 86_400);

/// Answers a call by its deadline, if it has one.
pub(super) async fn answer(
    headers: &HeaderMap,
    call: impl Future<Output = Result<Response<Body>, Infallible>>,
) -> Result<Response<Body>, Infallible> {
    let after = match of(headers) {
        Ok(Some(after)) if after < LONGEST => after,
        Ok(_) => return call.await,
        Err(error) => return Ok(Status::from(error).into_http()),
    };
    let at = Instant::now() + after;
    match timeout_at(at, call).await {
        Ok(Ok(response)) => Ok(response.map(|body| Body::new(Until::new(body, at, after)))),
        Ok(Err(never)) => match never {},
        Err(_) => Ok(passed(after).into_http()),
    }
}

/// Whether a call has one.
pub(super) fn is_set(headers: &HeaderMap) -> bool {
    headers.contains_key(HEADER)
}

fn passed(after: Duration) -> Status {
    Status::deadline_exceeded(format!("the call's deadline of {after:?} has passed"))
}

/// How long the client waits; `None`: it does not say.
fn of(headers: &HeaderMap) -> Result<Option<Duration>, ApiError> {
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

/// Where in a stream of messages its bytes are.
#[derive(Debug, Default)]
struct Position {
    header: Vec<u8>,
    /// Bytes of the present message that are to come.
    rest: usize,
}

impl Position {
    fn is_between_messages(&self) -> bool {
        self.rest == 0 && self.header.is_empty()
    }

    fn go_on(&mut self, mut bytes: &[u8]) {
        while !bytes.is_empty() {
            if self.rest > 0 {
                let taken = self.rest.min(bytes.len());
                self.rest -= taken;
                bytes = &bytes[taken..];
                continue;
            }
            let taken = (MESSAGE_HEADER_BYTES - self.header.len()).min(bytes.len());
            self.header.extend_from_slice(&bytes[..taken]);
            bytes = &bytes[taken..];
            if let &[_, a, b, c, d] = &self.header[..] {
                self.rest = u32::from_be_bytes([a, b, c, d]) as usize;
                self.header.clear();
            }
        }
    }
}

/// A body that ends at an instant.
struct Until {
    /// `None`: it has ended.
    body: Option<Body>,
    position: Position,
    at: Pin<Box<Sleep>>,
    after: Duration,
}

impl Until {
    fn new(body: Body, at: Instant, after: Duration) -> Self {
        let position = Position::default();
        Self { body: Some(body), position, at: Box::pin(sleep_until(at)), after }
    }
}

impl hyper::body::Body for Until {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let this = &mut *self;
        let Some(body) = &mut this.body else { return Poll::Ready(None) };
        let is_over = this.at.as_mut().poll(context).is_ready();
        if is_over && this.position.is_between_messages() && !body.is_end_stream() {
            this.body = None;
            let mut trailers = HeaderMap::new();
            // What cannot be a header is left out of the message by tonic, and the code stays.
            let _ = passed(this.after).add_header(&mut trailers);
            return Poll::Ready(Some(Ok(Frame::trailers(trailers))));
        }
        let frame = Pin::new(body).poll_frame(context);
        if let Poll::Ready(Some(Ok(frame))) = &frame {
            match frame.data_ref() {
                Some(bytes) => this.position.go_on(bytes),
                // Nothing comes after trailers.
                None => this.body = None,
            }
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
        of(&headers)
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
        assert_eq!(of(&HeaderMap::new()), Ok(None));
        let good =
            [("2H", 7200.0), ("3M", 180.0), ("4S", 4.0), ("5m", 5e-3), ("6u", 6e-6), ("7n", 7e-9)];
        for (text, seconds) in good {
            assert_eq!(said(text), Ok(Some(Duration::from_secs_f64(seconds))), "{text}");
        }
        assert!(said("99999999H").unwrap().unwrap() > LONGEST);
        for text in ["", "5", "m", "-5m", "+5m", "5.0m", "999999999n", "5 m", "5ms", "5x"] {
            let error = said(text).unwrap_err().to_string();
            assert!(
                error.starts_with("grpc-timeout: expected up to eight digits"),
                "{text}: {error}"
            );
        }
    }

    #[test]
    fn messages_are_told_apart_however_they_are_cut() {
        let messages =
            [&[0, 0, 0, 0, 3, 1, 2, 3][..], &[0, 0, 0, 0, 0], &[0, 0, 0, 0, 1, 9]].concat();
        let borders = [0, 8, 13, 19];
        for piece in 1..=messages.len() {
            let (mut position, mut at) = (Position::default(), 0);
            for bytes in messages.chunks(piece) {
                position.go_on(bytes);
                at += bytes.len();
                assert_eq!(
                    position.is_between_messages(),
                    borders.contains(&at),
                    "{at} by {piece}"
                );
            }
        }
    }
}
