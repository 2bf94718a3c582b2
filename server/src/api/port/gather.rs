//! One write to the socket for all that a connection has to say at a time.
//!
//! HTTP/2 cuts a message into frames of 16 kB, and hyper's hands each to the socket by itself: a snapshot of 100 objects
//! is two of them, or three with covariances. Most of what a subscriber costs is the system's part of a write, so here
//! what is written while the connection is polled is gathered, and goes out when that poll ends. Between, and after it,
//! there is room for what goes past the library that speaks HTTP/2: see [`direct`](super::direct).

use std::{
    cell::Cell,
    future::Future,
    io,
    mem::MaybeUninit,
    pin::Pin,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    task::{Context, Poll, Waker, ready},
    time::{Duration, Instant},
};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use super::{http2::Http2, sheet::Sheet, socket::Socket};

/// What is more than this goes out at once.
const MOST_BYTES: usize = 64 * 1024;

thread_local! {
    /// What the last connection gathered in: as a rule it is empty before the next one is polled, and still in the
    /// processor's cache.
    static SPARE: Cell<Vec<u8>> = const { Cell::new(Vec::new()) };
}

/// Read from a socket at once, where the library does not read by itself.
const READ_BYTES: usize = 16 * 1024;

/// A handle on a socket that gathers; all of them are of the same one.
pub(in crate::api) struct Gather<S>(Arc<Mutex<Inner<S>>>);

pub(super) struct Inner<S> {
    pub stream: S,
    /// Of a connection that speaks HTTP/2.
    pub http2: Option<Http2>,
    /// Taken from whoever writes, and not yet by the socket.
    held: Vec<u8>,
    /// Bytes of it that the socket has taken.
    sent: usize,
    /// Whether the connection is being polled.
    is_gathering: bool,
    /// Since when the socket has had no room; until it has, nothing is held for it that would grow old.
    full_since: Option<Instant>,
    /// Polls the connection, where something goes past the library.
    connection: Option<Waker>,
    /// What is wrong with the socket, for the library to find.
    broken: Option<io::ErrorKind>,
}

impl<S> Clone for Gather<S> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<S> Gather<S> {
    pub(super) fn inner(&self) -> MutexGuard<'_, Inner<S>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Nothing more goes past the library.
    pub(super) fn end(&self) {
        if let Some(http2) = &mut self.inner().http2 {
            http2.end();
        }
    }
}

impl<S: Socket> Gather<S> {
    pub(super) fn new(stream: S, is_http2: bool) -> Self {
        Self(Arc::new(Mutex::new(Inner {
            stream,
            http2: is_http2.then(Http2::default),
            held: Vec::new(),
            sent: 0,
            is_gathering: false,
            full_since: None,
            connection: None,
            broken: None,
        })))
    }

    /// For how long the client has taken nothing of what there is for it: the socket, or what goes past the library.
    pub(super) fn stuck_for(&self) -> Duration {
        let inner = self.inner();
        let full_for = inner.full_since.map_or(Duration::ZERO, |since| since.elapsed());
        full_for.max(inner.http2.as_ref().map_or(Duration::ZERO, Http2::starved_for))
    }

    /// Polls the connection that has another handle, and lets out what it wrote.
    pub(super) fn poll_through<F: Future>(
        &self,
        connection: Pin<&mut F>,
        context: &mut Context<'_>,
    ) -> Poll<F::Output> {
        let mut inner = self.inner();
        inner.is_gathering = true;
        let is_known = inner.connection.as_ref().is_some_and(|it| it.will_wake(context.waker()));
        if inner.http2.is_some() && !is_known {
            inner.connection = Some(context.waker().clone());
        }
        drop(inner);
        let polled = connection.poll(context);
        let mut inner = self.inner();
        inner.is_gathering = false;
        if polled.is_ready() {
            // Who has taken the socket over waits for it now, and is the one to be woken.
            inner.drain();
            return polled;
        }
        // What does not go out now does when the socket wakes this task, or with the next write, which also learns of
        // an error.
        while let Poll::Ready(Ok(())) = inner.poll_drain(context) {
            inner.put();
            if inner.is_empty() {
                break;
            }
        }
        polled
    }
}

impl<S> Inner<S> {
    /// Whether nothing is held.
    pub(super) fn is_empty(&self) -> bool {
        self.held.is_empty()
    }

    /// Whether the socket has no room.
    pub(super) fn is_full(&self) -> bool {
        self.full_since.is_some()
    }

