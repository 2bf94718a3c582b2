//! Messages that go to the socket past the library that speaks HTTP/2.
//!
//! For a subscriber's next snapshot the library takes two wake-ups, and touches memory of its own for each connection that
//! is in no cache any more; see `benches/subscribers`. So it does what it is there for, the begin and the end of a stream
//! and all else that is said on the connection, and the messages between are written here, as DATA frames between its
//! frames (RFC 9113, section 6.1).
//!
//! A stream is handed over like this. The first message goes through the library, and is known again by how it begins when
//! it passes by: so the number of its stream is found. Once all that the library was given has passed, the stream is
//! taken over ([`Direct::take_over`]). From then on what the client says of room on it is kept from the library, and
//! counted here; the room on the connection as a whole is shared (see [`windows`](super::windows)). When the library ends
//! the stream, nothing more is written to it.
//!
//! Full-policy: one message of a stream is under way at most, and for the next there is the newest snapshot.

use std::{future::poll_fn, io, task::Poll, time::Duration};

use bytes::{Buf as _, Bytes};

pub(in crate::api) use super::http2::Gone;
use super::{
    gather::{Gather, Inner},
    sheet::Sheet,
    socket::{Counted, Socket},
    stuck::stuck,
};

/// A connection on which messages may go past the library that speaks on it.
#[derive(Clone)]
pub(in crate::api) struct Line(pub(super) Gather<Counted>);

impl Line {
    /// For the stream whose first message will begin like this.
    pub(in crate::api) fn direct(&self, begin: &[u8]) -> Direct {
        Direct::new(&self.0, begin)
    }

    /// Waits until the client has taken nothing for so long, though there was something for it.
    pub(in crate::api) async fn stuck(&self, limit: Duration) {
        stuck(|| self.0.stuck_for(), limit).await;
    }

    /// Sends all of a sheet, behind what was written before, on a connection that a WebSocket has taken over. To be
    /// awaited to its end, or never again.
    pub(in crate::api) async fn send(&self, sheet: &Sheet) -> io::Result<()> {
        let mut sent = 0;
        poll_fn(|context| self.0.inner().poll_send(context, sheet, &mut sent)).await
    }
}

/// A stream's messages on their way past the library. It is let go with this; what is under way then is lost.
pub(in crate::api) struct Direct<S: Socket = Counted> {
    socket: Gather<S>,
    key: u64,
}

impl<S: Socket> Direct<S> {
    pub(super) fn new(socket: &Gather<S>, begin: &[u8]) -> Self {
        let mut inner = socket.inner();
        let key = inner.http2.as_mut().map_or(0, |http2| http2.add(begin));
        Self { socket: socket.clone(), key }
    }

    /// Takes the stream over from the library, which was given so many bytes for it; its number. `None`: it cannot be yet,
    /// and the next message goes through the library as well.
    pub(in crate::api) fn take_over(&self, given: u64) -> Option<u32> {
        let mut inner = self.socket.inner();
        inner.http2.as_mut()?.take_over(self.key, given)
    }

    /// Waits until there is room for a message.
    pub(in crate::api) async fn ready(&self) -> Result<(), Gone> {
        poll_fn(|context| {
            let mut inner = self.socket.inner();
            let is_full = inner.is_full();
            let http2 = inner.http2.as_mut().ok_or(Gone)?;
            let is_open = !is_full && http2.is_between_frames();
            let (stream, windows) = http2.stream(self.key)?;
            if stream.is_stopping && !stream.rest.has_remaining() {
                return Poll::Ready(Err(Gone));
            }
            if is_open && stream.is_ready(windows) {
                return Poll::Ready(Ok(()));
            }
            stream.wait(context);
            Poll::Pending
        })
        .await
    }

    /// Sends a message, which is `own` and `shared`, and may be on a sheet as well. Whether there is room for the next
    /// already.
    pub(in crate::api) fn send(
        &self,
        own: Bytes,
        shared: Bytes,
        sheet: Option<&Sheet>,
    ) -> Result<bool, Gone> {
        let mut inner = self.socket.inner();
        let is_open = inner.is_empty() && !inner.is_full();
        let http2 = inner.http2.as_mut().ok_or(Gone)?;
        let is_open = is_open && http2.is_between_frames();
        let (stream, windows) = http2.open(self.key)?;
        let is_fit = |sheet: &&Sheet| {
            sheet.stream() == stream.number && sheet.payload() as i64 <= stream.room(windows)
        };
        if let Some(sheet) = sheet.filter(is_fit)
            && is_open
            && !stream.rest.has_remaining()
        {
            stream.sent(sheet.payload(), windows);
            stream.settle(windows);
            inner.send(sheet);
        } else {
            stream.rest = own.chain(shared);
            inner.pump();
        }
        let is_full = inner.is_full();
        let (stream, windows) = inner.http2.as_mut().ok_or(Gone)?.stream(self.key)?;
        Ok(!is_full && stream.is_ready(windows))
    }

    /// Waits until no message is under way, after which none may be sent.
    pub(in crate::api) async fn stop(&self) {
        poll_fn(|context| {
            let mut inner = self.socket.inner();
            let Some(Ok((stream, _))) = inner.http2.as_mut().map(|it| it.stream(self.key)) else {
                return Poll::Ready(());
            };
            stream.is_stopping = true;
            if stream.rest.has_remaining() {
                stream.wait(context);
                return Poll::Pending;
            }
            Poll::Ready(())
        })
        .await;
    }
}

impl<S: Socket> Drop for Direct<S> {
    fn drop(&mut self) {
        let mut inner = self.socket.inner();
        if let Some(http2) = &mut inner.http2 {
            http2.remove(self.key);
        }
    }
}

impl<S: Socket> Inner<S> {
    /// Sends a sheet, of which what the socket does not take is held.
    fn send(&mut self, sheet: &Sheet) {
        // An error may be of what the socket is sent from; one of its own comes again.
        let sent = self.stream.try_send(sheet, 0).unwrap_or_default();
        if sent < sheet.bytes().len() {
            self.hold(&[io::IoSlice::new(&sheet.bytes()[sent..])]);
            self.drain();
        }
    }
}

#[cfg(test)]
mod tests;
