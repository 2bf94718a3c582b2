//! HTTP/2's frames (RFC 9113, section 4) as they pass by on a connection that a library speaks: what it writes is looked
//! at, and of what the client says the frames about room are changed before the library reads them.

/// Of a frame, what stands before its payload.
pub(super) const HEAD_BYTES: usize = 9;
/// Longest payload where nobody has asked for longer ones.
pub(super) const MAX_PAYLOAD: usize = 16_384;

pub(super) const DATA: u8 = 0;
pub(super) const HEADERS: u8 = 1;
pub(super) const RST_STREAM: u8 = 3;
pub(super) const SETTINGS: u8 = 4;
const PUSH_PROMISE: u8 = 5;
pub(super) const WINDOW_UPDATE: u8 = 8;
const CONTINUATION: u8 = 9;

/// Of DATA and HEADERS: the stream's last frame.
pub(super) const END_STREAM: u8 = 1;
/// Of SETTINGS: the answer to some.
const ACK: u8 = 1;
const END_HEADERS: u8 = 4;

/// Of each payload that passes by, as much is looked at.
const START_BYTES: usize = 64;
/// What a client says first (section 3.4).
pub(super) const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
/// The setting for how much may be sent on a new stream (section 6.5.2).
const INITIAL_WINDOW_SIZE: u16 = 4;

/// What stands before a frame's payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Head {
    pub length: usize,
    pub kind: u8,
    pub flags: u8,
    pub stream: u32,
}

impl Head {
    /// Of a part of a stream's data that is not its last.
    pub(super) fn data(stream: u32, length: usize) -> [u8; HEAD_BYTES] {
        Self { length, kind: DATA, flags: 0, stream }.bytes()
    }

    pub(super) fn bytes(self) -> [u8; HEAD_BYTES] {
        let [_, a, b, c] = (self.length as u32).to_be_bytes();
        let [d, e, f, g] = self.stream.to_be_bytes();
        [a, b, c, self.kind, self.flags, d, e, f, g]
    }

    pub(super) fn of(bytes: [u8; HEAD_BYTES]) -> Self {
        let [a, b, c, kind, flags, d, e, f, g] = bytes;
        let length = u32::from_be_bytes([0, a, b, c]) as usize;
        // The highest bit is reserved.
        Self { length, kind, flags, stream: u32::from_be_bytes([d & 0x7f, e, f, g]) }
    }

    /// Whether a block of header fields goes on behind this frame, if it did behind the one before.
    fn goes_on(&self, before: bool) -> bool {
        match self.kind {
            HEADERS | PUSH_PROMISE | CONTINUATION => !self.has(END_HEADERS),
            _ => before,
        }
    }

    pub(super) fn has(&self, flag: u8) -> bool {
        self.flags & flag != 0
    }
}

/// A WINDOW_UPDATE frame (section 6.9).
pub(super) fn window_update(stream: u32, increment: u32) -> Vec<u8> {
    let head = Head { length: 4, kind: WINDOW_UPDATE, flags: 0, stream };
    [head.bytes().as_slice(), &increment.to_be_bytes()].concat()
}

/// By how much a WINDOW_UPDATE of such a payload makes room.
pub(super) fn increment(payload: &[u8]) -> u32 {
    let bytes = payload.first_chunk().copied().unwrap_or_default();
    u32::from_be_bytes(bytes) & 0x7fff_ffff
}

/// What may be sent on a new stream by a SETTINGS of such a payload, if it says so.
pub(super) fn initial_window(payload: &[u8]) -> Option<u32> {
    let (settings, _) = payload.as_chunks::<6>();
    let wanted = settings.iter().rfind(|it| it[..2] == INITIAL_WINDOW_SIZE.to_be_bytes())?;
    wanted.last_chunk().map(|value| u32::from_be_bytes(*value))
}