    pub(super) fn hold(&mut self, parts: &[io::IoSlice<'_>]) {
        self.make_room();
        parts.iter().for_each(|part| self.held.extend_from_slice(part));
    }

    fn make_room(&mut self) {
        if self.held.capacity() == 0 {
            self.held = SPARE.take();
            self.held.reserve(MOST_BYTES);
        }
    }

    fn release(&mut self) {
        if self.held.capacity() > 0 {
            self.sent = 0;
            let mut held = std::mem::take(&mut self.held);
            held.clear();
            held.shrink_to(MOST_BYTES);
            SPARE.set(held);
        }
    }

    fn note(&mut self, is_full: bool) {
        self.full_since = is_full.then(|| self.full_since.unwrap_or_else(Instant::now));
    }

    /// Holds what goes past the library, as far as there is a place for it; false if that was too little.
    fn put(&mut self) -> bool {
        if self.is_full() {
            return true;
        }
        if self.http2.as_ref().is_some_and(Http2::is_under_way) {
            self.make_room();
        }
        self.http2.as_mut().is_none_or(|http2| http2.pump(&mut self.held, MOST_BYTES))
    }

    /// Lets the library's bytes pass by.
    fn pass(&mut self, parts: &[io::IoSlice<'_>], mut count: usize) {
        let Some(http2) = &mut self.http2 else { return };
        let mut is_to_read = false;
        for part in parts {
            let passing = count.min(part.len());
            is_to_read |= http2.pass(&part[..passing]);
            count -= passing;
        }
        if is_to_read {
            self.wake();
        }
    }

    /// Has the connection polled.
    fn wake(&self) {
        self.connection.iter().for_each(Waker::wake_by_ref);
    }

    fn fail(&mut self, error: io::ErrorKind) {
        self.broken = Some(error);
        self.http2.iter_mut().for_each(Http2::end);
        self.wake();
    }

    fn check(&self) -> io::Result<()> {
        self.broken.map_or(Ok(()), |error| Err(error.into()))
    }
}

impl<S: Socket> Inner<S> {
    /// Lets out what goes past the library, as far as there is room for it.
    pub(super) fn pump(&mut self) {
        while !self.put() {
            self.drain();
            if !self.is_empty() {
                return;
            }
        }
        self.drain();
    }

    /// Lets out what is held, outside of the connection's task; the rest goes out in that.
    pub(super) fn drain(&mut self) {
        if self.is_gathering {
            return;
        }
        while self.sent < self.held.len() {
            match self.stream.try_write(&self.held[self.sent..]) {
                Ok(count) if count > 0 => {
                    self.note(false);
                    self.sent += count;
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    self.note(true);
                    return self.wake();
                }
                Ok(_) => return self.fail(io::ErrorKind::WriteZero),
                Err(error) => return self.fail(error.kind()),
            }
        }
        self.release();
    }

    fn poll_drain(&mut self, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        if self.is_full() && self.is_empty() {
            ready!(self.stream.poll_writable(context))?;
            self.note(false);
        }
        while self.sent < self.held.len() {
            let written = Pin::new(&mut self.stream).poll_write(context, &self.held[self.sent..]);
            self.note(written.is_pending());
            match ready!(written)? {
                0 => return Poll::Ready(Err(io::ErrorKind::WriteZero.into())),
                count => self.sent += count,
            }
        }
        self.release();
        Poll::Ready(Ok(()))
    }

    /// Sends a sheet of which so much is sent.
    pub(super) fn poll_send(
        &mut self,
        context: &mut Context<'_>,
        sheet: &Sheet,
        sent: &mut usize,
    ) -> Poll<io::Result<()>> {
        ready!(self.poll_drain(context))?;
        while *sent < sheet.bytes().len() {
            match self.stream.try_send(sheet, *sent) {
                Ok(0) => return Poll::Ready(Err(io::ErrorKind::WriteZero.into())),
                Ok(count) => {
                    self.note(false);
                    *sent += count;
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    self.note(true);
                    ready!(self.stream.poll_writable(context))?;
                }
                // That may be of what is sent from; an error of the socket comes again.
                Err(_) => {
                    let rest = &sheet.bytes()[*sent..];
                    let written = Pin::new(&mut self.stream).poll_write(context, rest);
                    self.note(written.is_pending());
                    match ready!(written)? {
                        0 => return Poll::Ready(Err(io::ErrorKind::WriteZero.into())),
                        count => *sent += count,
                    }
                }
            }
        }
        Poll::Ready(Ok(()))
    }

    fn poll_read(
        &mut self,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        self.check()?;
        let Some(http2) = &mut self.http2 else {
            return Pin::new(&mut self.stream).poll_read(context, buffer);
        };
        loop {
            let given = http2.inbound.give(buffer.remaining());
            if !given.is_empty() || buffer.remaining() == 0 {
                buffer.put_slice(given);
                return Poll::Ready(Ok(()));
            }
            let mut come = [MaybeUninit::uninit(); READ_BYTES];
            let mut come = ReadBuf::uninit(&mut come);
            ready!(Pin::new(&mut self.stream).poll_read(context, &mut come))?;
            match come.filled() {
                [] if http2.inbound.end() => {}
                [] => return Poll::Ready(Ok(())),
                bytes => http2.take(bytes),
            }
        }
    }

    fn poll_write(
        &mut self,
        context: &mut Context<'_>,
        parts: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let length = parts.iter().map(|part| part.len()).sum::<usize>();
        let is_room = self.held.len() + length <= MOST_BYTES;
        if self.is_gathering && is_room && !self.is_full() {
            self.hold(parts);
            self.pass(parts, length);
            return Poll::Ready(Ok(length));
        }
        self.check()?;
        ready!(self.poll_drain(context))?;
        // What goes past the library is not to wait until that has no more to write.
        self.put();
        ready!(self.poll_drain(context))?;
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, parts);
        self.note(written.is_pending());
        if let Poll::Ready(Ok(count)) = written {
            self.pass(parts, count);
        }
        written
    }
}

impl<S: Socket> AsyncRead for Gather<S> {
    fn poll_read(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        self.inner().poll_read(context, buffer)
    }
}

impl<S: Socket> AsyncWrite for Gather<S> {
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
        self.inner().poll_write(context, parts)
    }

    fn is_write_vectored(&self) -> bool {
        true
    }

    fn poll_flush(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let mut inner = self.inner();
        if inner.is_gathering && !inner.is_full() {
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
mod tests;
