//! End-to-end latency from a frame handed to a worker to its snapshot at a gRPC client on loopback: detection with poses,
//! fusion, the hub, HTTP/2 and protobuf.
//!
//! `r4_lite` hands all cameras a frame at once and waits for the snapshot that includes all of them. `r4` has 50 robots
//! with codes of 9 bits (8 bits have fewer codes) in view of four cameras of 1920x1080 that are out of step: they receive
//! frames in turn, at the rate of the preset, and each frame is awaited. The robots swing like a pendulum: they accelerate
//! to the speed of the preset, stop, and return the same way, so that the speed never jumps between frames. Each frame is
//! handed over after the average delay of a simulated camera; the measurement starts at the handover.
//!
//! The client has its own thread, like a controller's loop; the server has two, besides cameras and fusion. Snapshots are
//! published as soon as a frame is fused (`prompt`), in addition to the periodic ones. The percentiles of all runs are
//! printed beside criterion's mean, without those of the first second, in which cameras search whole frames.

use std::{
    f64::consts::{FRAC_2_PI, PI},
    hint::black_box,
    path::Path,
    sync::{
        Arc,
        mpsc::{Receiver, RecvTimeoutError, SyncSender, channel, sync_channel},
    },
    time::{Duration, Instant},
};

use criterion::{Criterion, criterion_group, criterion_main};
use futures::StreamExt;
use roundel_client::{Client, ConnectOptions, Snapshots, Subscription, Update};
use roundel_core::{
    frame::Frame,
    marker::{CodeLayout, Pattern},
    sim::{Renderer, Scenario, ScenarioParams},
    time::Timestamp,
};
use roundel_proto::v1::{ObjectState, Snapshot};
use roundel_server::{
    app::serve::Server,
    capture::source::{FrameInfo, FrameSource, LentFrame, OpenSource, SIM_LATENCY_S, SourceError},
    model::{config::Config, hub::FusedSnapshot, stop::StopSignal},
};
use tempfile::TempDir;
use tokio::runtime::{Builder, Runtime};

/// The allocator of the `roundel` command.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

type Pixels = Arc<Vec<u8>>;

/// Frames rendered for each camera: one way of the pendulum.
const FRAMES: usize = 40;
/// Time in the scenario when the motion starts, seconds.
const BEGIN_S: f64 = 1.0;
/// Warm-up frames for each camera: one second.
const WARM_UP_FRAMES: usize = 60;
/// Scenario frames between two rendered frames.
const SUBSTEPS: f64 = 16.0;
/// Delay from a frame's capture until it is handed to the worker.
const LATENCY_NS: i64 = (0.5e9 * (SIM_LATENCY_S[0] + SIM_LATENCY_S[1])) as i64;

/// A source that receives its frames from the benchmark.
struct ChannelSource {
    frames: Option<Receiver<(Pixels, Timestamp)>>,
    newest: Pixels,
    size: (usize, usize),
    stop: StopSignal,
}

impl OpenSource for ChannelSource {
    fn open(&mut self) -> Result<Box<dyn FrameSource>, SourceError> {
        let frames = self.frames.take().ok_or(SourceError::Finished)?;
        let (newest, stop) = (self.newest.clone(), self.stop.clone());
        Ok(Box::new(ChannelSource { frames: Some(frames), newest, size: self.size, stop }))
    }
}

impl FrameSource for ChannelSource {
    fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
        let frames = self.frames.as_ref().ok_or(SourceError::Finished)?;
        while !self.stop.is_stopped() {
            match frames.recv_timeout(Duration::from_millis(50)) {
                Ok((frame, capture_time)) => {
                    self.newest = frame;
                    let (width, height) = self.size;
                    let frame = Frame::new(&self.newest, width, height, width)
                        .map_err(|error| SourceError::Failed(error.to_string()))?;
                    return Ok(LentFrame { frame, info: FrameInfo::at(capture_time) });
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Err(SourceError::Finished),
            }
        }
        Err(SourceError::Stopped)
    }
}

#[derive(Clone, Copy)]
struct Case {
    preset: &'static str,
    mode: &'static str,
    robots: usize,
    cameras: usize,
    /// Whether all cameras receive their frames at the same time.
    at_once: bool,
    tls: bool,
}

impl Case {
    fn name(&self) -> String {
        let Self { preset, mode, robots, cameras, tls, .. } = self;
        let tls = if *tls { "/tls" } else { "" };
        format!("{preset}/robots={robots}/cameras={cameras}/{mode}{tls}")
    }

    fn params(&self) -> ScenarioParams {
        let mut params = ScenarioParams::r4_lite(1);
        if self.preset == "r4" {
            params = ScenarioParams::r4(1);
            params.kinds[0].pattern = Pattern::Coded(CodeLayout { bits: 9, min_distance: 1 });
        }
        ScenarioParams { robots: self.robots, ..params }
    }

