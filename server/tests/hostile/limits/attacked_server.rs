//! A server in a process of its own, which an honest program feeds and an honest client watches during attacks.

use std::{
    fs::{self, File},
    io::{BufRead, BufReader},
    process::{Child, ChildStdout, Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use axum::{body::Bytes, http::uri::PathAndQuery};
use bytes::{Buf as _, BufMut as _};
use futures::{Stream, StreamExt as _, stream};
use prost::Message as _;
use roundel_client::{Client, PushOptions};
use roundel_core::camera::{Camera, Intrinsics, Lens};
use roundel_proto::v1::{self, roundel_client::RoundelClient};
use roundel_server::model::camera_file;
use tokio::{
    task::JoinSet,
    time::{sleep, timeout},
};
use tonic::{
    Status, Streaming,
    client::Grpc,
    codec::{Codec, DecodeBuf, Decoder, EncodeBuf, Encoder},
    transport::Channel,
};

/// Timeout of every wait; only a stalled machine reaches it.
pub const TIMEOUT: Duration = Duration::from_secs(120);
/// Cameras that attackers may feed, named `a0`, `a1` and so on.
pub const ATTACKED_CAMERAS: usize = 14;
/// Objects that the honest program sees.
const OBJECTS: usize = 30;
/// Time that a pushed stream stays open unless the server ends it.
const PUSH_TIME: Duration = Duration::from_secs(5);
const FEED_INTERVAL: Duration = Duration::from_millis(33);
/// Time without an attack that one is compared with.
const REFERENCE: Duration = Duration::from_secs(3);
/// The machine is shared, so one of several attempts must succeed.
const ATTEMPTS: usize = 3;
const MIN_SHARE: f64 = 0.8;
const MAX_GROWTH_MB: f64 = 300.0;

pub struct AttackedServer {
    process: Child,
    _stdout: BufReader<ChildStdout>,
    pub address: String,
    folder: tempfile::TempDir,
    snapshots: Arc<AtomicU64>,
    _honest: JoinSet<()>,
}

impl Drop for AttackedServer {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl AttackedServer {
    pub async fn start() -> Self {
        Self::start_with("").await
    }

    /// Starts a server with these lines after its configuration.
    pub async fn start_with(more: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("lab.toml"), configuration() + more).unwrap();
        fs::write(folder.path().join("camera.yaml"), camera_file::write("a", &lens())).unwrap();
        let mut process = Command::new(env!("CARGO_BIN_EXE_roundel"))
            .args(["serve", "--config"])
            .arg(folder.path().join("lab.toml"))
            .stdout(Stdio::piped())
            .stderr(File::create(folder.path().join("log")).unwrap())
            .spawn()
            .unwrap();
        let mut stdout = BufReader::new(process.stdout.take().unwrap());
        let mut line = String::new();
        stdout.read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("listening on http://").expect(&line).to_owned();
        let snapshots = Arc::new(AtomicU64::new(0));
        let mut honest = JoinSet::new();
        honest.spawn(feed(address.clone()));
        honest.spawn(watch(address.clone(), snapshots.clone()));
        let server = Self { process, _stdout: stdout, address, folder, snapshots, _honest: honest };
        let tracked = async {
            while server
                .roundel()
                .await
                .list_objects(v1::ListObjectsRequest {})
                .await
                .unwrap()
                .into_inner()
                .objects
                .len()
                < OBJECTS
            {
                sleep(Duration::from_millis(50)).await;
            }
        };
        timeout(TIMEOUT, tracked).await.expect("the objects are not tracked");
        server
    }

    pub fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }

    pub async fn channel(&self) -> Channel {
        let endpoint = tonic::transport::Endpoint::from_shared(self.url("")).unwrap();
        timeout(TIMEOUT, endpoint.connect()).await.expect("no connection").unwrap()
    }

    pub async fn roundel(&self) -> RoundelClient<Channel> {
        RoundelClient::new(self.channel().await)
    }

    pub fn log(&self) -> String {
        fs::read_to_string(self.folder.path().join("log")).unwrap()
    }

    pub fn is_alive(&mut self) -> bool {
        self.process.try_wait().unwrap().is_none()
    }

    /// A line of `/proc/…/status`, megabytes.
    fn memory_mb(&self, key: &str) -> f64 {
        let status = fs::read_to_string(format!("/proc/{}/status", self.process.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix(key)).unwrap();
        line.split_whitespace().next().unwrap().parse::<f64>().unwrap() / 1024.0
    }

    /// Sets the peak to the current value.
    fn reset_peak(&self) {
        fs::write(format!("/proc/{}/clear_refs", self.process.id()), "5").unwrap();
    }

    /// Runs an attack, and checks that the honest client keeps its rate and the server its memory.
    pub async fn withstands<F: Future<Output = ()>>(
        &mut self,
        name: &str,
        mut attack: impl AsyncFnMut(&Self) -> F,
    ) {
        for attempt in 1..=ATTEMPTS {
            let before = self.rate_hz_during(sleep(REFERENCE)).await;
            self.reset_peak();
            let memory_mb = self.memory_mb("VmRSS:");
            let prepared = attack(&*self).await;
            let during = self.rate_hz_during(prepared).await;
            let (share, growth_mb) = (during / before, self.memory_mb("VmHWM:") - memory_mb);
            println!(
                "{name}: {during:.1} of {before:.1} Hz, which is {share:.2}; {growth_mb:+.0} MB on {memory_mb:.0} MB"
            );
            assert!(self.is_alive(), "{name}: the server has ended");
            assert!(growth_mb < MAX_GROWTH_MB, "{name}: {growth_mb:.0} MB more");
            if share >= MIN_SHARE {
                return;
            }
            assert!(attempt < ATTEMPTS, "{name}: the honest client keeps {share:.2} of its rate");
        }
    }

    /// Snapshots per second that the honest client receives meanwhile.
    async fn rate_hz_during(&self, action: impl Future<Output = ()>) -> f64 {
        let (begun, before) = (Instant::now(), self.snapshots.load(Ordering::Relaxed));
        timeout(TIMEOUT, action).await.expect("the attack does not end");
        let received = self.snapshots.load(Ordering::Relaxed) - before;
        received as f64 / begun.elapsed().as_secs_f64()
    }
}

/// Sends encoded messages to a camera after a greeting, and returns how the server ends the stream; `None` if it has not
/// within a few seconds.
pub async fn push(
    address: String,
    greeting: v1::PushGreeting,
    messages: Vec<Bytes>,
) -> Option<Status> {
    let greeting = encoded(v1::push_request::Message::Greeting(greeting));
    // The stream stays open.
    let requests = stream::iter(std::iter::once(greeting).chain(messages)).chain(stream::pending());
    let mut client = RawClient::connect(&address).await;
    let ended = async {
        let mut answers = match client.call("/roundel.v1.Push/Send", requests).await {
            Ok(answers) => answers,
            Err(status) => return status,
        };
        loop {
            if let Err(status) = answers.message().await {
                return status;
            }
        }
    };
    timeout(PUSH_TIME, ended).await.ok()
}

pub fn encoded(message: v1::push_request::Message) -> Bytes {
    v1::PushRequest { message: Some(message) }.encode_to_vec().into()
}

/// A gRPC client that neither encodes nor decodes, which would take more processor time than the server does.
#[derive(Clone)]
pub struct RawClient(Grpc<Channel>);

impl RawClient {
    pub async fn connect(address: &str) -> Self {
        let endpoint =
            tonic::transport::Endpoint::from_shared(format!("http://{address}")).unwrap();
        Self(Grpc::new(timeout(TIMEOUT, endpoint.connect()).await.expect("no connection").unwrap()))
    }

    pub async fn call(
        &mut self,
        path: &'static str,
        requests: impl Stream<Item = Bytes> + Send + 'static,
    ) -> Result<Streaming<()>, Status> {
        self.0.ready().await.unwrap();
        let path = PathAndQuery::from_static(path);
        let answers = self.0.streaming(tonic::Request::new(requests), path, RawCodec).await?;
        Ok(answers.into_inner())
    }
}

#[derive(Default)]
struct RawCodec;

impl Codec for RawCodec {
    type Encode = Bytes;
    type Decode = ();
    type Encoder = Self;
    type Decoder = Self;

    fn encoder(&mut self) -> Self {
        Self
    }

    fn decoder(&mut self) -> Self {
        Self
    }
}

impl Encoder for RawCodec {
    type Item = Bytes;
    type Error = Status;

    fn encode(&mut self, message: Bytes, buffer: &mut EncodeBuf<'_>) -> Result<(), Status> {
        buffer.put(message);
        Ok(())
    }
}

impl Decoder for RawCodec {
    type Item = ();
    type Error = Status;

    fn decode(&mut self, message: &mut DecodeBuf<'_>) -> Result<Option<()>, Status> {
        message.advance(message.remaining());
        Ok(Some(()))
    }
}

pub fn greeting(camera: &str) -> v1::PushGreeting {
    v1::PushGreeting {
        camera: camera.into(),
        sender: "attacker".into(),
        run_id: camera.into(),
        next_sequence: 1,
        ..Default::default()
    }
}

fn lens() -> Camera {
    Camera::new(Intrinsics {
        width: 320,
        height: 240,
        fx_px: 300.0,
        fy_px: 300.0,
        cx_px: 159.5,
        cy_px: 119.5,
        lens: Lens::PlumbBob([0.0; 5]),
    })
    .unwrap()
}

fn configuration() -> String {
    let mut text = "[server]\nlisten = \"127.0.0.1:0\"\nwatch = false\n\
         [[roundel]]\nname = \"robot\"\nouter_mm = 160.0\ninner_mm = 64.0\n"
        .to_owned();
    let attacked = (0..ATTACKED_CAMERAS).map(|index| format!("a{index}"));
    for (x_m, name) in std::iter::once("north".to_owned()).chain(attacked).enumerate() {
        text.push_str(&format!(
            "[[camera]]\nname = \"{name}\"\nsource = \"push:\"\ncalibration = \"camera.yaml\"\n\
             pose = {{ position_m = [{}.0, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }}\n",
            20 * x_m
        ));
    }
    text
}

/// A robot below the camera.
pub fn detection(index: usize) -> v1::Detection {
    let (x, y) = ((index % 6) as f64 * 0.4 - 1.0, (index / 6) as f64 * 0.4 - 0.8);
    let center = Some(v1::PixelPoint { u: 159.5 + 100.0 * x, v: 119.5 + 100.0 * y });
    let rim = |radius_px| {
        let (semi_major_px, semi_minor_px) = (radius_px, radius_px);
        Some(v1::Ellipse { center, semi_major_px, semi_minor_px, angle_rad: 0.0 })
    };
    let up = Some(v1::Vector3 { x: 0.0, y: 0.0, z: -1.0 });
    let mut covariance = vec![0.0; 21];
    // The diagonal of six rows of the upper triangle.
    for place in [0, 6, 11, 15, 18, 20] {
        covariance[place] = 1e-6;
    }
    v1::Detection {
        track: index as u64 + 1,
        roundel: "robot".into(),
        outer: rim(8.0),
        inner: rim(3.2),
        threshold: 120,
        black: 30.0,
        white: 220.0,
        pose: Some(v1::RoundelPose {
            position: Some(v1::Vector3 { x, y, z: 3.0 }),
            normal: up,
            normal_likelihood: 1.0,
            other_normal: up,
            yaw_rad: None,
            covariance,
            yaw_symmetry: 1,
        }),
        ..Default::default()
    }
}

pub fn frame(mut detections: Vec<v1::Detection>) -> v1::PushedObservations {
    let capture_time_ns = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_nanos() as i64;
    detections.iter_mut().for_each(|it| it.capture_time_ns = capture_time_ns);
    v1::PushedObservations {
        observations: Some(v1::FrameObservations {
            capture_time_ns,
            detections,
            ..Default::default()
        }),
        ..Default::default()
    }
}

async fn feed(address: String) {
    let client = Client::connect(&address).await.unwrap();
    let pusher = client.push(PushOptions::new("north").sender("honest")).unwrap();
    loop {
        pusher.observations(frame((0..OBJECTS).map(detection).collect()));
        sleep(FEED_INTERVAL).await;
    }
}

async fn watch(address: String, count: Arc<AtomicU64>) {
    let endpoint = tonic::transport::Endpoint::from_shared(format!("http://{address}")).unwrap();
    let mut client = RoundelClient::new(endpoint.connect().await.unwrap());
    let request = v1::SubscribeSnapshotsRequest::default();
    let mut snapshots = client.subscribe_snapshots(request).await.unwrap().into_inner();
    while let Ok(Some(_)) = snapshots.message().await {
        count.fetch_add(1, Ordering::Relaxed);
    }
}
