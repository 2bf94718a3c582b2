//! The demo with the real binary, the Rust client, a WebSocket and REST at the same time, and its stop by a signal
//! while clients are connected.

use std::time::Duration;

use anyhow::{Context, ensure};
use futures::StreamExt;
use roundel_client::{Client, Subscription, Update};
use roundel_proto::v1::{LifeStage, Snapshot};
use roundel_tests::process::Server;
use serde_json::Value;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
    time::timeout,
};
use tokio_tungstenite::{connect_async, tungstenite::Message};

const ROBOTS: usize = 24;
/// Long enough for a loaded machine. No test asserts durations.
const PATIENCE: Duration = Duration::from_secs(60);

fn tracked(snapshot: &Snapshot) -> usize {
    let is_tracked = |stage| stage == LifeStage::Tracked as i32;
    snapshot.objects.iter().filter(|object| is_tracked(object.stage)).count()
}

async fn next(
    snapshots: &mut (impl futures::Stream<Item = Result<Update, roundel_client::Error>> + Unpin),
) -> anyhow::Result<Snapshot> {
    loop {
        let update = timeout(PATIENCE, snapshots.next()).await.context("no snapshot")?;
        if let Update::Snapshot(snapshot) = update.context("the stream ended")?? {
            return Ok(snapshot);
        }
    }
}

async fn get(address: &str, path: &str) -> anyhow::Result<(u16, String)> {
    let mut stream = TcpStream::connect(address).await?;
    let request = format!("GET {path} HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).await?;
    let mut answer = Vec::new();
    timeout(PATIENCE, stream.read_to_end(&mut answer)).await??;
    let answer = String::from_utf8_lossy(&answer).into_owned();
    let status = answer.split(' ').nth(1).context("no status line")?.parse()?;
    Ok((status, answer))
}

#[tokio::test(flavor = "multi_thread")]
async fn every_interface_shows_the_same_robots_and_closes_on_a_signal() -> anyhow::Result<()> {
    let folder = tempfile::tempdir()?;
    let mut server = Server::start(&["demo", "--listen", "127.0.0.1:0"], folder.path())?;

    let client = Client::connect(&server.url()).await?;
    let mut snapshots = client.snapshots(Subscription::default());
    let mut snapshot = next(&mut snapshots).await?;
    for _ in 0..3_000 {
        if tracked(&snapshot) >= ROBOTS {
            break;
        }
        snapshot = next(&mut snapshots).await?;
    }
    ensure!(tracked(&snapshot) >= ROBOTS, "{} tracked\n{}", tracked(&snapshot), server.log());
    for object in &snapshot.objects {
        ensure!(object.covariance.len() == 21, "{object:?}");
        ensure!(object.covariance.iter().all(|number| number.is_finite()), "{object:?}");
    }
    // Three cameras may see all robots before the fourth has rendered its floor.
    let mut cameras = client.cameras().await?;
    for _ in 0..3_000 {
        if cameras.iter().all(|camera| camera.frames > 0) {
            break;
        }
        next(&mut snapshots).await?;
        cameras = client.cameras().await?;
    }
    assert_eq!(cameras.len(), 4);
    assert!(cameras.iter().all(|camera| camera.frames > 0), "{cameras:?}");

    let url = format!("ws://{}/api/v1/stream?include=snapshots,cameras", server.address());
    let (mut socket, _) = connect_async(url).await?;
    let (mut newer, mut shown) = (false, false);
    while !(newer && shown) {
        let message = timeout(PATIENCE, socket.next()).await?.context("the socket closed")??;
        let Message::Text(text) = message else { continue };
        let message: Value = serde_json::from_str(&text)?;
        newer |= message["snapshot"]["sequence"].as_u64() > Some(snapshot.sequence);
        shown |= message["cameras"].as_array().is_some_and(|cameras| cameras.len() == 4);
        if let Some(source) = message["snapshot"]["source_id"].as_str() {
            assert_eq!(source, snapshot.source_id);
        }
    }

    for path in ["/", "/healthz", "/readyz", "/metrics", "/openapi.json", "/api/v1/objects"] {
        let (status, answer) = get(server.address(), path).await?;
        ensure!(status == 200, "{path}: {answer}");
    }
    let (status, answer) = get(server.address(), "/api/v1/cameras/nowhere").await?;
    ensure!(status == 404 && answer.contains("camera-0"), "{answer}");

    server.signal("INT")?;
    let exit = server.wait(PATIENCE)?;
    ensure!(exit.success(), "{exit}\n{}", server.log());
    Ok(())
}