    /// The configuration; a certificate goes to the folder.
    fn config(&self, folder: &Path) -> Config {
        let roundel = match self.preset {
            "r4" => "outer_mm = 160\ncode = { bits = 9 }\n",
            _ => "outer_mm = 160\ninner_mm = 64\n",
        };
        let tls = match self.tls {
            true => {
                "tls = { certificate = \"certificate.pem\", key = \"key.pem\", self_signed = true }\n"
            }
            false => "",
        };
        let mut text = format!(
            "[server]\nlisten = \"127.0.0.1:0\"\nprompt = true\n{tls}\
             [detection]\nmode = \"{}\"\n[[roundel]]\nname = \"robot\"\n{roundel}",
            self.mode
        );
        for camera in 0..self.cameras {
            text.push_str(&format!(
                "[[camera]]\nname = \"{camera}\"\nsource = \"sim:?preset={}&camera={camera}\"\n",
                self.preset
            ));
        }
        Config::parse(&text, folder).unwrap_or_else(|problems| panic!("{problems:#?}"))
    }
}

/// The scenario frame shown at this place of the pendulum, which passes the middle at full speed.
fn number_at(place: usize, rate_hz: f64) -> u64 {
    let share = place as f64 / (FRAMES - 1) as f64;
    let frames_at_full_speed = (FRAMES - 1) as f64 * FRAC_2_PI;
    let passed = frames_at_full_speed * 0.5 * (1.0 - (PI * share).cos());
    ((BEGIN_S * rate_hz + passed) * SUBSTEPS).round() as u64
}

/// Nanoseconds until the snapshot was fused, then until it was sent, then until it was received.
type Stages = [i64; 3];

/// The channel to a camera's source, and its frames.
type Feed = (SyncSender<(Pixels, Timestamp)>, Vec<Pixels>);

/// A server whose cameras play their frames forwards and backwards, and a client.
struct Bench {
    server: Server,
    cameras: Vec<Feed>,
    at_once: bool,
    /// Time between two frames of one camera.
    period: Duration,
    /// Number of turns so far.
    given: usize,
    /// Time of the next turn.
    due: Instant,
    snapshots: Snapshots,
    _folder: TempDir,
}

impl Bench {
    async fn start(case: Case, of_server: &Runtime) -> Self {
        let mut params = case.params();
        let rate_hz = params.optics.rate_hz;
        let period = Duration::from_secs_f64(1.0 / rate_hz);
        params.optics.rate_hz *= SUBSTEPS;
        let folder = tempfile::tempdir().expect("a folder");
        let (config, scenario) = (
            case.config(folder.path()),
            Scenario::new(params).expect("enough space for the robots"),
        );
        let (begun, senders) = channel();
        let server = Server::start_with_sources(config, move |setting| {
            let camera = &setting.camera.calibration;
            let size = (camera.width(), camera.height());
            let mut renderer =
                Renderer::new(&scenario, setting.index).expect("a camera of the preset");
            let frame = |place: usize| {
                let mut pixels = vec![0; size.0 * size.1];
                renderer.render(number_at(place, rate_hz), &mut pixels).expect("its size");
                Arc::new(pixels)
            };
            let shown = (0..FRAMES).map(frame).collect();
            let (sender, frames) = sync_channel(1);
            begun.send((sender, shown)).expect("the bench waits for it");
            let newest = Pixels::default();
            Box::new(ChannelSource { frames: Some(frames), newest, size, stop: setting.stop })
        });
        let server = of_server.spawn(server).await.expect("no panic").expect("a server");
        let (mut scheme, mut options) = ("http", ConnectOptions::default());
        if let Some(certificate) = server.certificate() {
            scheme = "https";
            options = options.fingerprint(&certificate.fingerprint);
        }
        let url = format!("{scheme}://{}", server.local_addr());
        let client = Client::connect_with(&url, &options).await.expect("a connection");
        let snapshots = client.snapshots(Subscription::default());
        let cameras = senders.try_iter().collect();
        let at_once = case.at_once;
        Self {
            server,
            cameras,
            at_once,
            period,
            given: 0,
            due: Instant::now(),
            snapshots,
            _folder: folder,
        }
    }

    /// Number of turns in which each camera receives one frame.
    fn turns(&self) -> usize {
        if self.at_once { 1 } else { self.cameras.len() }
    }

