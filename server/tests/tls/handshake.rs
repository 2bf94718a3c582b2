//! Handshakes, plain connections on the same port, and clients that do not complete one.

use std::time::{Duration, Instant};

use futures::{SinkExt, StreamExt};
use roundel_server::api::{ApiLimits, tls::Tls};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
    time::timeout,
};
use tokio_tungstenite::tungstenite::Message;

use super::rig::{Rig, TIMEOUT, client_config, connect, get, serve};

#[tokio::test]
async fn tls_and_plain_connections_share_a_port() {
    let rig = Rig::start().await;
    let mut plain = TcpStream::connect(&rig.address).await.unwrap();
    assert!(get(&mut plain).await.unwrap().starts_with("HTTP/1.1 200"));
    let config = client_config(&rig.authority.pem(), None, &[]);
    let mut encrypted = connect(&rig.address, config).await.unwrap();
    assert!(get(&mut encrypted).await.unwrap().starts_with("HTTP/1.1 200"));
    rig.stop().await;
}

#[tokio::test]
async fn alpn_selects_http_2_or_http_1() {
    let rig = Rig::start().await;
    for (offered, chosen) in [
        (&["h2", "http/1.1"][..], Some("h2")),
        (&["http/1.1"], Some("http/1.1")),
        (&["http/1.1", "h2"], Some("h2")),
        (&[], None),
    ] {
        let config = client_config(&rig.authority.pem(), None, offered);
        let stream = connect(&rig.address, config).await.unwrap();
        let selected = stream.get_ref().1.alpn_protocol().map(|it| str::from_utf8(it).unwrap());
        assert_eq!(selected, chosen, "{offered:?}");
    }
    // No common protocol.
    let config = client_config(&rig.authority.pem(), None, &["smtp"]);
    let error = connect(&rig.address, config).await.unwrap_err().to_string();
    assert!(error.contains("NoApplicationProtocol"), "{error}");
    rig.stop().await;
}

#[tokio::test]
async fn a_preface_in_small_pieces_is_recognized() {
    let rig = Rig::start().await;
    let config = client_config(&rig.authority.pem(), None, &["h2"]);
    let mut stream = connect(&rig.address, config).await.unwrap();
    for piece in [&b"PRI * H"[..], b"TTP/2.0\r\n\r\nSM\r\n\r\n", &[0, 0, 0, 4, 0, 0, 0, 0, 0]] {
        stream.write_all(piece).await.unwrap();
        stream.flush().await.unwrap();
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    // The server's SETTINGS frame: length, type 4.
    let mut head = [0; 9];
    timeout(TIMEOUT, stream.read_exact(&mut head)).await.unwrap().unwrap();
    assert_eq!(head[3], 4, "{head:?}");
    rig.stop().await;
}

#[tokio::test]
async fn a_websocket_is_served_over_tls() {
    let rig = Rig::start().await;
    let config = client_config(&rig.authority.pem(), None, &["http/1.1"]);
    let stream = connect(&rig.address, config).await.unwrap();
    let url = format!("wss://{}/api/v1/stream?include=events", rig.address);
    let opening = tokio_tungstenite::client_async(url, stream);
    let (mut socket, _) = timeout(TIMEOUT, opening).await.unwrap().unwrap();
    socket.send(Message::Ping("ping".into())).await.unwrap();
    loop {
        match timeout(TIMEOUT, socket.next()).await.unwrap().unwrap().unwrap() {
            Message::Pong(payload) => break assert_eq!(&payload[..], b"ping"),
            _ => continue,
        }
    }
    rig.stop().await;
}

#[tokio::test]
async fn a_server_without_a_certificate_answers_a_hello_with_an_alert() {
    let (address, cancel, server) = serve(Tls::default(), ApiLimits::default()).await;
    let authority = super::authority::Authority::new("any");
    let config = client_config(&authority.pem(), None, &[]);
    let error = connect(&address, config).await.unwrap_err().to_string();
    assert!(error.contains("alert"), "{error}");
    let mut plain = TcpStream::connect(&address).await.unwrap();
    assert!(get(&mut plain).await.unwrap().starts_with("HTTP/1.1 200"));
    cancel.cancel();
    timeout(TIMEOUT, server).await.unwrap().unwrap();
}

#[tokio::test]
async fn a_client_that_stalls_in_the_handshake_is_disconnected() {
    let limits = ApiLimits { request_timeout: Duration::from_millis(300), ..ApiLimits::default() };
    let rig = Rig::start_with(false, limits).await;
    // The beginning of a handshake record of 512 bytes, and a handshake followed by silence.
    let mut half = TcpStream::connect(&rig.address).await.unwrap();
    half.write_all(&[0x16, 3, 1, 2, 0, 1, 0]).await.unwrap();
    let config = client_config(&rig.authority.pem(), None, &["h2"]);
    let mut silent = connect(&rig.address, config).await.unwrap();
    let mut buffer = Vec::new();
    let begin = Instant::now();
    let _ = timeout(TIMEOUT, half.read_to_end(&mut buffer)).await.expect("half a hello is kept");
    let _ = timeout(TIMEOUT, silent.read_to_end(&mut buffer)).await.expect("silence is kept");
    assert!(begin.elapsed() < TIMEOUT / 2);
    rig.stop().await;
}

#[tokio::test]
async fn garbage_after_the_first_byte_ends_the_connection_only() {
    let rig = Rig::start().await;
    for garbage in [vec![0x16; 400], [&[0x16, 3, 1, 0, 5][..], &[0xff; 300]].concat()] {
        let mut stream = TcpStream::connect(&rig.address).await.unwrap();
        stream.write_all(&garbage).await.unwrap();
        let mut answer = Vec::new();
        let _ = timeout(TIMEOUT, stream.read_to_end(&mut answer)).await.expect("garbage is kept");
        // An alert record at most.
        assert!(answer.is_empty() || answer[0] == 0x15, "{answer:?}");
    }
    let mut stream =
        connect(&rig.address, client_config(&rig.authority.pem(), None, &[])).await.unwrap();
    assert!(get(&mut stream).await.unwrap().starts_with("HTTP/1.1 200"));
    rig.stop().await;
}

#[tokio::test]
async fn a_client_that_does_not_read_is_disconnected() {
    let limits = ApiLimits { send_timeout: Duration::from_millis(300), ..ApiLimits::default() };
    let rig = Rig::start_with(false, limits).await;
    let config = client_config(&rig.authority.pem(), None, &[]);
    let mut stream = connect(&rig.address, config).await.unwrap();
    // Requests without end, whose responses are not read, fill the buffers of both sides.
    let request = b"GET /openapi.json HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n";
    let flood = async { while stream.write_all(request).await.is_ok() {} };
    timeout(TIMEOUT, flood).await.expect("a client that reads nothing stays connected");
    rig.stop().await;
}
