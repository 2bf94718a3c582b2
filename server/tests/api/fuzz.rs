//! Malformed and malicious input: bytes that are no message, corrupted messages, frames with false lengths, and
//! thousands of idle connections. The server survives all of it, and a well-behaved subscriber misses no snapshot.

use std::time::Duration;

use futures::future::join_all;
use prost::Message as _;
use roundel_proto::v1;
use roundel_server::api::ApiLimits;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
    time::timeout,
};
use tonic::Streaming;

use super::{
    grpc,
    rig::{self, Rig, TIMEOUT, objects},
};

/// Xorshift, for the same bytes in every run.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    pub fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound as u64) as usize
    }

    pub fn bytes(&mut self, count: usize) -> Vec<u8> {
        (0..count).map(|_| self.next() as u8).collect()
    }

    /// Changes some bytes, and possibly truncates or extends them.
    pub fn corrupted(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut corrupted = bytes.to_vec();
        for _ in 0..=self.below(3) {
            if !corrupted.is_empty() {
                let place = self.below(corrupted.len());
                corrupted[place] = self.next() as u8;
            }
        }
        match self.below(3) {
            0 => corrupted.truncate(self.below(corrupted.len() + 1)),
            1 => {
                let count = self.below(20);
                corrupted.extend(self.bytes(count));
            }
            _ => {}
        }
        corrupted
    }
}

/// A server with a subscriber that reads every snapshot.
pub struct Bystander {
    pub rig: Rig,
    snapshots: Streaming<v1::Snapshot>,
}

impl Bystander {
    pub async fn new(limits: ApiLimits) -> Self {
        let rig = Rig::start_with(rig::hub("run"), limits, "127.0.0.1:0").await;
        let request = v1::SubscribeSnapshotsRequest::default();
        let mut client = grpc::connect(&rig).await;
        let snapshots = client.subscribe_snapshots(request).await.unwrap().into_inner();
        Self { rig, snapshots }
    }

    /// Checks that the subscriber receives the next snapshot.
    pub async fn is_served(&mut self, after: &str) {
        self.rig.publish(objects(3));
        let snapshot = grpc::next(&mut self.snapshots).await;
        assert_eq!((snapshot.objects.len(), snapshot.missed), (3, 0), "after {after}");
    }

    pub async fn end(mut self) {
        self.is_served("all input").await;
        assert_eq!(self.rig.get("/healthz").await.status, 200);
        self.rig.stop().await;
    }

    async fn connect(&self) -> TcpStream {
        TcpStream::connect(&self.rig.address).await.unwrap()
    }

    /// Sends bytes on a new connection and returns the first bytes of the response; none if the server closes it.
    async fn poke(&self, bytes: &[u8]) -> Vec<u8> {
        let mut stream = self.connect().await;
        // The server may close the connection before it has received everything.
        let _ = stream.write_all(bytes).await;
        let mut answer = vec![0; 4096];
        let read = timeout(TIMEOUT, stream.read(&mut answer)).await.expect("no response arrives");
        answer.truncate(read.unwrap_or_default());
        answer
    }

    /// Sends bytes and waits briefly, for protocols where the server sends first.
    async fn linger(&self, bytes: &[u8]) {
        let mut stream = self.connect().await;
        let _ = stream.write_all(bytes).await;
        let _ = timeout(Duration::from_millis(50), stream.read_to_end(&mut Vec::new())).await;
    }

    async fn post(&self, path: &str, kind: &str, body: &[u8]) -> String {
        let address = &self.rig.address;
        let head = format!(
            "POST {path} HTTP/1.1\r\nhost: {address}\r\ncontent-type: {kind}\r\ncontent-length: {}\r\n\r\n",
            body.len()
        );
        let answer = self.poke(&[head.as_bytes(), body].concat()).await;
        String::from_utf8_lossy(&answer).into_owned()
    }
}

fn framed(message: &[u8]) -> Vec<u8> {
    [&[0], (message.len() as u32).to_be_bytes().as_slice(), message].concat()
}

