//! Detects clients that stopped reading a response.
//!
//! A client that reads nothing at all makes socket writes time out. An HTTP/2 client may also keep reading the socket
//! while one of its streams has no flow-control window, because its program takes nothing from that stream. hyper then
//! stops asking for the body's next frame, so each body records how long ago it handed out its last one. HTTP/2 does not
//! let a server abandon a single stream that it cannot write to, so the whole connection is closed.

use std::{
    pin::Pin,
    sync::{
        Arc, Mutex, PoisonError, Weak,
        atomic::{AtomicU64, Ordering},
    },
    task::{Context, Poll},
    time::{Duration, Instant},
};

use axum::body::{Body, Bytes};
use hyper::body::{Body as _, Frame, SizeHint};
use tokio::time::sleep;

use super::slots::Answering;

/// Longer frames are handed out in pieces, since hyper buffers whole frames.
const PIECE_BYTES: usize = 64 * 1024;
const CHECKS_PER_LIMIT: u32 = 4;

pub(super) struct ResponseWatch {
    begin: Instant,
    /// For each open body: when it handed out its last frame, ns since `begin`; 0 if it was asked for the next one since.
    handed_out_ns: Mutex<Vec<Weak<AtomicU64>>>,
}

impl Default for ResponseWatch {
    fn default() -> Self {
        Self { begin: Instant::now(), handed_out_ns: Mutex::default() }
    }
}

impl ResponseWatch {
    pub(super) fn watched(&self, body: Body) -> WatchedBody {
        let (rest, handed_out_ns, _answering) = (None, None, None);
        let watched = WatchedBody { body, rest, begin: self.begin, handed_out_ns, _answering };
        if watched.body.is_end_stream() {
            return watched;
        }
        let handed_out_ns = Arc::new(AtomicU64::new(0));
        let mut all = self.handed_out_ns.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|other| other.strong_count() > 0);
        all.push(Arc::downgrade(&handed_out_ns));
        drop(all);
        WatchedBody { handed_out_ns: Some(handed_out_ns), ..watched }
    }

    /// The longest time that a body has not been asked for its next frame.
    fn stalled_for(&self) -> Duration {
        let all = self.handed_out_ns.lock().unwrap_or_else(PoisonError::into_inner);
        let since = all.iter().filter_map(|it| Some(it.upgrade()?.load(Ordering::Relaxed)));
        let oldest = since.filter(|&ns| ns != 0).min().map(Duration::from_nanos);
        oldest.map_or(Duration::ZERO, |oldest| self.begin.elapsed().saturating_sub(oldest))
    }

    /// Completes when a response has stalled for longer than `limit`.
    pub(super) async fn stalled(&self, limit: Duration) {
        while self.stalled_for() <= limit {
            sleep(limit / CHECKS_PER_LIMIT).await;
        }
    }
}

/// A response body that records when it was asked for its next frame.
pub(super) struct WatchedBody {
    body: Body,
    /// The rest of a frame that is handed out in pieces.
    rest: Option<Bytes>,
    begin: Instant,
    /// `None` for an empty body, which never stalls.
    handed_out_ns: Option<Arc<AtomicU64>>,
    /// Ends with the body.
    _answering: Option<Answering>,
}

impl WatchedBody {
    /// Keeps the connection from being idle while this body is sent.
    pub(super) fn answering(self, answering: Answering) -> Self {
        Self { _answering: Some(answering), ..self }
    }

    fn record(&self, ns: u64) {
        if let Some(handed_out_ns) = &self.handed_out_ns {
            handed_out_ns.store(ns, Ordering::Relaxed);
        }
    }

    fn hand_out(&mut self, mut bytes: Bytes) -> Frame<Bytes> {
        if bytes.len() > PIECE_BYTES {
            self.rest = Some(bytes.split_off(PIECE_BYTES));
        }
        self.record((self.begin.elapsed().as_nanos() as u64).max(1));
        Frame::data(bytes)
    }
}

impl hyper::body::Body for WatchedBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        if let Some(rest) = self.rest.take() {
            return Poll::Ready(Some(Ok(self.hand_out(rest))));
        }
        self.record(0);
        Pin::new(&mut self.body).poll_frame(context).map_ok(|frame| match frame.into_data() {
            Ok(bytes) => self.hand_out(bytes),
            Err(trailers) => trailers,
        })
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_none() && self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        let (mut hint, rest) = (self.body.size_hint(), self.rest.as_ref().map_or(0, Bytes::len));
        // The lower bound must never exceed the upper one.
        if let Some(upper) = hint.upper() {
            hint.set_upper(upper + rest as u64);
        }
        hint.set_lower(hint.lower() + rest as u64);
        hint
    }
}

#[cfg(test)]
mod tests {
    use std::{future::Future, pin::pin, task::Waker};

    use axum::http::{HeaderMap, HeaderValue, header};
    use futures::{StreamExt, stream};
    use http_body_util::{BodyExt, StreamBody};

    use super::*;

    fn data(frame: Option<Result<Frame<Bytes>, axum::Error>>) -> Bytes {
        frame.unwrap().unwrap().into_data().ok().unwrap()
    }

    #[tokio::test]
    async fn a_long_response_is_sent_in_pieces_and_states_its_length() {
        let bytes: Vec<u8> = (0..200_000_u32).map(|index| (index % 251) as u8).collect();
        let mut body = ResponseWatch::default().watched(Body::from(bytes.clone()));
        let mut received: Vec<u8> = Vec::new();
        while !body.is_end_stream() {
            assert_eq!(body.size_hint().exact(), Some((bytes.len() - received.len()) as u64));
            let piece = data(body.frame().await);
            assert!(piece.len() <= PIECE_BYTES);
            received.extend(&piece);
        }
        assert!(received == bytes);
        assert!(body.frame().await.is_none());
    }

    #[tokio::test]
    async fn trailers_are_passed_on() {
        let trailers = HeaderMap::from_iter([(header::ETAG, HeaderValue::from_static("7"))]);
        let frames = [Frame::data(Bytes::from("own")), Frame::trailers(trailers.clone())];
        let frames = stream::iter(frames.into_iter().map(Ok::<_, axum::Error>));
        let mut body = ResponseWatch::default().watched(Body::new(StreamBody::new(frames)));
        assert_eq!(data(body.frame().await), "own");
        let frame = body.frame().await.unwrap().unwrap();
        assert_eq!(frame.into_trailers().ok(), Some(trailers));
        assert!(body.frame().await.is_none());
    }

    #[tokio::test]
    async fn only_a_body_that_is_not_asked_for_more_stalls() {
        let watch = ResponseWatch::default();
        let frames = stream::iter([Ok::<_, axum::Error>(Bytes::from("one"))]);
        let mut body = watch.watched(Body::from_stream(frames.chain(stream::pending())));
        assert_eq!(watch.stalled_for(), Duration::ZERO, "not asked at all yet");
        body.frame().await.unwrap().unwrap();
        std::thread::sleep(Duration::from_millis(2));
        assert!(watch.stalled_for() >= Duration::from_millis(2));
        let mut context = Context::from_waker(Waker::noop());
        assert!(pin!(body.frame()).poll(&mut context).is_pending());
        assert_eq!(watch.stalled_for(), Duration::ZERO, "it waits for its source");
        let mut whole = watch.watched(Body::from("all"));
        whole.frame().await.unwrap().unwrap();
        std::thread::sleep(Duration::from_millis(2));
        assert!(watch.stalled_for() > Duration::ZERO);
        drop(whole);
        assert_eq!(watch.stalled_for(), Duration::ZERO, "dropped bodies do not count");
    }
}
