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
//! counted here; the room on the connection as a whole is shared ([`Windows`]). When the library ends the stream, nothing
//! more is written to it.
//!
//! Full-policy: one message of a stream is under way at most, and for the next there is the newest snapshot.

use std::{
    collections::BTreeMap,
    future::poll_fn,
    io,
    sync::MutexGuard,
    task::{Context, Poll, Waker},
    time::{Duration, Instant},
};

use bytes::{Buf as _, BufMut as _, Bytes, buf::Chain};

use super::{
    frames::{
        DATA, END_STREAM, HEAD_BYTES, HEADERS, Head, Inbound, MAX_PAYLOAD, Outbound, RST_STREAM,
        SETTINGS, Verdict, WINDOW_UPDATE, increment, initial_window,
    },
    gather::{Gather, Inner, MOST_BYTES},
    sheet::Sheet,
    socket::{Counted, Socket},
    windows::Windows,
};

/// Only a client that grants more than this beyond what HTTP/2 begins with has streams taken over: it may wait until most
/// of what it grants is used up before it gives any back, and the library keeps its share.
const LEAST_ROOM_BYTES: i64 = 256 * 1024;

/// Streams of which it is kept what was granted before they were known: more than are open at a time.
const MOST_EARLY: usize = 256;

/// The stream has ended, or its connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::api) struct Gone;

/// What is known of a connection that speaks HTTP/2.
#[derive(Default)]
pub(super) struct Http2 {
    pub inbound: Inbound,
    outbound: Outbound,
    windows: Windows,
    streams: Vec<Stream>,
    next_key: u64,
    /// What was granted for streams that are none of these, or not known yet as one of these, by their numbers.
    early: BTreeMap<u32, i64>,
    /// Up to here it is not kept any more.
    forgotten: u32,
}

/// A stream that is, or is to be, written to past the library.
struct Stream {
    key: u64,
    /// How its first message begins.
    begin: Vec<u8>,
    /// Its number, once that message has passed by.
    number: Option<u32>,
    /// Bytes of the library's that have passed by.
    passed: u64,
    /// Room on it beyond what a new stream has: what was granted, less what was sent.
    granted: i64,
    is_taken_over: bool,
    is_stopping: bool,
    is_ended: bool,
    /// What is left of the message that is under way.
    rest: Chain<Bytes, Bytes>,
    /// Since when it waits for room from the client.
    starved_since: Option<Instant>,
    /// Who waits for room, and who for the end of the message.
    wakers: Vec<Waker>,
}

impl Stream {
    fn room(&self, windows: &Windows) -> i64 {
        (windows.initial() + self.granted).min(windows.direct()).max(0)
    }

    fn is_ready(&self, windows: &Windows) -> bool {
        !self.rest.has_remaining() && self.room(windows) > 0
    }

    fn sent(&mut self, bytes: usize, windows: &mut Windows) {
        self.granted -= bytes as i64;
        self.starved_since = None;
        windows.direct_sent(bytes);
    }

    /// Notes whether it waits for room, and wakes who waits for that.
    fn settle(&mut self, windows: &Windows) {
        if self.is_ready(windows) {
            self.starved_since = None;
        } else {
            self.starved_since.get_or_insert_with(Instant::now);
        }
        if !self.rest.has_remaining() {
            self.wake();
        }
    }

    fn end(&mut self) {
        self.is_ended = true;
        self.starved_since = None;
        self.wake();
    }

    fn wake(&mut self) {
        self.wakers.drain(..).for_each(Waker::wake);
    }

    fn wait(&mut self, context: &Context<'_>) {
        if !self.wakers.iter().any(|waker| waker.will_wake(context.waker())) {
            self.wakers.push(context.waker().clone());
        }
    }
}

impl Http2 {
    /// Whether a frame may be put behind what the library has written.
    pub(super) fn is_between_frames(&self) -> bool {
        self.outbound.is_between_frames()
    }

    fn stream(&mut self, key: u64) -> Result<(&mut Stream, &mut Windows), Gone> {
        let stream = self.streams.iter_mut().find(|stream| stream.key == key && !stream.is_ended);
        Ok((stream.ok_or(Gone)?, &mut self.windows))
    }

    /// The same if more may be sent on it.
    fn open(&mut self, key: u64) -> Result<(&mut Stream, &mut Windows), Gone> {
        self.stream(key).ok().filter(|(stream, _)| !stream.is_stopping).ok_or(Gone)
    }

    /// Takes what has come from the client.
    pub(super) fn take(&mut self, bytes: &[u8]) {
        let Self { inbound, windows, streams, early, forgotten, .. } = self;
        inbound.take(bytes, |head, payload| match head.kind {
            RST_STREAM => {
                early.remove(&head.stream);
                let reset = streams.iter_mut().filter(|it| it.number == Some(head.stream));
                reset.for_each(Stream::end);
                Verdict::Pass
            }
            SETTINGS => {
                initial_window(payload).into_iter().for_each(|bytes| windows.set_initial(bytes));
                Verdict::Pass
            }
            // An error, and the library's to find.
            WINDOW_UPDATE if increment(payload) == 0 => Verdict::Pass,
            WINDOW_UPDATE if head.stream == 0 => match windows.grant(increment(payload)) {
                0 => Verdict::Drop,
                heard => Verdict::Increment(heard),
            },
            WINDOW_UPDATE => {
                let is_it = |stream: &&mut Stream| stream.number == Some(head.stream);
                let Some(stream) = streams.iter_mut().find(is_it) else {
                    *early.entry(head.stream).or_default() += i64::from(increment(payload));
                    // Most are of streams that have ended, whose numbers are the lowest.
                    if early.len() > MOST_EARLY
                        && let Some((number, _)) = early.pop_first()
                    {
                        *forgotten = number.max(*forgotten);
                    }
                    return Verdict::Pass;
                };
                stream.granted += i64::from(increment(payload));
                if stream.is_taken_over { Verdict::Drop } else { Verdict::Pass }
            }
            _ => Verdict::Pass,
        });
        // From now on they wait for the socket at most.
        let roomy = streams.iter_mut().filter(|stream| stream.room(windows) > 0);
        roomy.for_each(|stream| stream.starved_since = None);
    }