    /// Hands the next frame to all cameras, or to the next camera, when it is due, and waits for the snapshot that
    /// includes it. Returns the latency and its stages.
    async fn once(&mut self) -> (Duration, Stages) {
        let turns = self.turns();
        let (round, turn) = (self.given / turns, self.given % turns);
        let chosen = if self.at_once { 0..self.cameras.len() } else { turn..turn + 1 };
        let place = round % (2 * FRAMES - 2);
        let number = place.min(2 * FRAMES - 2 - place);
        self.given += 1;
        tokio::time::sleep_until(self.due.into()).await;
        self.due = Instant::now() + self.period / turns as u32;
        let hub = self.server.hub();
        let fused = hub.fusion_counts().frames + chosen.len() as u64;
        let before = observed_ns(&hub.snapshots().borrow());
        let (begun, given_ns) = (Instant::now(), self.server.clock().now().as_ns());
        for (sender, shown) in &self.cameras[chosen] {
            let captured = self.server.clock().now().plus_ns(-LATENCY_NS);
            sender.send((shown[number].clone(), captured)).expect("a worker");
        }
        loop {
            let Some(Ok(Update::Snapshot(snapshot))) = self.snapshots.next().await else {
                panic!("the connection is lost");
            };
            // A snapshot with only one camera's frame may precede the one with all. A periodic snapshot with the same
            // content may follow.
            let has_all = hub.fusion_counts().frames >= fused;
            let newest = hub.snapshots().borrow().clone();
            let (is_newest, seen) = (snapshot.sequence >= newest.sequence, seen_ns(&snapshot));
            if has_all && (is_newest || seen != before && seen == observed_ns(&newest)) {
                let took = begun.elapsed();
                let there_ns = self.server.clock().now().as_ns();
                let times_ns = [given_ns, snapshot.fused_time_ns, snapshot.sent_time_ns, there_ns];
                black_box(snapshot);
                return (took, [0, 1, 2].map(|stage| times_ns[stage + 1] - times_ns[stage]));
            }
        }
    }
}

/// The sum of all objects' last observation times, nanoseconds, which changes with each frame that is fused.
fn seen_ns(snapshot: &Snapshot) -> i128 {
    let seen_ns = |object: &ObjectState| snapshot.pose_time_ns - object.observation_age_ns;
    snapshot.objects.iter().map(|object| i128::from(seen_ns(object))).sum()
}

/// The same for a snapshot that has not been encoded.
fn observed_ns(fused: &FusedSnapshot) -> i128 {
    let objects = fused.snapshot.objects.iter();
    objects.map(|object| i128::from(object.newest_observation.as_ns())).sum()
}

fn frame_to_client(criterion: &mut Criterion) {
    let of_server = Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let of_server = of_server.expect("a runtime");
    let of_client = Builder::new_current_thread().enable_all().build().expect("a runtime");
    let mut group = criterion.benchmark_group("frame_to_client");
    group.sample_size(20).measurement_time(Duration::from_secs(5));
    let lite = Case {
        preset: "r4_lite",
        mode: "precise",
        robots: 24,
        cameras: 1,
        at_once: true,
        tls: false,
    };
    let r4 = Case { preset: "r4", robots: 50, cameras: 4, at_once: false, ..lite };
    let fast = Case { mode: "fast", ..r4 };
    for case in [
        lite,
        Case { cameras: 4, ..lite },
        r4,
        Case { tls: true, ..r4 },
        fast,
        Case { tls: true, ..fast },
    ] {
        let mut bench = of_client.block_on(Bench::start(case, &of_server));
        of_client.block_on(async {
            for _ in 0..WARM_UP_FRAMES * bench.turns() {
                bench.once().await;
            }
        });
        let (mut all, mut stages) = (Vec::new(), [const { Vec::new() }; 3]);
        group.bench_function(case.name(), |bencher| {
            bencher.iter_custom(|runs| {
                of_client.block_on(async {
                    let mut sum = Duration::ZERO;
                    for _ in 0..runs {
                        let (took, parts_ns) = bench.once().await;
                        all.push(took);
                        stages.iter_mut().zip(parts_ns).for_each(|(all, part)| all.push(part));
                        sum += took;
                    }
                    sum
                })
            });
        });
        all.sort();
        if let (Some(median), Some(p99)) = (all.get(all.len() / 2), all.get(all.len() * 99 / 100)) {
            let states = bench.server.hub().cameras();
            let detect_ms = states.values().map(|camera| camera.detect_ms).fold(0.0, f64::max);
            let [fused_ms, sent_ms, there_ms] = stages.map(|mut all| {
                all.sort_unstable();
                all[all.len() / 2] as f64 * 1e-6
            });
            println!(
                "{}: p50 {median:?}, p99 {p99:?} of {}; detection {detect_ms:.2} ms, fused {fused_ms:.2} ms after \
                 the frame, sent {sent_ms:.2} ms later, there after another {there_ms:.2} ms",
                case.name(),
                all.len()
            );
        }
        of_server.block_on(bench.server.shutdown());
    }
    group.finish();
}

criterion_group!(benches, frame_to_client);
criterion_main!(benches);
