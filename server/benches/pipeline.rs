//! The whole way, from a frame given to a worker to the snapshot with it in a gRPC client on
//! loopback: detection with poses of what R4-lite's cameras see, fusion, the hub, HTTP/2, protobuf.
//!
//! Snapshots are published at the highest rate that can be configured, 1000 Hz, so that waiting for
//! the next tick costs half a millisecond on average. Besides criterion's mean, the percentiles of
//! all runs are printed.

use std::{
    hint::black_box,
    path::Path,
    sync::{
        Arc,
        mpsc::{Receiver, RecvTimeoutError, SyncSender, channel, sync_channel},
    },
    time::{Duration, Instant},
};

use criterion::{Criterion, criterion_group, criterion_main};
use roundel_core::{
    frame::Frame,
    sim::{Renderer, Scenario},
    time::Timestamp,
};
use roundel_proto::v1::{Snapshot, SubscribeSnapshotsRequest, roundel_client::RoundelClient};
use roundel_server::{
    config::Config,
    serve::Server,
    source::{FrameInfo, FrameSource, LentFrame, OpenSource, SourceError},
    stop::Stop,
};
use tonic::{Streaming, transport::Endpoint};

type Pixels = Arc<Vec<u8>>;

/// Frames from the benchmark instead of a camera.
struct Fed {
    frames: Option<Receiver<(Pixels, Timestamp)>>,
    newest: Pixels,
    size: (usize, usize),
    stop: Stop,
}

impl OpenSource for Fed {
    fn open(&mut self) -> Result<Box<dyn FrameSource>, SourceError> {
        let frames = self.frames.take().ok_or(SourceError::Finished)?;
        let (newest, stop) = (self.newest.clone(), self.stop.clone());
        Ok(Box::new(Fed { frames: Some(frames), newest, size: self.size, stop }))
    }
}

impl FrameSource for Fed {
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

/// A server whose cameras show one frame each, again and again, and a client of it.
struct Bench {
    server: Server,
    cameras: Vec<(SyncSender<(Pixels, Timestamp)>, Pixels)>,
    snapshots: Streaming<Snapshot>,
}

impl Bench {
    async fn start(cameras: usize) -> Self {
        let mut text = "[server]\nlisten = \"127.0.0.1:0\"\nsnapshot_rate_hz = 1000\n\
                        [[roundel]]\nname = \"robot\"\nouter_mm = 160\ninner_mm = 64\n"
            .to_owned();
        for camera in 0..cameras {
            text.push_str(&format!(
                "[[camera]]\nname = \"{camera}\"\nsource = \"sim:?camera={camera}\"\n"
            ));
        }
        let config = Config::parse(&text, Path::new("")).expect("a configuration");
        let scenario = Scenario::r4_lite(1);
        let (begun, senders) = channel();
        let server = Server::start_with_sources(config, move |setting| {
            let camera = &setting.camera.calibration;
            let size = (camera.width(), camera.height());
            let mut pixels = vec![0; size.0 * size.1];
            Renderer::new(&scenario, setting.index)
                .expect("a camera of the preset")
                .render(30, &mut pixels)
                .expect("a buffer of its size");
            let (sender, frames) = sync_channel(1);
            begun.send((sender, Arc::new(pixels))).expect("the bench waits for it");
            let newest = Pixels::default();
            Box::new(Fed { frames: Some(frames), newest, size, stop: setting.stop })
        })
        .await
        .expect("a server");
        let address = format!("http://{}", server.local_addr());
        let endpoint = Endpoint::from_shared(address).expect("an address");
        let mut client = RoundelClient::new(endpoint.connect().await.expect("a connection"));
        let request = SubscribeSnapshotsRequest::default();
        let snapshots = client.subscribe_snapshots(request).await.expect("a stream").into_inner();
        Self { server, cameras: senders.try_iter().collect(), snapshots }
    }

    /// Gives each camera its frame, and waits for the snapshot with all of them.
    async fn once(&mut self) -> Duration {
        let begun = Instant::now();
        let mut newest = Timestamp::default();
        for (sender, pixels) in &self.cameras {
            newest = self.server.clock().now();
            sender.send((pixels.clone(), newest)).expect("a worker");
        }
        loop {
            let snapshot = self.snapshots.message().await.expect("a stream").expect("a snapshot");
            // The newest detection is of a row of the newest frame, up to half the frame's readout
            // before its middle.
            let used_s = Timestamp::from_ns(snapshot.capture_time_ns).seconds_since(newest);
            if used_s > -0.004 {
                black_box(snapshot);
                return begun.elapsed();
            }
        }
    }
}

fn frame_to_client(criterion: &mut Criterion) {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .expect("a runtime");
    let mut group = criterion.benchmark_group("frame_to_client");
    group.sample_size(20).measurement_time(Duration::from_secs(5));
    for cameras in [1, 4] {
        let mut bench = runtime.block_on(Bench::start(cameras));
        let mut all = Vec::new();
        group.bench_function(format!("r4_lite/cameras={cameras}"), |bencher| {
            bencher.iter_custom(|runs| {
                runtime.block_on(async {
                    let mut sum = Duration::ZERO;
                    for _ in 0..runs {
                        let took = bench.once().await;
                        all.push(took);
                        sum += took;
                        // Longer than the tolerance for the rows, so that no frame passes for the
                        // next one.
                        tokio::time::sleep(Duration::from_millis(12)).await;
                    }
                    sum
                })
            });
        });
        all.sort();
        if let (Some(median), Some(p99)) = (all.get(all.len() / 2), all.get(all.len() * 99 / 100)) {
            println!("r4_lite/cameras={cameras}: p50 {median:?}, p99 {p99:?} of {}", all.len());
        }
        runtime.block_on(bench.server.shutdown());
    }
    group.finish();
}

criterion_group!(benches, frame_to_client);
criterion_main!(benches);
