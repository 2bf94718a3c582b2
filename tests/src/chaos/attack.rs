//! Hostile and greedy clients.

use std::{net::SocketAddr, time::Duration};

use anyhow::{Context, ensure};
use futures::{StreamExt, future::join_all, stream};
use roundel_client::{Client, Subscription};
use roundel_proto::v1::{
    self, push_client::PushClient, push_request, roundel_client::RoundelClient,
};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
    time::{sleep, timeout},
};
use tonic::transport::{Channel, Endpoint};

use super::{
    timetable::Fault,
    world::{CODED, SPARE_CAMERA},
};
use crate::random::Random;

/// Time for which an attacker stays.
const STAY: Duration = Duration::from_secs(3);
/// Longer than any message that the server accepts.
const OVERSIZED_BYTES: usize = 20 << 20;
/// Connections of [`Fault::Garbage`].
const GARBAGE_CONNECTIONS: usize = 8;

/// Runs an attack. Fails if the server accepts what it must reject; an attack that cannot connect has no effect.
pub async fn attack(fault: Fault, address: SocketAddr, seed: u64) -> anyhow::Result<()> {
    match fault {
        Fault::FloodConnections { count } => flood_connections(address, count).await,
        Fault::FloodSubscriptions { count } => flood_subscriptions(address, count).await,
        Fault::Garbage => send_garbage(address, seed).await,
        Fault::SlowReaders { count } => read_nothing(address, count).await,
        Fault::Oversized => return send_oversized(address).await,
        Fault::BadHost => return send_bad_host(address).await,
        Fault::HostileSender => send_nonsense(address).await,
        _ => {}
    }
    Ok(())
}

/// Opens a second stream for a camera; `name` must have a sender already, or accepts this one until it ends at once.
pub async fn duplicate_sender(address: SocketAddr, camera: String) {
    let Some(channel) = channel(address).await else { return };
    let requests = stream::iter([greeting(&camera)]);
    if let Ok(answers) = PushClient::new(channel).send(requests).await {
        let _ = timeout(STAY, answers.into_inner().next()).await;
    }
}

async fn channel(address: SocketAddr) -> Option<Channel> {
    let endpoint = Endpoint::from_shared(format!("http://{address}")).ok()?;
    timeout(STAY, endpoint.connect()).await.ok()?.ok()
}

async fn flood_connections(address: SocketAddr, count: usize) {
    let mut connections = Vec::new();
    for index in 0..count {
        let Ok(mut socket) = TcpStream::connect(address).await else { continue };
        // A third sends nothing, a third half a preface, a third half a request.
        let begin: &[u8] =
            [&b""[..], b"PRI * HTTP/2.0\r\n", b"GET /api/v1/objects HTTP/1.1\r\nHo"][index % 3];
        let _ = socket.write_all(begin).await;
        connections.push(socket);
    }
    sleep(STAY).await;
}

async fn flood_subscriptions(address: SocketAddr, count: usize) {
    let Ok(client) = Client::connect_lazily(&format!("http://{address}")) else { return };
    let each = (0..count).map(|index| {
        let edge_m = index as f64 * 0.01;
        let subscription = Subscription::default().region([-edge_m; 3], [edge_m; 3]);
        let mut snapshots = client.snapshots(subscription);
        async move { while let Some(Ok(_)) = snapshots.next().await {} }
    });
    let _ = timeout(STAY, join_all(each)).await;
}

