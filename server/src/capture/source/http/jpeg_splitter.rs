//! Splits a stream of bytes into JPEGs, each with the time stamp of its part header.
//!
//! Cameras send other boundaries than they announce, and omit Content-Length or send a wrong one. So pictures are found
//! by walking their markers: each segment has a length, and in entropy-coded data every FF is followed by 00 or a
//! restart marker. The bytes between pictures are searched only for a time stamp. A walk that meets the start of
//! another picture or an invalid marker counts the picture as broken and continues there.
//!
//! The crates rely on the boundary. `multer` ends a part at the next boundary, so each picture would be one frame late,
//! and a wrong boundary is an error. `multipart-stream` also requires Content-Length.

use std::collections::VecDeque;

use roundel_core::time::Timestamp;

/// Longest picture, bytes; a longer one is broken.
const MAX_JPEG: usize = 16 << 20;
/// Longest part header, bytes.
const MAX_HEADER: usize = 4096;
/// The first marker of a picture and the start of the second.
const START: [u8; 3] = [0xFF, 0xD8, 0xFF];
const STAMP: &str = "x-timestamp";

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StampedJpeg {
    /// From its first marker to its last one.
    pub jpeg: Vec<u8>,
    /// Arrival of its first byte.
    pub arrival: Timestamp,
    /// The camera's time stamp, ns since an arbitrary epoch.
    pub stamp_ns: Option<i64>,
}

#[derive(Clone, Copy, Debug)]
enum ScanState {
    /// A marker begins at this byte.
    Marker(usize),
    /// Entropy-coded data continue at this byte.
    Coded(usize),
}

/// Result of a step through a picture.
enum ScanStep {
    On(ScanState),
    Wait,
    /// The picture ends before this byte.
    Whole(usize),
    /// The picture is broken; another one may begin at this byte.
    Broken(usize),
}

/// Finds the pictures of a stream.
#[derive(Debug, Default)]
pub struct JpegSplitter {
    bytes: Vec<u8>,
    /// Position in the picture at the start of `bytes`; `None`: between pictures.
    walk: Option<ScanState>,
    /// Bytes already searched for a picture.
    searched: usize,
    arrival: Timestamp,
    stamp_ns: Option<i64>,
    found: VecDeque<StampedJpeg>,
    /// Bytes since the last picture, and whether they were counted as a broken picture.
    between: usize,
    is_counted: bool,
    broken: u64,
}

impl JpegSplitter {
    pub fn push(&mut self, arrived: &[u8], now: Timestamp) {
        self.bytes.extend_from_slice(arrived);
        while self.advance(now) {}
    }

    pub fn pop(&mut self) -> Option<StampedJpeg> {
        self.found.pop_front()
    }

    /// Number of broken pictures since the last call.
    pub fn take_broken(&mut self) -> u64 {
        std::mem::take(&mut self.broken)
    }

    /// Takes one step; false if it needs more bytes.
    fn advance(&mut self, now: Timestamp) -> bool {
        let Some(walk) = self.walk else { return self.search(now) };
        match step(&self.bytes, walk) {
            ScanStep::On(next) => self.walk = Some(next),
            ScanStep::Wait if self.bytes.len() > MAX_JPEG => self.discard_until(START.len()),
            ScanStep::Wait => return false,
            ScanStep::Whole(end) => {
                let jpeg = self.bytes.drain(..end).collect();
                let stamp_ns = self.stamp_ns.take();
                self.found.push_back(StampedJpeg { jpeg, arrival: self.arrival, stamp_ns });
                (self.walk, self.searched) = (None, 0);
                (self.between, self.is_counted) = (0, false);
            }
            ScanStep::Broken(at) => self.discard_until(at),
        }
        true
    }

    /// Drops the broken picture, up to `at`.
    fn discard_until(&mut self, at: usize) {
        self.bytes.drain(..at);
        self.broken += 1;
        (self.walk, self.searched, self.stamp_ns) = (None, 0, None);
        // The rest of the picture is not counted again.
        self.is_counted = true;
    }

    /// Searches for the start of a picture; false if it needs more bytes.
    fn search(&mut self, now: Timestamp) -> bool {
        let begin = self.bytes[self.searched..].windows(START.len()).position(|it| it == START);
        let end = match begin {
            Some(begin) => self.searched + begin,
            // The start may be split between two reads.
            None => self.bytes.len().saturating_sub(START.len() - 1).max(self.searched),
        };
        self.count_broken_between(self.searched, end);
        if begin.is_some() {
            self.stamp_ns = stamp_ns(&self.bytes[..end]);
            self.bytes.drain(..end);
            (self.walk, self.arrival) = (Some(ScanState::Marker(2)), now);
            return true;
        }
        self.searched = end;
        if end > 2 * MAX_HEADER {
            self.bytes.drain(..end - MAX_HEADER);
            self.searched = MAX_HEADER;
        }
        false
    }

