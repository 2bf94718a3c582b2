//! WebSocket clients of minimal cost: RFC 6455 by hand, and only the first fields of each message are decoded.

use std::net::SocketAddr;

use tokio::{io::AsyncWriteExt, net::TcpStream};

use crate::{Case, arrival::read_some, measure::Readings, messages};

const BINARY: u8 = 2;
const PING: u8 = 9;
const PONG: u8 = 10;
/// Length of the start of a message that contains its times.
const HEAD_BYTES: usize = 512;

pub async fn read(address: SocketAddr, case: Case, readings: Readings) {
    let mut stream = TcpStream::connect(address).await.expect("a connection");
    stream.set_nodelay(true).expect("an option");
    let ask = format!(
        "GET /api/v1/stream?omit_covariance={} HTTP/1.1\r\nhost: {address}\r\nconnection: upgrade\r\n\
         upgrade: websocket\r\nsec-websocket-version: 13\r\nsec-websocket-key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\
         sec-websocket-protocol: {}\r\n\r\n",
        !case.covariances,
        if case.protobuf { "roundel.v1.protobuf" } else { "roundel.v1.json" }
    );
    stream.write_all(ask.as_bytes()).await.expect("a connection");
    let (mut rest, mut is_open, mut pongs) = (Vec::new(), false, Vec::new());
    loop {
        let take = |bytes: &[u8]| {
            let mut used = 0;
            if !is_open {
                let Some(end) = bytes.windows(4).position(|four| four == b"\r\n\r\n") else {
                    return 0;
                };
                assert!(bytes.starts_with(b"HTTP/1.1 101"), "no WebSocket");
                (used, is_open) = (end + 4, true);
            }
            while let Some((opcode, payload, length)) = frame(&bytes[used..]) {
                if opcode == PING {
                    // An empty pong, masked with zeros.
                    pongs.extend_from_slice(&[0x80 | PONG, 0x80, 0, 0, 0, 0]);
                } else if opcode == BINARY {
                    // A StreamMessage with a snapshot: skips its key and its length of three bytes.
                    let (fused_time_ns, missed) = messages::times(&payload[4..]);
                    readings.add(fused_time_ns, missed);
                } else if let Some((fused_time_ns, missed)) = times(payload) {
                    readings.add(fused_time_ns, missed);
                }
                used += length;
            }
            used
        };
        read_some(&mut stream, &mut rest, take).await;
        if !pongs.is_empty() {
            stream.write_all(&pongs).await.expect("a connection");
            pongs.clear();
        }
    }
}

/// The first frame, if it is complete: opcode, payload, and total length.
fn frame(bytes: &[u8]) -> Option<(u8, &[u8], usize)> {
    let (head, length) = match *bytes.get(1)? {
        126 => (4, usize::from(u16::from_be_bytes(bytes.get(2..4)?.try_into().ok()?))),
        127 => (10, u64::from_be_bytes(bytes.get(2..10)?.try_into().ok()?) as usize),
        short => (2, usize::from(short)),
    };
    Some((bytes[0] & 0x0f, bytes.get(head..head + length)?, head + length))
}

fn times(message: &[u8]) -> Option<(i64, u64)> {
    let text = std::str::from_utf8(message.get(..message.len().min(HEAD_BYTES))?).ok()?;
    let number = |key: &str| {
        let (_, rest) = text.split_once(key)?;
        rest.split(|c: char| !c.is_ascii_digit()).next()?.parse::<u64>().ok()
    };
    Some((number("\"fused_time_ns\":\"")? as i64, number("\"missed\":")?))
}
