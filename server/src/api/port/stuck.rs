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
use bytes::{Buf as _, buf::Chain};
use hyper::body::{Body as _, Frame, SizeHint};
use tokio::time::sleep;

/// Most that is handed over at once.
const PIECE_BYTES: usize = 64 * 1024;
/// What is no longer than this goes with what follows it, if that is there.
const SHORT_BYTES: usize = 256;
/// How often a connection is looked at, against the time after which it is cut off.
const LOOKS: u32 = 4;

/// What is handed over at once: two pieces of memory, the second of which may be empty.
pub(super) type Piece = Chain<Bytes, Bytes>;

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
    pub(super) fn watched(&self, body: Body) -> Watched {
        let watched = Watched { body, rest: None, ahead: None, begin: self.begin, handed_ns: None };
        if watched.body.is_end_stream() {
            return watched;
        }
        let handed_ns = Arc::new(AtomicU64::new(0));
        let mut all = self.handed_ns.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|other| other.strong_count() > 0);
        all.push(Arc::downgrade(&handed_ns));
        drop(all);
        Watched { handed_ns: Some(handed_ns), ..watched }
    }

    /// For how long the one has waited that waits longest.
    pub(super) fn waiting(&self) -> Duration {
        let all = self.handed_ns.lock().unwrap_or_else(PoisonError::into_inner);
        let since = all.iter().filter_map(|it| Some(it.upgrade()?.load(Ordering::Relaxed)));
        let oldest = since.filter(|&ns| ns != 0).min().map(Duration::from_nanos);
        oldest.map_or(Duration::ZERO, |oldest| self.begin.elapsed().saturating_sub(oldest))
    }
}

/// Waits until a client has been stuck for so long, where `stuck_for` says how long it is by now.
pub(super) async fn stuck(stuck_for: impl Fn() -> Duration, limit: Duration) {
    loop {
        sleep(limit / LOOKS).await;
        if stuck_for() > limit {
            return;
        }
    }
}

/// A body that notes when it is asked.
pub(super) struct Watched {
    body: Body,
    /// Of what the body gave, what is to be handed over next.
    rest: Option<Bytes>,
    /// What the body has given beyond that already.
    ahead: Option<Option<Result<Frame<Bytes>, axum::Error>>>,
    begin: Instant,
    /// `None`: nothing but the end is to come, which nobody has to wait for.
    handed_ns: Option<Arc<AtomicU64>>,
}

impl Watched {
    fn poll_body(
        &mut self,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        match self.ahead.take() {
            Some(frame) => Poll::Ready(frame),
            None => Pin::new(&mut self.body).poll_frame(context),
        }
    }

    /// What comes right behind a short piece, such as the part of a snapshot that others get as well behind what is this
    /// client's own: in one piece they are fewer frames of HTTP/2.
    fn follower(&mut self, context: &mut Context<'_>) -> Bytes {
        let Poll::Ready(next) = self.poll_body(context) else { return Bytes::new() };
        match next.map(|result| result.map(Frame::into_data)) {
            Some(Ok(Ok(bytes))) => return bytes,
            Some(Ok(Err(trailers))) => self.ahead = Some(Some(Ok(trailers))),
            Some(Err(error)) => self.ahead = Some(Some(Err(error))),
            None => self.ahead = Some(None),
        }
        Bytes::new()
    }

    fn hand(&mut self, mut bytes: Bytes, context: &mut Context<'_>) -> Frame<Piece> {
        let is_short = bytes.len() <= SHORT_BYTES;
        let mut follower = if is_short { self.follower(context) } else { Bytes::new() };
        if bytes.len() > PIECE_BYTES {
            self.rest = Some(bytes.split_off(PIECE_BYTES));
        } else if bytes.len() + follower.len() > PIECE_BYTES {
            self.rest = Some(follower.split_off(PIECE_BYTES - bytes.len()));
        }
        if let Some(handed_ns) = &self.handed_ns {
            let now_ns = self.begin.elapsed().as_nanos() as u64;
            handed_ns.store(now_ns.max(1), Ordering::Relaxed);
        }
        Frame::data(bytes.chain(follower))
    }
}

impl hyper::body::Body for Watched {
    type Data = Piece;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Piece>, axum::Error>>> {
        if let Some(rest) = self.rest.take() {
            return Poll::Ready(Some(Ok(self.hand(rest, context))));
        }
        let polled = self.poll_body(context);
        if let Some(handed_ns) = &self.handed_ns {
            handed_ns.store(0, Ordering::Relaxed);
        }
        polled.map_ok(|frame| match frame.into_data() {
            Ok(bytes) => self.hand(bytes, context),
            Err(trailers) => trailers.map_data(|bytes| bytes.chain(Bytes::new())),
        })
    }