    /// Counts bytes between pictures as one broken picture unless they are a part header.
    fn count_broken_between(&mut self, from: usize, to: usize) {
        self.between += to - from;
        let is_header =
            self.between <= MAX_HEADER && self.bytes[from..to].iter().all(|byte| is_text(*byte));
        if !is_header && !self.is_counted {
            self.is_counted = true;
            self.broken += 1;
        }
    }
}

fn is_text(byte: u8) -> bool {
    byte.is_ascii_graphic() || byte.is_ascii_whitespace() || byte == 0
}

/// The last time stamp in a part header, in decimal seconds.
fn stamp_ns(header: &[u8]) -> Option<i64> {
    let text = String::from_utf8_lossy(header);
    let line = text.lines().rev().find_map(|line| {
        let (name, value) = line.split_once(':')?;
        name.trim().eq_ignore_ascii_case(STAMP).then_some(value.trim())
    })?;
    let (seconds, fraction) = line.split_once('.').unwrap_or((line, ""));
    let is_number = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    if seconds.is_empty() || !is_number(seconds) || !is_number(fraction) {
        return None;
    }
    let nanoseconds: i64 = format!("{fraction:0<9}").get(..9)?.parse().ok()?;
    seconds.parse::<i64>().ok()?.checked_mul(1_000_000_000)?.checked_add(nanoseconds)
}

/// One step through the picture at the beginning of `bytes`.
fn step(bytes: &[u8], walk: ScanState) -> ScanStep {
    match walk {
        ScanState::Coded(from) => {
            let mut at = from;
            while let Some(offset) =
                bytes.get(at..).and_then(|it| it.iter().position(|b| *b == 0xFF))
            {
                at += offset;
                match bytes.get(at + 1) {
                    None if at == from => return ScanStep::Wait,
                    None => return ScanStep::On(ScanState::Coded(at)),
                    // An escaped FF, a restart marker or a fill byte does not end the coded data.
                    Some(0x00 | 0xD0..=0xD7) => at += 2,
                    Some(0xFF) => at += 1,
                    Some(_) => return ScanStep::On(ScanState::Marker(at)),
                }
            }
            match bytes.len() {
                end if from >= end => ScanStep::Wait,
                end => ScanStep::On(ScanState::Coded(end)),
            }
        }
        ScanState::Marker(at) => marker(bytes, at),
    }
}

/// Steps over the marker at `at` and its segment.
fn marker(bytes: &[u8], at: usize) -> ScanStep {
    let Some(&[first, marker]) = bytes.get(at..at + 2).and_then(|it| it.first_chunk()) else {
        return ScanStep::Wait;
    };
    match (first, marker) {
        (0xFF, 0xD9) => return ScanStep::Whole(at + 2),
        // Fill.
        (0xFF, 0xFF) => return ScanStep::On(ScanState::Marker(at + 1)),
        // The start of another picture, or an invalid marker.
        (0xFF, 0x00..=0xBF | 0xD0..=0xD8) | (0..=0xFE, _) => return ScanStep::Broken(at),
        (0xFF, _) => {}
    }
    let Some(&length) = bytes.get(at + 2..at + 4).and_then(|it| it.first_chunk()) else {
        return ScanStep::Wait;
    };
    let next = at + 2 + usize::from(u16::from_be_bytes(length));
    if next < at + 4 {
        return ScanStep::Broken(at + 2);
    }
    // A marker must follow, so two more bytes are needed.
    let Some(content) = bytes.get(at + 2..next + 2) else { return ScanStep::Wait };
    // Only application segments and comments may contain a picture, such as a thumbnail.
    let is_added = matches!(marker, 0xE0..=0xEF | 0xFE);
    let begin = content.windows(START.len()).position(|it| it == START);
    match begin.filter(|_| !is_added) {
        Some(begin) => ScanStep::Broken(at + 2 + begin),
        None if marker == 0xDA => ScanStep::On(ScanState::Coded(next)),
        None => ScanStep::On(ScanState::Marker(next)),
    }
}

#[cfg(test)]
mod properties;

#[cfg(test)]
mod tests {
    use jpeg_encoder::{ColorType, Encoder};

    use super::*;

    pub(super) fn jpeg(level: u8) -> Vec<u8> {
        let mut bytes = Vec::new();
        let pixels: Vec<u8> = (0..32 * 24u32).map(|i| (i * 7 % 97) as u8 ^ level).collect();
        Encoder::new(&mut bytes, 90).encode(&pixels, 32, 24, ColorType::Luma).unwrap();
        bytes
    }

    /// Pictures and the number of broken ones in a stream that arrives in chunks of these lengths, repeated.
    pub(super) fn split(stream: &[u8], lengths: &[usize]) -> (Vec<StampedJpeg>, u64) {
        let (mut parts, mut found, mut at) = (JpegSplitter::default(), Vec::new(), 0);
        for length in lengths.iter().cycle() {
            let end = (at + length).min(stream.len());
            parts.push(&stream[at..end], Timestamp::from_ns(at as i64));
            while let Some(part) = parts.pop() {
                // The chunk in which a picture begins depends on the lengths.
                found.push(StampedJpeg { arrival: Timestamp::default(), ..part });
            }
            at = end;
            if at == stream.len() {
                break;
            }
        }
        (found, parts.take_broken())
    }