/// Frames that pass by towards the client.
#[derive(Debug, Default)]
pub(super) struct Outbound {
    head: Vec<u8>,
    /// First bytes of the payload.
    start: Vec<u8>,
    /// Bytes of the payload that are to come.
    left: usize,
    /// Whether a block of header fields goes on in the next frame.
    is_in_block: bool,
}

impl Outbound {
    /// Whether another frame may be put here.
    pub(super) fn is_between_frames(&self) -> bool {
        self.head.is_empty() && !self.is_in_block
    }

    /// Passes bytes by; `see` gets each frame's head and the first bytes of its payload.
    pub(super) fn pass(&mut self, mut bytes: &[u8], mut see: impl FnMut(Head, &[u8])) {
        while !bytes.is_empty() {
            if self.head.len() < HEAD_BYTES {
                let taken = bytes.split_off(..(HEAD_BYTES - self.head.len()).min(bytes.len()));
                self.head.extend_from_slice(taken.unwrap_or_default());
                let Some(head) = self.present() else { return };
                self.left = head.length;
                self.start.clear();
            }
            let Some(head) = self.present() else { return };
            let wanted = head.length.min(START_BYTES);
            let was_seen = self.start.len() == wanted && self.left < head.length;
            let taken = bytes.split_off(..self.left.min(bytes.len())).unwrap_or_default();
            self.left -= taken.len();
            let looked_at = (wanted - self.start.len()).min(taken.len());
            self.start.extend_from_slice(&taken[..looked_at]);
            if self.start.len() == wanted && !was_seen {
                see(head, &self.start);
            }
            if self.left == 0 {
                self.is_in_block = head.goes_on(self.is_in_block);
                self.head.clear();
            }
        }
    }

    fn present(&self) -> Option<Head> {
        self.head.first_chunk().map(|bytes| Head::of(*bytes))
    }
}

/// What becomes of a frame from the client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// The library reads it.
    Pass,
    /// It does not.
    Drop,
    /// It reads that there is so much more room.
    Increment(u32),
}

/// Frames that come from the client, on their way to the library.
#[derive(Debug, Default)]
pub(super) struct Inbound {
    /// Bytes of the client's preface that have passed.
    preface: usize,
    /// The begin of a frame until it is known what becomes of it.
    kept: Vec<u8>,
    /// Bytes to come of a frame that just passes.
    left: usize,
    /// Whether a block of header fields goes on in the next frame.
    is_in_block: bool,
    /// What the library is to read next, from `given` on.
    ready: Vec<u8>,
    given: usize,
    /// Frames of our own to it, which wait for the end of the one that passes.
    own: Vec<u8>,
}

impl Inbound {
    /// Takes what has come; `judge` gets the frames about room, those that end streams, and what the client sets.
    pub(super) fn take(&mut self, mut bytes: &[u8], mut judge: impl FnMut(Head, &[u8]) -> Verdict) {
        self.pass(&mut bytes, PREFACE.len() - self.preface, |this, count| this.preface += count);
        while !bytes.is_empty() {
            self.pass(&mut bytes, self.left, |this, count| this.left -= count);
            if self.left > 0 {
                return;
            }
            self.let_own_in();
            let wanted = match self.kept.first_chunk().map(|head| Head::of(*head)) {
                Some(head) => HEAD_BYTES + head.length,
                None => HEAD_BYTES,
            };
            let taken = bytes.split_off(..(wanted - self.kept.len()).min(bytes.len()));
            self.kept.extend_from_slice(taken.unwrap_or_default());
            let Some((head, payload)) = self.kept.split_first_chunk() else { return };
            let head = Head::of(*head);
            let verdict = match is_judged(head) {
                true if payload.len() < head.length => continue,
                true => judge(head, payload),
                false => Verdict::Pass,
            };
            self.left = head.length - payload.len();
            self.is_in_block = head.goes_on(self.is_in_block);
            match verdict {
                Verdict::Pass => self.ready.extend_from_slice(&self.kept),
                Verdict::Drop => {}
                Verdict::Increment(by) => self.ready.extend(window_update(head.stream, by)),
            }
            self.kept.clear();
        }
    }

