//! One write to the socket for all that a connection has to say at a time.
//!
//! HTTP/2 cuts a message into frames of 16 kB, and hyper's hands each to the socket by itself: a snapshot of 100 objects
//! is two of them, or three with covariances. Most of what a subscriber costs is the system's part of a write, so here
//! what is written while the connection is polled is gathered, and goes out when that poll ends.

use std::{
    cell::Cell,
    future::Future,
    io,
    pin::Pin,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    task::{Context, Poll, ready},
    time::{Duration, Instant},
};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

/// What is more than this goes out at once.
const MOST_BYTES: usize = 64 * 1024;

thread_local! {
    /// What the last connection gathered in: as a rule it is empty before the next one is polled, and still in the
    /// processor's cache.
    static SPARE: Cell<Vec<u8>> = const { Cell::new(Vec::new()) };
}

/// A handle on a socket that gathers; all of them are of the same one.
pub(super) struct Gather<S>(Arc<Mutex<Inner<S>>>);

struct Inner<S> {
    stream: S,
    /// Taken from whoever writes, and not yet by the socket.
    held: Vec<u8>,
    /// Bytes of it that the socket has taken.
    sent: usize,
    /// Whether the connection is being polled.
    is_gathering: bool,
    /// Since when the socket has had no room; until it has, nothing is held for it that would grow old.
    full_since: Option<Instant>,
}

impl<S> Clone for Gather<S> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<S: AsyncRead + AsyncWrite + Unpin> Gather<S> {
    pub(super) fn new(stream: S) -> Self {
        let inner =
            Inner { stream, held: Vec::new(), sent: 0, is_gathering: false, full_since: None };
        Self(Arc::new(Mutex::new(inner)))
    }

    /// For how long the socket has taken nothing of what there is for it.
    pub(super) fn full_for(&self) -> Duration {
        self.inner().full_since.map_or(Duration::ZERO, |since| since.elapsed())
    }

    /// Polls the connection that has another handle, and lets out what it wrote.
    pub(super) fn poll_through<F: Future>(
        &self,
        connection: Pin<&mut F>,
        context: &mut Context<'_>,
    ) -> Poll<F::Output> {
        self.inner().is_gathering = true;
        let polled = connection.poll(context);
        let mut inner = self.inner();
        inner.is_gathering = false;
        // What does not go out now does when the socket wakes this task, or with the next write, which also learns of
        // an error.
        let _ = inner.poll_drain(context);
        polled
    }

