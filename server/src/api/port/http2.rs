//! What is known of a connection that speaks HTTP/2: what room its client grants, and the streams that are written to past
//! the library; see [`direct`](super::direct).

use std::{
    collections::BTreeMap,
    task::{Context, Waker},
    time::{Duration, Instant},
};

use bytes::{Buf as _, BufMut as _, Bytes, buf::Chain};

use super::{
    frames::{
        DATA, END_STREAM, HEAD_BYTES, HEADERS, Head, Inbound, MAX_PAYLOAD, Outbound, RST_STREAM,
        SETTINGS, Verdict, WINDOW_UPDATE, increment, initial_window,
    },
    windows::Windows,
};

/// Only a client that grants more than this beyond what HTTP/2 begins with has streams taken over: it may wait until most
/// of what it grants is used up before it gives any back, and the library keeps its share.
const LEAST_ROOM_BYTES: i64 = 256 * 1024;

/// Streams of which it is kept what was granted before they were known: more than are open at a time.
pub(super) const MOST_EARLY: usize = 256;

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
pub(super) struct Stream {
    key: u64,
    /// How its first message begins.
    begin: Vec<u8>,
    /// Its number, once that message has passed by.
    pub number: Option<u32>,
    /// Bytes of the library's that have passed by.
    passed: u64,
    /// Room on it beyond what a new stream has: what was granted, less what was sent.
    granted: i64,
    is_taken_over: bool,
    pub is_stopping: bool,
    is_ended: bool,
    /// What is left of the message that is under way.
    pub rest: Chain<Bytes, Bytes>,
    /// Since when it waits for room from the client.
    starved_since: Option<Instant>,
    /// Who waits for room, and who for the end of the message.
    wakers: Vec<Waker>,
}

impl Stream {
    pub(super) fn room(&self, windows: &Windows) -> i64 {
        (windows.initial() + self.granted).min(windows.direct()).max(0)
    }

    pub(super) fn is_ready(&self, windows: &Windows) -> bool {
        !self.rest.has_remaining() && self.room(windows) > 0
    }

    pub(super) fn sent(&mut self, bytes: usize, windows: &mut Windows) {
        self.granted -= bytes as i64;
        self.starved_since = None;
        windows.direct_sent(bytes);
    }

    /// Notes whether it waits for room, and wakes who waits for that.
    pub(super) fn settle(&mut self, windows: &Windows) {
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

    pub(super) fn wait(&mut self, context: &Context<'_>) {
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

    pub(super) fn stream(&mut self, key: u64) -> Result<(&mut Stream, &mut Windows), Gone> {
        let stream = self.streams.iter_mut().find(|stream| stream.key == key && !stream.is_ended);
        Ok((stream.ok_or(Gone)?, &mut self.windows))
    }

    /// The same if more may be sent on it.
    pub(super) fn open(&mut self, key: u64) -> Result<(&mut Stream, &mut Windows), Gone> {
        self.stream(key).ok().filter(|(stream, _)| !stream.is_stopping).ok_or(Gone)
    }

    /// A stream whose first message will begin like this; its key.
    pub(super) fn add(&mut self, begin: &[u8]) -> u64 {
        self.next_key += 1;
        self.streams.push(Stream {
            key: self.next_key,
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
        self.next_key
    }

    pub(super) fn remove(&mut self, key: u64) {
        self.streams.retain(|stream| stream.key != key);
    }

    /// As [`Direct::take_over`](super::Direct::take_over).
    pub(super) fn take_over(&mut self, key: u64, given: u64) -> Option<u32> {
        let (is_between_frames, forgotten) = (self.is_between_frames(), self.forgotten);
        let (stream, windows) = self.open(key).ok()?;
        let is_time = is_between_frames && stream.passed == given;
        let number = stream.number.filter(|&number| number > forgotten);
        let number = number.filter(|_| is_time && windows.is_wide(LEAST_ROOM_BYTES))?;
        stream.is_taken_over = true;
        Some(number)
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

    /// Puts what is under way, and has room, behind `held`, of which there may be `most`. Whether all had a place there.
    pub(super) fn pump(&mut self, held: &mut Vec<u8>, most: usize) -> bool {
        if !self.is_between_frames() {
            return true;
        }
        let Self { streams, windows, .. } = self;
        for stream in streams.iter_mut().filter(|it| it.is_taken_over && !it.is_ended) {
            while stream.rest.has_remaining() && stream.room(windows) > 0 {
                let room = stream.room(windows) as usize;
                let length = stream.rest.remaining().min(MAX_PAYLOAD).min(room);
                if held.len() + HEAD_BYTES + length > most {
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