    /// Passes up to `limit` bytes on.
    fn pass(&mut self, bytes: &mut &[u8], limit: usize, note: impl FnOnce(&mut Self, usize)) {
        let passing = bytes.split_off(..limit.min(bytes.len())).unwrap_or_default();
        self.ready.extend_from_slice(passing);
        note(self, passing.len());
    }

    /// No more will come; whether there is something left to give.
    pub(super) fn end(&mut self) -> bool {
        self.ready.append(&mut self.kept);
        self.given < self.ready.len()
    }

    /// Tells the library on its own that there is more room on the connection.
    pub(super) fn tell_of_room(&mut self, increment: u32) {
        self.own.extend(window_update(0, increment));
        self.let_own_in();
    }

    fn let_own_in(&mut self) {
        let is_between_frames =
            self.preface == PREFACE.len() && self.left == 0 && !self.is_in_block;
        if is_between_frames && !self.own.is_empty() {
            self.ready.append(&mut self.own);
        }
    }

    /// What the library is to read next, up to so many bytes.
    pub(super) fn give(&mut self, limit: usize) -> &[u8] {
        if self.given == self.ready.len() {
            self.given = 0;
            self.ready.clear();
            self.ready.shrink_to(MAX_PAYLOAD);
        }
        let begin = self.given;
        self.given += limit.min(self.ready.len() - begin);
        &self.ready[begin..self.given]
    }
}