    fn inner(&self) -> MutexGuard<'_, Inner<S>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<S: AsyncWrite + Unpin> Inner<S> {
    fn hold(&mut self, parts: &[io::IoSlice<'_>]) {
        if self.held.capacity() == 0 {
            self.held = SPARE.take();
            self.held.reserve(MOST_BYTES);
        }
        parts.iter().for_each(|part| self.held.extend_from_slice(part));
    }

    fn note(&mut self, is_full: bool) {
        self.full_since = is_full.then(|| self.full_since.unwrap_or_else(Instant::now));
    }

    fn poll_drain(&mut self, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        while self.sent < self.held.len() {
            let written = Pin::new(&mut self.stream).poll_write(context, &self.held[self.sent..]);
            self.note(written.is_pending());
            match ready!(written)? {
                0 => return Poll::Ready(Err(io::ErrorKind::WriteZero.into())),
                count => self.sent += count,
            }
        }
        if self.held.capacity() > 0 {
            self.sent = 0;
            let mut held = std::mem::take(&mut self.held);
            held.clear();
            SPARE.set(held);
        }
        Poll::Ready(Ok(()))
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Gather<S> {
    fn poll_read(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let mut inner = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        Pin::new(&mut inner.stream).poll_read(context, buffer)
    }
}

impl<S: AsyncRead + AsyncWrite + Unpin> AsyncWrite for Gather<S> {
    fn poll_write(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        self.poll_write_vectored(context, &[io::IoSlice::new(bytes)])
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        parts: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let mut inner = self.inner();
        let length = parts.iter().map(|part| part.len()).sum::<usize>();
        let is_room = inner.held.len() + length <= MOST_BYTES;
        if inner.is_gathering && is_room && inner.full_since.is_none() {
            inner.hold(parts);
            return Poll::Ready(Ok(length));
        }
        ready!(inner.poll_drain(context))?;
        let written = Pin::new(&mut inner.stream).poll_write_vectored(context, parts);
        inner.note(written.is_pending());
        written
    }

    fn is_write_vectored(&self) -> bool {
        true
    }

    fn poll_flush(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let mut inner = self.inner();
        if inner.is_gathering && inner.full_since.is_none() {
            return Poll::Ready(Ok(()));
        }
        ready!(inner.poll_drain(context))?;
        Pin::new(&mut inner.stream).poll_flush(context)
    }

    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let mut inner = self.inner();
        ready!(inner.poll_drain(context))?;
        Pin::new(&mut inner.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use std::{future::poll_fn, io::IoSlice, pin::pin, task::Waker};

    use tokio::io::{AsyncReadExt, AsyncWriteExt, duplex};

    use super::*;

    /// Takes some bytes at most, and notes how many each write brought.
    #[derive(Default)]
    struct Socket {
        room: usize,
        writes: Vec<usize>,
    }

    impl AsyncRead for Socket {
        fn poll_read(
            self: Pin<&mut Self>,
            _: &mut Context<'_>,
            _: &mut ReadBuf<'_>,
        ) -> Poll<io::Result<()>> {
            Poll::Pending
        }
    }

    impl AsyncWrite for Socket {
        fn poll_write(
            self: Pin<&mut Self>,
            context: &mut Context<'_>,
            bytes: &[u8],
        ) -> Poll<io::Result<usize>> {
            self.poll_write_vectored(context, &[IoSlice::new(bytes)])
        }

        fn poll_write_vectored(
            mut self: Pin<&mut Self>,
            _: &mut Context<'_>,
            parts: &[IoSlice<'_>],
        ) -> Poll<io::Result<usize>> {
            let taken = parts.iter().map(|part| part.len()).sum::<usize>().min(self.room);
            if taken == 0 {
                return Poll::Pending;
            }
            self.room -= taken;
            self.writes.push(taken);
            Poll::Ready(Ok(taken))
        }

        fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
            Poll::Ready(Ok(()))
        }

        fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
            Poll::Ready(Ok(()))
        }
    }

    fn socket(room: usize) -> Gather<Socket> {
        Gather::new(Socket { room, ..Socket::default() })
    }

    /// Writes as hyper's HTTP/2 does, in one poll: each frame is written and flushed. How many were taken.
    fn write_frames(gather: &Gather<Socket>, frames: &[&[u8]]) -> usize {
        let mut context = Context::from_waker(Waker::noop());
        let mut handle = gather.clone();
        let connection = pin!(poll_fn(|context| {
            let taken = frames.iter().take_while(|frame| {
                let parts = [IoSlice::new(&frame[..1]), IoSlice::new(&frame[1..])];
                let written = Pin::new(&mut handle).poll_write_vectored(context, &parts);
                written.is_ready() && Pin::new(&mut handle).poll_flush(context).is_ready()
            });
            Poll::Ready(taken.count())
        }));
        match gather.poll_through(connection, &mut context) {
            Poll::Ready(taken) => taken,
            Poll::Pending => unreachable!("it is ready"),
        }
    }

    #[test]
    fn what_one_poll_writes_is_one_write() {
        let gather = socket(usize::MAX);
        assert_eq!(write_frames(&gather, &[&[1; 10], &[2; 16_384], &[3; 400]]), 3);
        assert_eq!(write_frames(&gather, &[&[4; 7]]), 1);
        assert_eq!(gather.inner().stream.writes, [16_794, 7]);
    }

    #[test]
    fn more_than_is_held_goes_out_at_once() {
        let gather = socket(usize::MAX);
        let frame = [1; 16_384];
        assert_eq!(write_frames(&gather, &[frame.as_slice(); 9]), 9);
        let inner = gather.inner();
        assert_eq!(inner.stream.writes.iter().sum::<usize>(), 9 * frame.len());
        assert!(inner.stream.writes.len() <= 4, "{:?}", inner.stream.writes);
        assert!(inner.held.is_empty());
    }

    #[test]
    fn for_a_full_socket_nothing_is_taken() {
        let gather = socket(5);
        assert_eq!(write_frames(&gather, &[&[1; 10]]), 1);
        // Five of its bytes wait; a newer message is to come instead of what would wait behind them.
        assert_eq!(write_frames(&gather, &[&[2; 10]]), 0);
        gather.inner().stream.room = 100;
        assert_eq!(write_frames(&gather, &[&[3; 10], &[4; 10]]), 2);
        assert_eq!(gather.inner().stream.writes, [5, 5, 10, 10]);
        assert_eq!(write_frames(&gather, &[&[5; 10], &[6; 10]]), 2);
        assert_eq!(gather.inner().stream.writes.last(), Some(&20));
    }

    #[tokio::test]
    async fn all_bytes_come_in_order_through_a_narrow_socket_also_after_the_connection() {
        let (stream, mut client) = duplex(1000);
        let gather = Gather::new(stream);
        let bytes: Vec<u8> = (0..300_000_u32).map(|place| (place % 251) as u8).collect();
        let (first, rest) = bytes.split_at(200_000);
        let writing = async {
            let mut handle = gather.clone();
            let mut connection = pin!(async {
                for chunk in first.chunks(777) {
                    handle.write_all(chunk).await.unwrap();
                }
            });
            poll_fn(|context| gather.poll_through(connection.as_mut(), context)).await;
            // As a WebSocket that has taken it over.
            let mut upgraded = gather.clone();
            for chunk in rest.chunks(999) {
                upgraded.write_all(chunk).await.unwrap();
                upgraded.flush().await.unwrap();
            }
            upgraded.shutdown().await.unwrap();
        };
        let mut come = Vec::new();
        let (_, read) = tokio::join!(writing, client.read_to_end(&mut come));
        read.unwrap();
        assert!(come == bytes);
    }
}