    /// The same for several lengths of the chunks.
    fn found(stream: &[u8]) -> (Vec<StampedJpeg>, u64) {
        let whole = split(stream, &[stream.len()]);
        for length in [1, 3, 64] {
            assert_eq!(split(stream, &[length]), whole, "chunks of {length} bytes");
        }
        whole
    }

    fn header(text: &str) -> Vec<u8> {
        text.replace('\n', "\r\n").into_bytes()
    }

    fn pictures(stream: &[Vec<u8>]) -> (Vec<Vec<u8>>, u64) {
        let (parts, broken) = found(&stream.concat());
        (parts.into_iter().map(|part| part.jpeg).collect(), broken)
    }

    #[test]
    fn headers_may_be_right_wrong_or_missing() {
        let usual = |n: usize| {
            header(&format!("\n--frame\nContent-Type: image/jpeg\nContent-Length: {n}\n\n"))
        };
        let (a, b, c) = (jpeg(1), jpeg(2), jpeg(3));
        for between in
            [usual(a.len()), usual(9), usual(99_999), header("\n--other\n\n"), Vec::new()]
        {
            let stream = [&between, &a, &between, &b, &between, &c].map(Clone::clone);
            assert_eq!(pictures(&stream), (vec![a.clone(), b.clone(), c.clone()], 0));
        }
    }

    #[test]
    fn stamps_are_taken_to_the_nanosecond() {
        for (text, expected) in [
            ("--b\nX-Timestamp: 12.345678\n\n", Some(12_345_678_000)),
            ("--b\nx-timestamp:1700000000.1234567891\n\n", Some(1_700_000_000_123_456_789)),
            ("--b\nX-Timestamp: 3\n\n", Some(3_000_000_000)),
            ("X-Timestamp: -3.1\n", None),
            ("X-Timestamp: soon\n", None),
            ("X-Timestamp: 1e9\n", None),
            ("--b\n", None),
            ("X-Timestamp: 99999999999999999999\n", None),
        ] {
            let (parts, _) = found(&[header(text), jpeg(0)].concat());
            assert_eq!(parts[0].stamp_ns, expected, "{text}");
        }
    }

    #[test]
    fn an_arrival_is_that_of_the_first_byte() {
        let (picture, mut parts) = (jpeg(1), JpegSplitter::default());
        let at = Timestamp::from_ns;
        parts.push(b"--frame\r\n\r\n", at(1));
        parts.push(&picture[..100], at(2));
        parts.push(&picture[100..], at(3));
        assert_eq!(parts.pop().unwrap().arrival, at(2));
    }

    #[test]
    fn a_picture_that_lost_its_end_is_counted_and_the_next_one_is_whole() {
        let (a, b) = (jpeg(1), jpeg(2));
        for cut in [20, a.len() / 2, a.len() - 2] {
            let (whole, broken) = pictures(&[a[..cut].to_vec(), b.clone(), b.clone()]);
            assert_eq!((whole, broken), (vec![b.clone(), b.clone()], 1), "{cut}");
        }
    }

    #[test]
    fn garbage_is_counted_once_and_survived() {
        let garbage: Vec<u8> =
            (0..50_000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
        let garbage: Vec<u8> = garbage.into_iter().filter(|byte| *byte != 0xFF).collect();
        let a = jpeg(1);
        assert_eq!(pictures(&[a.clone(), garbage, a.clone()]), (vec![a.clone(), a.clone()], 1));
        let text = b"<html>no camera here</html>\n".repeat(1000);
        assert_eq!(pictures(&[text, a.clone()]), (vec![a.clone()], 1));
        // FF D8 FF and no picture behind it.
        let (whole, broken) = pictures(&[vec![0xFF, 0xD8, 0xFF, 0x00, 0x17], a.clone()]);
        assert_eq!((whole, broken), (vec![a], 1));
    }

    #[test]
    fn memory_is_bounded() {
        let mut parts = JpegSplitter::default();
        let endless = [vec![0xFF, 0xD8, 0xFF, 0xDA, 0, 2], vec![7; 1 << 20]].concat();
        for _ in 0..40 {
            parts.push(&endless[6..], Timestamp::default());
        }
        assert!(parts.bytes.len() <= 2 << 20, "{}", parts.bytes.len());
        parts.push(&endless, Timestamp::default());
        for _ in 0..40 {
            parts.push(&endless[6..], Timestamp::default());
            assert!(parts.bytes.len() <= MAX_JPEG + (2 << 20), "{}", parts.bytes.len());
        }
        assert!(parts.take_broken() >= 2);
    }
}