async fn send_garbage(address: SocketAddr, seed: u64) {
    let each = (0..GARBAGE_CONNECTIONS).map(|index| async move {
        let mut random = Random::new(seed, index as u64);
        let Ok(mut socket) = TcpStream::connect(address).await else { return };
        let begin: &[u8] =
            [&b""[..], b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", b"\x16\x03\x01", b"GET "][index % 4];
        let mut bytes = begin.to_vec();
        bytes.extend((0..512).flat_map(|_| random.next_u64().to_le_bytes()));
        let _ = socket.write_all(&bytes).await;
        let _ = timeout(STAY, socket.read(&mut bytes)).await;
    });
    join_all(each).await;
}

async fn read_nothing(address: SocketAddr, count: usize) {
    let mut streams = Vec::new();
    for _ in 0..count {
        let Some(channel) = channel(address).await else { continue };
        let request = v1::SubscribeSnapshotsRequest::default();
        if let Ok(stream) = RoundelClient::new(channel).subscribe_snapshots(request).await {
            streams.push(stream);
        }
    }
    sleep(STAY).await;
}

async fn send_oversized(address: SocketAddr) -> anyhow::Result<()> {
    let Some(channel) = channel(address).await else { return Ok(()) };
    let name = "n".repeat(OVERSIZED_BYTES);
    let object = v1::ObjectSetup { name, roundel: CODED.into(), ..Default::default() };
    let request = v1::AddObjectRequest { object: Some(object) };
    let mut client = RoundelClient::new(channel.clone());
    let answer = timeout(STAY, client.add_object(request)).await;
    ensure!(!matches!(answer, Ok(Ok(_))), "a name of {OVERSIZED_BYTES} bytes was accepted");
    let pixels = vec![0; OVERSIZED_BYTES];
    let picture = v1::GreyPicture { width: 5000, height: 4194, pixels };
    let picture = Some(v1::pushed_frame::Picture::Grey(picture));
    let frame = v1::PushedFrame { sequence: 1, picture, ..Default::default() };
    push(channel, vec![push_request::Message::Frame(frame)]).await;
    Ok(())
}

async fn send_bad_host(address: SocketAddr) -> anyhow::Result<()> {
    let Ok(mut socket) = TcpStream::connect(address).await else { return Ok(()) };
    let request =
        b"GET /api/v1/objects HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n";
    let mut answer = Vec::new();
    let exchange = async {
        socket.write_all(request).await?;
        socket.read_to_end(&mut answer).await
    };
    let _ = timeout(STAY, exchange).await;
    let answer = String::from_utf8_lossy(&answer);
    let is_rejected = answer.is_empty() || answer.starts_with("HTTP/1.1 421");
    ensure!(is_rejected, "a foreign host name was not rejected: {answer}");
    Ok(())
}

/// Feeds the spare camera with repeated, old and impossible observations, and leaves without an end.
async fn send_nonsense(address: SocketAddr) {
    let Some(channel) = channel(address).await else { return };
    let observations = |sequence: u64, capture_time_ns: i64, value: f64| {
        let point = Some(v1::PixelPoint { u: value, v: value });
        let rim = v1::Ellipse {
            center: point,
            semi_major_px: value,
            semi_minor_px: value,
            angle_rad: 0.0,
        };
        let detection = v1::Detection {
            track: 1,
            roundel: CODED.into(),
            outer: Some(rim),
            inner: Some(rim),
            capture_time_ns,
            ..Default::default()
        };
        let frame = v1::FrameObservations {
            capture_time_ns,
            detections: vec![detection; 50],
            ..Default::default()
        };
        push_request::Message::Observations(v1::PushedObservations {
            sequence,
            observations: Some(frame),
            ..Default::default()
        })
    };
    let cases =
        [(1, 0, 5.0), (1, 0, 5.0), (1, i64::MAX, 6.0), (u64::MAX, i64::MIN, 7.0), (2, 0, f64::NAN)];
    for skip in 0..cases.len() {
        let messages = cases[skip..].iter().map(|case| observations(case.0, case.1, case.2));
        push(channel.clone(), messages.collect()).await;
    }
}

fn greeting(camera: &str) -> v1::PushRequest {
    let greeting = v1::PushGreeting {
        camera: camera.into(),
        sender: "hostile".into(),
        run_id: "hostile".into(),
        next_sequence: 1,
        ..Default::default()
    };
    v1::PushRequest { message: Some(push_request::Message::Greeting(greeting)) }
}

async fn push(channel: Channel, messages: Vec<push_request::Message>) {
    let messages = messages.into_iter().map(|it| v1::PushRequest { message: Some(it) });
    let requests = stream::iter(std::iter::once(greeting(SPARE_CAMERA)).chain(messages));
    let mut client = PushClient::new(channel);
    let exchange = async {
        let mut answers = client.send(requests).await.context("rejected")?.into_inner();
        while let Some(Ok(_)) = answers.next().await {}
        anyhow::Ok(())
    };
    let _ = timeout(Duration::from_secs(1), exchange).await;
}