    fn is_end_stream(&self) -> bool {
        let is_body_at_end = match &self.ahead {
            None => self.body.is_end_stream(),
            Some(ahead) => ahead.is_none(),
        };
        self.rest.is_none() && is_body_at_end
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

    use axum::http::{HeaderMap, HeaderValue, header};
    use futures::{StreamExt, stream};
    use http_body_util::{BodyExt, StreamBody};

    use super::*;

    #[tokio::test]
    async fn a_long_answer_goes_in_pieces_and_says_how_long_it_is() {
        let bytes: Vec<u8> = (0..200_000_u32).map(|place| (place % 251) as u8).collect();
        let answers = Answers::default();
        let mut body = answers.watched(Body::from(bytes.clone()));
        let mut come: Vec<u8> = Vec::new();
        while !body.is_end_stream() {
            assert_eq!(body.size_hint().exact(), Some((bytes.len() - come.len()) as u64));
            let mut piece = data(body.frame().await);
            assert!(piece.remaining() <= PIECE_BYTES);
            come.extend(&piece.copy_to_bytes(piece.remaining()));
        }
        assert!(come == bytes);
        assert!(body.frame().await.is_none());
    }

    fn data(frame: Option<Result<Frame<Piece>, axum::Error>>) -> Piece {
        frame.unwrap().unwrap().into_data().ok().unwrap()
    }

    /// A body that gives these, and ends if there are trailers.
    fn body(pieces: &[&'static [u8]], trailers: Option<HeaderMap>) -> Body {
        let pieces = pieces.iter().map(|bytes| Frame::data(Bytes::from_static(bytes)));
        let frames: Vec<_> = pieces.chain(trailers.clone().map(Frame::trailers)).collect();
        let frames = stream::iter(frames.into_iter().map(Ok::<_, axum::Error>));
        let rest = match trailers {
            Some(_) => stream::empty().left_stream(),
            None => stream::pending().right_stream(),
        };
        Body::new(StreamBody::new(frames.chain(rest)))
    }

    #[tokio::test]
    async fn a_short_piece_goes_with_what_follows_it_and_a_long_one_alone() {
        const LONG: [u8; SHORT_BYTES + 1] = [7; SHORT_BYTES + 1];
        let answers = Answers::default();
        let mut body = answers.watched(body(&[b"own", &LONG, &LONG, b"end"], None));
        let mut come = Vec::new();
        for _ in 0..3 {
            let piece = data(body.frame().await);
            come.push([piece.first_ref().len(), piece.last_ref().len()]);
        }
        assert_eq!(come, [[3, LONG.len()], [LONG.len(), 0], [3, 0]], "it does not wait for more");
    }

    #[tokio::test]
    async fn a_message_of_two_pieces_that_are_too_long_together_is_cut_where_it_is_full() {
        static LONG: [u8; PIECE_BYTES] = [7; PIECE_BYTES];
        let mut body = Answers::default().watched(body(&[b"own", &LONG], None));
        let lengths = [data(body.frame().await), data(body.frame().await)];
        assert_eq!(lengths.map(|piece| piece.remaining()), [PIECE_BYTES, 3]);
    }

    #[tokio::test]
    async fn trailers_behind_a_short_piece_are_not_lost() {
        let trailers = HeaderMap::from_iter([(header::ETAG, HeaderValue::from_static("7"))]);
        let mut body = Answers::default().watched(body(&[b"own"], Some(trailers.clone())));
        assert_eq!(data(body.frame().await).remaining(), 3);
        assert!(!body.is_end_stream());
        let frame = body.frame().await.unwrap().unwrap();
        assert_eq!(frame.into_trailers().ok(), Some(trailers));
        assert!(body.frame().await.is_none());
        let mut ended = Answers::default().watched(Body::from("all"));
        assert_eq!(data(ended.frame().await).remaining(), 3);
        assert!(
            ended.is_end_stream(),
            "that there is no more was found by looking for what follows"
        );
    }

    #[tokio::test]
    async fn who_is_not_asked_for_more_waits_and_who_has_no_more_does_not() {
        let answers = Answers::default();
        let mut body = answers.watched(body(&[b"one"], None));
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