/// Whether a frame is to be known as a whole before the library reads it. Longer ones are errors, of which the library
/// tells the client.
fn is_judged(head: Head) -> bool {
    match head.kind {
        WINDOW_UPDATE | RST_STREAM => head.length == 4,
        SETTINGS => head.stream == 0 && head.length <= MAX_PAYLOAD && !head.has(ACK),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use proptest::{collection::vec, prelude::*};

    use super::*;

    fn frame(kind: u8, flags: u8, stream: u32, payload: &[u8]) -> Vec<u8> {
        let head = Head { length: payload.len(), kind, flags, stream };
        [head.bytes().as_slice(), payload].concat()
    }

    /// In pieces of such lengths, again and again.
    fn pieces<'a>(mut bytes: &'a [u8], lengths: &[usize]) -> Vec<&'a [u8]> {
        let mut pieces = Vec::new();
        for length in lengths.iter().cycle() {
            let Some(piece) = bytes.split_off(..(*length).min(bytes.len())) else { break };
            pieces.push(piece);
            if bytes.is_empty() {
                break;
            }
        }
        pieces
    }

    fn frames() -> impl Strategy<Value = Vec<(u8, u32, Vec<u8>)>> {
        let payload = prop_oneof![vec(any::<u8>(), 0..8), vec(any::<u8>(), 60..200)];
        vec((0..10_u8, 0..5_u32, payload), 1..12)
    }

    proptest! {
        #[test]
        fn each_frame_is_seen_once_however_it_is_cut(
            frames in frames(), lengths in vec(1..90_usize, 1..9)
        ) {
            let written: Vec<u8> =
                frames.iter().flat_map(|(kind, stream, payload)| frame(*kind, 4, *stream, payload)).collect();
            let (mut outbound, mut seen) = (Outbound::default(), Vec::new());
            let mut length = 0;
            let ends: Vec<usize> = frames
                .iter()
                .map(|(.., payload)| {
                    length += HEAD_BYTES + payload.len();
                    length
                })
                .collect();
            let mut passed = 0;
            for piece in pieces(&written, &lengths) {
                outbound.pass(piece, |head, start| seen.push((head.kind, head.stream, start.to_vec())));
                passed += piece.len();
                // A frame without payload is seen, and over, with its head.
                prop_assert_eq!(outbound.is_between_frames(), ends.contains(&passed));
            }
            let expected: Vec<_> = frames
                .into_iter()
                .map(|(kind, stream, payload)| (kind, stream, payload[..payload.len().min(START_BYTES)].to_vec()))
                .collect();
            prop_assert_eq!(seen, expected);
        }

        #[test]
        fn the_library_reads_all_but_what_is_judged(
            frames in frames(), lengths in vec(1..90_usize, 1..9), limits in vec(1..50_usize, 1..5)
        ) {
            let preface = PREFACE;
            let mut said = preface.to_vec();
            let mut expected = preface.to_vec();
            for (kind, stream, payload) in &frames {
                let frame = frame(*kind, 0, *stream, payload);
                said.extend(&frame);
                match (*kind, payload.len(), increment(payload) % 3) {
                    (WINDOW_UPDATE, 4, 0) => {}
                    (WINDOW_UPDATE, 4, 1) => expected.extend(window_update(*stream, 77)),
                    _ => expected.extend(frame),
                }
            }
            let judge = |head: Head, payload: &[u8]| match (head.kind, increment(payload) % 3) {
                (WINDOW_UPDATE, 0) => Verdict::Drop,
                (WINDOW_UPDATE, 1) => Verdict::Increment(77),
                _ => Verdict::Pass,
            };
            let (mut inbound, mut read) = (Inbound::default(), Vec::new());
            let mut limits = limits.iter().cycle();
            for piece in pieces(&said, &lengths) {
                inbound.take(piece, judge);
                read.extend_from_slice(inbound.give(*limits.next().unwrap()));
            }
            inbound.end();
            loop {
                let given = inbound.give(1000);
                if given.is_empty() {
                    break;
                }
                read.extend_from_slice(given);
            }
            prop_assert_eq!(read, expected);
        }
    }

    #[test]
    fn header_fields_are_not_cut_apart() {
        let mut outbound = Outbound::default();
        outbound.pass(&frame(HEADERS, 0, 1, b"abc"), |_, _| {});
        assert!(!outbound.is_between_frames());
        outbound.pass(&frame(CONTINUATION, END_HEADERS, 1, b"abc"), |_, _| {});
        assert!(outbound.is_between_frames());
    }

    #[test]
    fn a_frame_of_our_own_waits_for_the_end_of_one_that_passes() {
        let mut inbound = Inbound::default();
        let judge = |_: Head, _: &[u8]| Verdict::Pass;
        let data = frame(DATA, 0, 1, &[5; 40]);
        inbound.take(PREFACE, judge);
        inbound.take(&data[..20], judge);
        inbound.tell_of_room(9);
        inbound.take(&data[20..], judge);
        inbound.take(&[0], judge);
        let expected = [PREFACE, &data, &window_update(0, 9)].concat();
        assert_eq!(inbound.give(1000), expected);
    }

    #[test]
    fn and_for_the_end_of_the_header_fields() {
        let mut inbound = Inbound::default();
        let judge = |_: Head, _: &[u8]| Verdict::Pass;
        let [begin, end] =
            [frame(HEADERS, 0, 1, b"abc"), frame(CONTINUATION, END_HEADERS, 1, b"d")];
        inbound.take(PREFACE, judge);
        inbound.take(&begin, judge);
        inbound.tell_of_room(9);
        inbound.take(&end, judge);
        inbound.take(&end[..1], judge);
        let expected = [PREFACE, &begin, &end, &window_update(0, 9)].concat();
        assert_eq!(inbound.give(1000), expected);
    }

    #[test]
    fn of_settings_the_last_word_counts() {
        let settings = [[0, 4, 0, 0, 0, 7], [0, 3, 0, 0, 0, 9], [0, 4, 0, 1, 0, 0]].concat();
        assert_eq!(initial_window(&settings), Some(65_536));
        assert_eq!(initial_window(&settings[6..12]), None);
        assert_eq!(increment(&[0x80, 0, 0, 5]), 5);
    }
}