/// All gRPC calls, and requests that are valid for some of them.
fn calls() -> (Vec<String>, Vec<Vec<u8>>) {
    let contract = include_str!("../../../proto/contract.txt").lines();
    let is_call = |line: &&str| line.starts_with("Roundel.") || line.starts_with("Push.");
    let path = |line: &str| {
        let name = line.split(' ').next().unwrap_or_default().replace('.', "/");
        format!("/roundel.v1.{name}")
    };
    let calls: Vec<String> = contract.filter(is_call).map(path).collect();
    assert!(calls.len() > 20, "{calls:?}");
    let corner = |x| Some(v1::Vector3 { x, y: x, z: f64::INFINITY });
    let subscription = v1::SubscribeSnapshotsRequest {
        object_ids: vec![1, 2, u64::MAX],
        region: Some(v1::Box { min: corner(-1.0), max: corner(1.0) }),
        max_rate_hz: Some(30.0),
        horizon_ms: Some(10.0),
        omit_covariance: true,
        roundels: vec!["robot".into()],
        names: vec!["cart \"one\"".into()],
        codes: vec![v1::Code { bits: 8, number: 2 }],
    };
    let camera = v1::CameraSetup { name: "x".into(), source: "sim:".into(), ..Default::default() };
    let requests = vec![
        subscription.encode_to_vec(),
        v1::AddCameraRequest { camera: Some(camera) }.encode_to_vec(),
        v1::TestSourceRequest { source: "sim:".into(), width: 9, height: 9 }.encode_to_vec(),
        v1::PushRobotRequest { object_id: 1, velocity: corner(1.0), duration_ms: 3.0 }
            .encode_to_vec(),
        // An endless varint, and deeply nested messages.
        vec![0x0a, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f],
        (0..2000_u32).rev().fold(Vec::new(), |inner, _| {
            let mut outer = vec![0x0a];
            prost::encoding::encode_varint(inner.len() as u64, &mut outer);
            outer.extend(inner);
            outer
        }),
    ];
    (calls, requests)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn survives_corrupted_protobuf() {
    let mut bystander = Bystander::new(ApiLimits::default()).await;
    let (calls, requests) = calls();
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    for round in 0..12 {
        let mut bodies = Vec::new();
        for call in &calls {
            let whole = &requests[random.below(requests.len())];
            let count = random.below(300);
            let body = match round % 4 {
                0 => framed(&random.corrupted(whole)),
                1 => random.corrupted(&framed(whole)),
                2 => framed(&random.bytes(count)),
                _ => random.bytes(count),
            };
            let kind =
                ["application/grpc", "application/grpc-web+proto", "application/grpc-web-text"];
            bodies.push((call, kind[random.below(3)], body));
        }
        let pokes = bodies.iter().map(|(call, kind, body)| bystander.post(call, kind, body));
        for (answer, (call, ..)) in join_all(pokes).await.iter().zip(&bodies) {
            // Each request is valid HTTP, so each gets a response.
            let is_one = answer.starts_with("HTTP/1.1 ") && !answer.starts_with("HTTP/1.1 5");
            assert!(is_one, "{call}: {answer:?}");
        }
        bystander.is_served("corrupted protobuf").await;
    }
    bystander.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn rejects_corrupted_json_with_an_error_body() {
    let mut bystander = Bystander::new(ApiLimits::default()).await;
    let mut random = Random(77);
    let texts = [
        r#"{"object_id": 1, "velocity": {"x": 1, "y": 0, "z": 0}, "duration_ms": 500}"#,
        r#"{"robots": [{"object_id": 3, "velocity": {"x": 0.5, "y": 0, "z": 0}}]}"#,
        r#"{"name": "n", "source": "sim:", "pose": {"unknown": true}}"#,
        r#"{"source": "sim:", "width": -1, "height": "many"}"#,
        r#"{"seconds": 1e400, "apply": 7}"#,
    ];
    let nested = "[".repeat(100_000);
    let paths = [
        "/api/v1/simulation/drive",
        "/api/v1/simulation/push",
        "/api/v1/cameras",
        "/api/v1/sources/test",
        "/api/v1/calibration",
    ];
    for round in 0..8 {
        for path in paths {
            let text = texts[random.below(texts.len())].as_bytes();
            let body = match round {
                0 => nested.clone().into_bytes(),
                1 => vec![b'"'; 3_000_000],
                _ => random.corrupted(text),
            };
            let answer = bystander.post(path, "application/json", &body).await;
            // A request that is still valid is a 4xx, too: nothing is simulated, and there is no configuration to change.
            // A client that is still sending when an oversized body is rejected may not see the response.
            let may_be_lost = round == 1 && answer.is_empty();
            assert!(may_be_lost || answer.starts_with("HTTP/1.1 4"), "{path}: {answer:?}");
            assert!(round == 1 || answer.contains("\"error\""), "{path}: {answer}");
        }
        bystander.is_served("corrupted JSON").await;
    }
    bystander.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn malformed_websocket_frames_end_only_their_own_socket() {
    let mut bystander = Bystander::new(ApiLimits::default()).await;
    let ask = format!(
        "GET /api/v1/stream HTTP/1.1\r\nhost: {}\r\nconnection: upgrade\r\nupgrade: websocket\r\n\
         sec-websocket-version: 13\r\nsec-websocket-key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n",
        bystander.rig.address
    );
    let mut random = Random(4711);
    let masked = |head: &[u8], payload: &[u8]| [head, &[0, 0, 0, 0], payload].concat();
    let mut all = vec![
        // Unmasked; reserved bits; an unknown opcode; false lengths; a text that is not UTF-8.
        vec![0x81, 0x02, b'h', b'i'],
        masked(&[0xf1, 0x82], b"hi"),
        masked(&[0x83, 0x82], b"hi"),
        masked(&[0x82, 0xff, 0x7f, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff], b""),
        masked(&[0x82, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff], b""),
        masked(&[0x81, 0x82], &[0xc3, 0x28]),
        // A continuation without a start, an oversized ping, a close frame with half a code.
        masked(&[0x80, 0x80], b""),
        masked(&[0x89, 0xfe, 0x00, 0xff], &[0; 255]),
        masked(&[0x88, 0x81], &[3]),
        // An endless fragmented message.
        [masked(&[0x01, 0x80], b""), masked(&[0x00, 0xfe, 0xea, 0x60], &[b' '; 60_000]).repeat(4)]
            .concat(),
        masked(&[0x89, 0x80], b"").repeat(5000),
    ];
    all.extend((0..60).map(|_| {
        let count = 2 + random.below(400);
        random.bytes(count)
    }));
    for frames in all {
        let mut socket = bystander.connect().await;
        socket.write_all(ask.as_bytes()).await.unwrap();
        let mut answer = [0; 12];
        timeout(TIMEOUT, socket.read_exact(&mut answer)).await.unwrap().unwrap();
        assert_eq!(&answer, b"HTTP/1.1 101");
        // The server may close the socket while the frames are sent.
        let _ = socket.write_all(&frames).await;
        bystander.is_served("malformed frames").await;
    }
    bystander.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn malformed_http2_ends_only_its_own_connection() {
    let mut bystander = Bystander::new(ApiLimits::default()).await;
    let mut random = Random(99);
    let preface = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".to_vec();
    let frame = |kind: u8, flags: u8, stream: u32, payload: &[u8]| {
        let length = &(payload.len() as u32).to_be_bytes()[1..];
        [length, &[kind, flags], &stream.to_be_bytes(), payload].concat()
    };
    let begin = [preface.clone(), frame(4, 0, 0, &[])].concat();
    // A request of three entries of the static table: POST, http, and the path "/".
    let request = |stream| frame(1, 4, stream, &[0x83, 0x86, 0x84]);
    let resets = (0..3000_u32).flat_map(|number| {
        let stream = 2 * number + 1;
        [request(stream), frame(3, 0, stream, &[0, 0, 0, 8])].concat()
    });
    let mut all = vec![
        [begin.clone(), resets.collect()].concat(),
        [begin.clone(), frame(4, 0, 0, &[0, 4, 0xff, 0xff, 0xff, 0xff])].concat(),
        [begin.clone(), frame(4, 0, 0, &[]).repeat(5000)].concat(),
        [begin.clone(), frame(6, 0, 0, &[7; 8]).repeat(5000)].concat(),
        // An endless header, an empty one, and window updates of zero and beyond the maximum.
        [begin.clone(), frame(1, 0, 1, &[0x82]), frame(9, 0, 1, &[0x40; 16_000]).repeat(40)]
            .concat(),
        [begin.clone(), frame(1, 5, 1, &[])].concat(),
        [begin.clone(), frame(8, 0, 0, &[0; 4])].concat(),
        [begin.clone(), frame(8, 0, 0, &[0x7f, 0xff, 0xff, 0xff]).repeat(3)].concat(),
        [begin.clone(), frame(0, 1, 77, &[1; 100])].concat(),
    ];
    all.extend((0..60).map(|_| {
        let (kind, flags, stream) = (random.below(12) as u8, random.next() as u8, random.below(4));
        let count = random.below(200);
        let payload = random.bytes(count);
        [begin.clone(), frame(kind, flags, stream as u32, &payload)].concat()
    }));
    for bytes in &all {
        bystander.linger(bytes).await;
        bystander.is_served("malformed HTTP/2").await;
    }
    bystander.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn thousands_of_idle_connections_take_no_slots() {
    let mut bystander =
        Bystander::new(ApiLimits { max_clients: 300, ..ApiLimits::default() }).await;
    let mut held = Vec::new();
    for number in 0..3000 {
        let mut stream = bystander.connect().await;
        let said: &[u8] = match number % 3 {
            0 => b"",
            1 => b"P",
            _ => b"PRI * HTTP/2.0\r\n",
        };
        let _ = stream.write_all(said).await;
        held.push(stream);
        if number % 100 == 0 {
            bystander.is_served("half-open connections").await;
        }
    }
    // All idle connections are still open.
    assert_eq!(bystander.rig.get("/api/v1/info").await.status, 200);
    bystander.end().await;
    drop(held);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_incomplete_request_is_closed_after_the_timeout() {
    let halves: [&[u8]; 6] = [
        b"",
        b"PRI",
        b"GET /api/v1/info HTTP/1.1\r\nhost: localhost\r\n",
        b"POST /api/v1/calibration HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: 10\r\n\r\n{",
        b"POST /roundel.v1.Roundel/GetInfo HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/grpc-web\r\ncontent-length: 10\r\n\r\n",
        // HTTP/2 whose pings are not answered.
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\x00\x00\x00\x04\x00\x00\x00\x00\x00",
    ];
    let limits = ApiLimits {
        max_clients: 6,
        request_timeout: Duration::from_millis(300),
        ..ApiLimits::default()
    };
    let bystander = Bystander::new(limits).await;
    let end = async |half: &[u8]| {
        let mut stream = bystander.connect().await;
        stream.write_all(half).await.unwrap();
        let mut rest = Vec::new();
        let ended = timeout(TIMEOUT, stream.read_to_end(&mut rest)).await;
        assert!(ended.is_ok(), "still open: {}", String::from_utf8_lossy(half));
    };
    join_all(halves.map(end)).await;
    bystander.end().await;
}
