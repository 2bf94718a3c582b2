//! Messages and frames of a WebSocket client.

use std::{sync::LazyLock, time::Duration};

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::{rt::TokioIo, service::TowerToHyperService};
use roundel_server::api;
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _, DuplexStream, duplex, split},
    runtime::Runtime,
    time::timeout,
};

use super::lab;

/// Only a stalled machine reaches it.
const PATIENCE: Duration = Duration::from_secs(60);
/// Longer messages end the socket.
const MAX_MESSAGE_BYTES: usize = 200_000;
const TEXT: u8 = 0x81;
const BINARY: u8 = 0x82;
const CLOSE: u8 = 0x88;
/// A message whose error shows that the one before it was handled.
const MARKER: &str = r#"{"snapshots": {"roundels": ["marker"]}}"#;

struct Lab {
    runtime: Runtime,
    router: Router,
}

static LAB: LazyLock<Lab> =
    LazyLock::new(|| Lab { runtime: lab::runtime(), router: api::http_router(lab::api().into()) });

/// The socket stays open after any message, and ends after any bytes that are no frames. The first byte selects: bit 0
/// the protobuf encoding, bit 1 bytes instead of a message.
pub fn run(data: &[u8]) {
    let Some((mode, content)) = data.split_first() else { return };
    let Lab { runtime, router } = &*LAB;
    let (is_protobuf, is_raw) = (mode & 1 != 0, mode & 2 != 0);
    if content.len() > MAX_MESSAGE_BYTES {
        return;
    }
    let sent = if is_raw {
        [content, &frame(CLOSE, &[])].concat()
    } else {
        let is_text = !is_protobuf && str::from_utf8(content).is_ok();
        let opcode = if is_text { TEXT } else { BINARY };
        [frame(opcode, content), frame(TEXT, MARKER.as_bytes()), frame(CLOSE, &[])].concat()
    };
    let received = runtime.block_on(async {
        timeout(PATIENCE, converse(router.clone(), is_protobuf, sent)).await.expect("it stays open")
    });
    let text = String::from_utf8_lossy(&received);
    assert!(text.starts_with("HTTP/1.1 101"), "{text}");
    assert!(is_raw || text.contains("any of robot, cart, found"), "{text}");
}

/// A masked frame; the key is 0.
fn frame(first_byte: u8, content: &[u8]) -> Vec<u8> {
    let mut frame = vec![first_byte, 0xFF];
    frame.extend((content.len() as u64).to_be_bytes());
    frame.extend([0; 4]);
    frame.extend(content);
    if content.is_empty() {
        // A control frame has a short length.
        frame.splice(1..10, [0x80]);
    }
    frame
}

/// Everything that the server sends to a client that sends these bytes on the open socket.
async fn converse(router: Router, is_protobuf: bool, sent: Vec<u8>) -> Vec<u8> {
    let (client, server): (DuplexStream, DuplexStream) = duplex(1 << 16);
    let service = TowerToHyperService::new(router);
    let connection = http1::Builder::new().serve_connection(TokioIo::new(server), service);
    let connection = tokio::spawn(connection.with_upgrades());
    let (mut reader, mut writer) = split(client);
    let protocol = if is_protobuf { "roundel.v1.protobuf" } else { "roundel.v1.json" };
    let head = format!(
        "GET /api/v1/stream HTTP/1.1\r\nhost: lab\r\nconnection: upgrade\r\nupgrade: websocket\r\n\
         sec-websocket-version: 13\r\nsec-websocket-key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\
         sec-websocket-protocol: {protocol}\r\n\r\n"
    );
    writer.write_all(head.as_bytes()).await.unwrap();
    let mut received = Vec::new();
    // The first frame may arrive with the head.
    let has_head = |received: &[u8]| received.windows(4).any(|it| it == b"\r\n\r\n");
    while !has_head(&received) && reader.read_buf(&mut received).await.unwrap() > 0 {}
    let write = async {
        // The server may end the socket earlier.
        let _ = writer.write_all(&sent).await;
        let _ = writer.shutdown().await;
    };
    let _ = tokio::join!(write, reader.read_to_end(&mut received));
    let _ = connection.await;
    received
}
