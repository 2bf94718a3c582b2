//! Subscribers by gRPC that cost as little as they can: HTTP/2 (RFC 9113) by hand, one stream on each connection.

use std::net::SocketAddr;

use prost::{
    Message,
    encoding::{DecodeContext, WireType, decode_key, decode_varint, skip_field},
};
use roundel_proto::v1;
use tokio::{io::AsyncWriteExt, net::TcpStream};

use crate::{Case, arrival::arrive, measure::Readings};

const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
const DATA: u8 = 0;
const HEADERS: u8 = 1;
const SETTINGS: u8 = 4;
const PING: u8 = 6;
const WINDOW_UPDATE: u8 = 8;
const ACK: u8 = 1;
const END_STREAM: u8 = 1;
const END_HEADERS: u8 = 4;
const INITIAL_WINDOW_SIZE: u16 = 4;
/// As large as a window may be: at 3 MB a second it is never used up within a run of ten minutes.
const WINDOW: u32 = 0x7fff_ffff;
const FRAME_HEAD: usize = 9;
/// Where nobody has asked for another.
const MAX_FRAME: usize = 16_384;
/// Of a message, as much as has its times.
const LOOKED_AT: usize = 160;

/// What a subscriber asks for.
pub fn request(case: &Case, number: usize) -> Vec<u8> {
    let side = 1e6 + number as f64;
    let corner = |side| Some(v1::Vector3 { x: side, y: side, z: side });
    let region = v1::Box { min: corner(-side), max: corner(side) };
    let request = v1::SubscribeSnapshotsRequest {
        omit_covariance: !case.covariances,
        region: case.differ.then_some(region),
        ..Default::default()
    };
    prefixed(&request.encode_to_vec())
}

fn prefixed(message: &[u8]) -> Vec<u8> {
    [&[0], (message.len() as u32).to_be_bytes().as_slice(), message].concat()
}

/// A message of a stream as its frames.
pub fn message(message: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for part in prefixed(message).chunks(MAX_FRAME) {
        frame(&mut bytes, DATA, 0, 1, part);
    }
    bytes
}

/// Reads all that comes.
pub async fn read(address: SocketAddr, request: Vec<u8>, readings: Readings) {
    let mut stream = subscribe(address, &request, WINDOW).await;
    let mut parser = Parser { readings, ..Parser::default() };
    let (mut rest, mut answers) = (Vec::new(), Vec::new());
    loop {
        arrive(&mut stream, &mut rest, |bytes| parser.frames(bytes, &mut answers)).await;
        if !answers.is_empty() {
            stream.write_all(&answers).await.expect("a connection");
            answers.clear();
        }
    }
}

/// Subscribes, and never reads.
pub async fn hold(address: SocketAddr, request: Vec<u8>) {
    let stream = subscribe(address, &request, 65_535).await;
    std::future::pending::<()>().await;
    drop(stream);
}

async fn subscribe(address: SocketAddr, request: &[u8], window: u32) -> TcpStream {
    let mut stream = TcpStream::connect(address).await.expect("a connection");
    stream.set_nodelay(true).expect("an option");
    let mut bytes = PREFACE.to_vec();
    let setting = [&INITIAL_WINDOW_SIZE.to_be_bytes()[..], &window.to_be_bytes()].concat();
    frame(&mut bytes, SETTINGS, 0, 0, &setting);
    if window > 65_535 {
        frame(&mut bytes, WINDOW_UPDATE, 0, 0, &(window - 65_535).to_be_bytes());
    }
    frame(&mut bytes, HEADERS, END_HEADERS, 1, &head());
    frame(&mut bytes, DATA, END_STREAM, 1, request);
    stream.write_all(&bytes).await.expect("a connection");
    stream
}

fn frame(bytes: &mut Vec<u8>, kind: u8, flags: u8, stream: u32, payload: &[u8]) {
    bytes.extend_from_slice(&(payload.len() as u32).to_be_bytes()[1..]);
    bytes.extend_from_slice(&[kind, flags]);
    bytes.extend_from_slice(&stream.to_be_bytes());
    bytes.extend_from_slice(payload);
}

/// The request's head in HPACK (RFC 7541): two entries of the static table, and literals that are not kept.
fn head() -> Vec<u8> {
    // :method POST and :scheme http.
    let mut head = vec![0x83, 0x86];
    let mut literal = |name: &[u8], value: &str| {
        head.extend_from_slice(name);
        head.push(value.len() as u8);
        head.extend_from_slice(value.as_bytes());
    };
    literal(&[0x04], "/roundel.v1.Roundel/SubscribeSnapshots");
    literal(&[0x01], "localhost");
    // content-type is entry 31: 15, and 16 more.
    literal(&[0x0f, 0x10], "application/grpc");
    literal(b"\x00\x02te", "trailers");
    head
}

#[derive(Default)]
struct Parser {
    readings: Readings,
    /// What is known of the message that is coming: its head, and its first bytes.
    start: Vec<u8>,
    /// Bytes of it that came.
    come: usize,
}

impl Parser {
    /// Takes whole frames; how many bytes they were.
    fn frames(&mut self, bytes: &[u8], answers: &mut Vec<u8>) -> usize {
        let mut used = 0;
        while let Some(rest) = bytes.get(used..).filter(|rest| rest.len() >= FRAME_HEAD) {
            let length = u32::from_be_bytes([0, rest[0], rest[1], rest[2]]) as usize;
            let Some(payload) = rest.get(FRAME_HEAD..FRAME_HEAD + length) else { break };
            match (rest[3], rest[4] & ACK) {
                (DATA, _) => self.data(payload),
                (SETTINGS, 0) => frame(answers, SETTINGS, ACK, 0, &[]),
                (PING, 0) => frame(answers, PING, ACK, 0, payload),
                _ => {}
            }
            used += FRAME_HEAD + length;
        }
        used
    }

    fn data(&mut self, mut payload: &[u8]) {
        while !payload.is_empty() {
            let wanted = match self.start.get(..5) {
                Some(head) => 5 + u32::from_be_bytes([head[1], head[2], head[3], head[4]]) as usize,
                None => 5,
            };
            let (now, rest) = payload.split_at((wanted - self.come).min(payload.len()));
            let kept = now.len().min(LOOKED_AT.saturating_sub(self.start.len()));
            self.start.extend_from_slice(&now[..kept]);
            self.come += now.len();
            payload = rest;
            if self.come == wanted && wanted > 5 {
                let (fused_time_ns, missed) = looked_into(&self.start[5..]);
                self.readings.add(fused_time_ns, missed);
                self.start.clear();
                self.come = 0;
            }
        }
    }
}

/// `fused_time_ns` and `missed` of a message that begins so.
pub fn looked_into(mut bytes: &[u8]) -> (i64, u64) {
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