    /// Lets bytes of the library's pass by; whether there is something new for it to read.
    pub(super) fn pass(&mut self, bytes: &[u8]) -> bool {
        let Self { inbound, outbound, windows, streams, early, .. } = self;
        let is_used = streams.iter().any(|stream| stream.is_taken_over && !stream.is_ended);
        let mut lent = 0;
        outbound.pass(bytes, |head, start| {
            if head.kind == DATA {
                lent += windows.library_sent(head.length, is_used);
                let known = streams.iter().position(|it| it.number == Some(head.stream));
                let begins = |it: &Stream| it.number.is_none() && start.starts_with(&it.begin);
                let found = known.or_else(|| streams.iter().position(begins));
                if let Some(stream) = found.and_then(|place| streams.get_mut(place)) {
                    stream.number = Some(head.stream);
                    stream.granted += early.remove(&head.stream).unwrap_or_default();
                    stream.passed += head.length as u64;
                    stream.granted -= head.length as i64;
                }
            }
            if head.kind == RST_STREAM
                || (matches!(head.kind, DATA | HEADERS) && head.has(END_STREAM))
            {
                early.remove(&head.stream);
                let ended = streams.iter_mut().filter(|it| it.number == Some(head.stream));
                ended.for_each(Stream::end);
            }
        });
        if lent > 0 {
            inbound.tell_of_room(lent);
        }
        lent > 0
    }

    /// Whether a message is.
    pub(super) fn is_under_way(&self) -> bool {
        self.streams.iter().any(|stream| stream.rest.has_remaining())
    }

    /// For how long the stream has waited for room that waits longest.
    pub(super) fn starved_for(&self) -> Duration {
        let since = self.streams.iter().filter_map(|stream| stream.starved_since).min();
        since.map_or(Duration::ZERO, |since| since.elapsed())
    }

    /// Puts what is under way, and has room, behind `held`. Whether all had a place there.
    pub(super) fn pump(&mut self, held: &mut Vec<u8>) -> bool {
        if !self.is_between_frames() {
            return true;
        }
        let Self { streams, windows, .. } = self;
        for stream in streams.iter_mut().filter(|it| it.is_taken_over && !it.is_ended) {
            while stream.rest.has_remaining() && stream.room(windows) > 0 {
                let room = stream.room(windows) as usize;
                let length = stream.rest.remaining().min(MAX_PAYLOAD).min(room);
                if held.len() + HEAD_BYTES + length > MOST_BYTES {
                    return false;
                }
                held.put_slice(&Head::data(stream.number.unwrap_or_default(), length));
                held.put((&mut stream.rest).take(length));
                stream.sent(length, windows);
            }
            stream.settle(windows);
        }
        true
    }

    /// Nothing more will be written.
    pub(super) fn end(&mut self) {
        self.streams.iter_mut().for_each(Stream::end);
    }
}

/// A connection on which messages may go past the library that speaks on it.
#[derive(Clone)]
pub(in crate::api) struct Line(pub(super) Gather<Counted>);

impl Line {
    /// For the stream whose first message will begin like this.
    pub(in crate::api) fn direct(&self, begin: &[u8]) -> Direct {
        Direct::new(&self.0, begin)
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
        let key = match &mut inner.http2 {
            None => 0,
            Some(http2) => {
                http2.next_key += 1;
                http2.streams.push(Stream {
                    key: http2.next_key,
                    begin: begin.to_vec(),
                    number: None,
                    passed: 0,
                    granted: 0,
                    is_taken_over: false,
                    is_stopping: false,
                    is_ended: false,
                    rest: Bytes::new().chain(Bytes::new()),
                    starved_since: None,
                    wakers: Vec::new(),
                });
                http2.next_key
            }
        };
        Self { socket: socket.clone(), key }
    }

    /// Takes the stream over from the library, which was given so many bytes for it; its number. `None`: it cannot be yet,
    /// and the next message goes through the library as well.
    pub(in crate::api) fn take_over(&self, given: u64) -> Option<u32> {
        let mut inner = self.socket.inner();
        let http2 = inner.http2.as_mut()?;
        let (is_between_frames, forgotten) = (http2.is_between_frames(), http2.forgotten);
        let (stream, windows) = http2.open(self.key).ok()?;
        let is_time = is_between_frames && stream.passed == given;
        let number = stream.number.filter(|&number| number > forgotten);
        let number = number.filter(|_| is_time && windows.is_wide(LEAST_ROOM_BYTES))?;
        stream.is_taken_over = true;
        Some(number)
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
        let mut inner: MutexGuard<'_, Inner<S>> = self.socket.inner();
        if let Some(http2) = &mut inner.http2 {
            http2.streams.retain(|stream| stream.key != self.key);
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
