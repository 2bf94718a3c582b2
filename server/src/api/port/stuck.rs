//! Clients that take nothing of what there is for them. Each is cut off after
//! [`Limits::send_timeout`](crate::api::Limits), with its connection, so that what waits for them stays bounded.
//!
//! There are two ways to be stuck. A client may read nothing at all: then the socket has no room, which [`Gather`] knows.
//! Or it reads, and has no room for one of HTTP/2's streams, since its program does not take what came on that. Then
//! HTTP/2 does not ask that answer's body for its next piece, so each body is watched for how long ago it gave one. Long
//! answers are given in pieces: what is handed over whole waits where nobody can see it. HTTP/2 lets no server give up one
//! stream that it cannot write to, therefore the connection ends.

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
use tokio::{
    io::{AsyncRead, AsyncWrite},
    time::sleep,
};

use super::gather::Gather;

/// Most that is handed over at once.
const PIECE_BYTES: usize = 64 * 1024;
/// How often a connection is looked at, against the time after which it is cut off.
const LOOKS: u32 = 4;

/// The answers of one connection.
pub(super) struct Answers {
    begin: Instant,
    /// Of each body that is there: when it handed over the piece that is not yet followed by the wish for more, ns since
    /// `begin`; 0: there is none.
    handed_ns: Mutex<Vec<Weak<AtomicU64>>>,
}

impl Default for Answers {
    fn default() -> Self {
        Self { begin: Instant::now(), handed_ns: Mutex::default() }
    }
}

impl Answers {
    /// The same body, watched.
    pub(super) fn watched(&self, body: Body) -> Body {
        if body.is_end_stream() {
            return body;
        }
        let handed_ns = Arc::new(AtomicU64::new(0));
        let mut all = self.handed_ns.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|other| other.strong_count() > 0);
        all.push(Arc::downgrade(&handed_ns));
        drop(all);
        Body::new(Watched { body, rest: None, begin: self.begin, handed_ns })
    }

    /// For how long the one has waited that waits longest.
    fn waiting(&self) -> Duration {
        let all = self.handed_ns.lock().unwrap_or_else(PoisonError::into_inner);
        let since = all.iter().filter_map(|it| Some(it.upgrade()?.load(Ordering::Relaxed)));
        let oldest = since.filter(|&ns| ns != 0).min().map(Duration::from_nanos);
        oldest.map_or(Duration::ZERO, |oldest| self.begin.elapsed().saturating_sub(oldest))
    }
}

/// Waits until the client of a connection has been stuck for so long.
pub(super) async fn stuck<S: AsyncRead + AsyncWrite + Unpin>(
    answers: &Answers,
    socket: &Gather<S>,
    limit: Duration,
) {
    loop {
        sleep(limit / LOOKS).await;
        if answers.waiting().max(socket.full_for()) > limit {
            return;
        }
    }
}

/// A body that notes when it is asked.
struct Watched {
    body: Body,
    /// Of what the body gave.
    rest: Option<Bytes>,
    begin: Instant,
    handed_ns: Arc<AtomicU64>,
}

impl Watched {
    fn hand(&mut self, mut bytes: Bytes) -> Frame<Bytes> {
        if bytes.len() > PIECE_BYTES {
            self.rest = Some(bytes.split_off(PIECE_BYTES));
        }
        let now_ns = self.begin.elapsed().as_nanos() as u64;
        self.handed_ns.store(now_ns.max(1), Ordering::Relaxed);
        Frame::data(bytes)
    }
}

impl hyper::body::Body for Watched {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        if let Some(rest) = self.rest.take() {
            return Poll::Ready(Some(Ok(self.hand(rest))));
        }
        let polled = Pin::new(&mut self.body).poll_frame(context);
        self.handed_ns.store(0, Ordering::Relaxed);
        polled.map_ok(|frame| match frame.into_data() {
            Ok(bytes) => self.hand(bytes),
            Err(trailers) => trailers,
        })
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_none() && self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        let (mut hint, rest) = (self.body.size_hint(), self.rest.as_ref().map_or(0, Bytes::len));
        // The lower bound may at no time be above the upper one.
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

    use futures::stream;
    use http_body_util::BodyExt;

    use super::*;

    #[tokio::test]
    async fn a_long_answer_goes_in_pieces_and_says_how_long_it_is() {
        let bytes: Vec<u8> = (0..200_000_u32).map(|place| (place % 251) as u8).collect();
        let answers = Answers::default();
        let mut body = answers.watched(Body::from(bytes.clone()));
        let mut come: Vec<u8> = Vec::new();
        while !body.is_end_stream() {
            assert_eq!(body.size_hint().exact(), Some((bytes.len() - come.len()) as u64));
            let piece = body.frame().await.unwrap().unwrap().into_data().unwrap();
            assert!(piece.len() <= PIECE_BYTES);
            come.extend(&piece);
        }
        assert!(come == bytes);
        assert!(body.frame().await.is_none());
    }

    #[tokio::test]
    async fn who_is_not_asked_for_more_waits_and_who_has_no_more_does_not() {
        let answers = Answers::default();
        let endless = stream::iter([Ok::<_, axum::Error>(Bytes::from_static(b"one"))]);
        let endless = futures::StreamExt::chain(endless, stream::pending());
        let mut body = answers.watched(Body::from_stream(endless));
        assert_eq!(answers.waiting(), Duration::ZERO, "not asked at all yet");
        body.frame().await.unwrap().unwrap();
        std::thread::sleep(Duration::from_millis(2));
        assert!(answers.waiting() >= Duration::from_millis(2));
        // Asked again, it has nothing.
        let mut context = Context::from_waker(Waker::noop());
        assert!(pin!(body.frame()).poll(&mut context).is_pending());
        assert_eq!(answers.waiting(), Duration::ZERO);
        let mut whole = answers.watched(Body::from("all"));
        whole.frame().await.unwrap().unwrap();
        std::thread::sleep(Duration::from_millis(2));
        assert!(answers.waiting() > Duration::ZERO);
        drop(whole);
        assert_eq!(answers.waiting(), Duration::ZERO, "all of it is under way");
    }
}
