//! Length-prefixed messages (gRPC's framing), of which only the first fields are decoded.

use prost::encoding::{DecodeContext, WireType, decode_key, decode_varint, skip_field};

use crate::measure::Readings;

const PREFIX_BYTES: usize = 5;
/// Length of the start of a message that contains its times.
const HEAD_BYTES: usize = 160;

/// Splits a stream of bytes into messages, and records each.
pub struct Messages {
    readings: Readings,
    /// The first bytes of the current message, with its prefix.
    head: Vec<u8>,
    /// Number of bytes received of the current message.
    received: usize,
}

impl Messages {
    pub fn new(readings: Readings) -> Self {
        Self { readings, head: Vec::new(), received: 0 }
    }

    pub fn add(&mut self, mut bytes: &[u8]) {
        while !bytes.is_empty() {
            let length = match self.head.get(1..PREFIX_BYTES) {
                Some(&[a, b, c, d]) => PREFIX_BYTES + u32::from_be_bytes([a, b, c, d]) as usize,
                _ => PREFIX_BYTES,
            };
            let (now, rest) = bytes.split_at((length - self.received).min(bytes.len()));
            let kept = now.len().min(HEAD_BYTES.saturating_sub(self.head.len()));
            self.head.extend_from_slice(&now[..kept]);
            self.received += now.len();
            bytes = rest;
            if self.received == length && length > PREFIX_BYTES {
                let (fused_time_ns, missed) = times(&self.head[PREFIX_BYTES..]);
                self.readings.add(fused_time_ns, missed);
                self.head.clear();
                self.received = 0;
            }
        }
    }
}

/// `fused_time_ns` and `missed` of a snapshot that starts with these bytes.
pub fn times(mut bytes: &[u8]) -> (i64, u64) {
    let (mut fused, mut missed) = (0, 0);
    while fused == 0 {
        let (field, kind) = decode_key(&mut bytes).expect("a field");
        match (field, kind) {
            (5, WireType::Varint) => fused = decode_varint(&mut bytes).expect("a time") as i64,
            (8, WireType::Varint) => missed = decode_varint(&mut bytes).expect("a count"),
            _ => skip_field(kind, field, &mut bytes, DecodeContext::default()).expect("a field"),
        }
    }
    (fused, missed)
}
