//! Processor load of a server with sixteen cameras: sources of 1280x720 at 30 Hz from memory, nothing to decode, each with
//! 20 moving roundels of 30 px in view. Includes detection with poses, fusion of 320 objects, and snapshots at 60 Hz.
//!
//! ```sh
//! cargo bench -p roundel-server --bench sixteen_cameras               # precise and fast, 20 s each
//! cargo bench -p roundel-server --bench sixteen_cameras -- --seconds 5 --cameras 4
//! ```
//!
//! The processor time is that of all threads of this process, user and system, from `/proc/self/stat` (Linux), without
//! the time for drawing the frames. Dropped frames and missed roundels are counted and printed.

mod shared;

use std::{
    collections::BTreeMap,
    fs,
    path::Path,
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use roundel_core::{frame::Frame, id::CameraId, time::Timestamp};
use roundel_server::{
    app::serve::Server,
    capture::source::{FrameInfo, FrameSource, LentFrame, OpenSource, SourceError},
    model::{clock::Clock, config::Config, hub::CameraState, stop::StopSignal},
};
use shared::{ROUND, ROUNDELS, SIZE, draw, processor_s};

const RATE_HZ: f64 = 30.0;
/// Time before the measurement.
const WARM_UP: Duration = Duration::from_secs(2);

fn main() {
    let (mut seconds, mut cameras) = (20.0, 16);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut number = || arguments.next().and_then(|value| value.parse::<f64>().ok());
        match argument.as_str() {
            "--seconds" => seconds = number().expect("--seconds takes a number"),
            "--cameras" => cameras = number().expect("--cameras takes a number") as usize,
            // Passed by cargo.
            "--bench" => {}
            other => panic!("unknown option {other}: expected --seconds or --cameras"),
        }
    }
    let frames: Arc<Vec<Vec<u8>>> = Arc::new((0..ROUND).map(draw).collect());
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .expect("a runtime");
    for mode in ["precise", "fast"] {
        runtime.block_on(run(mode, cameras, Duration::from_secs_f64(seconds), &frames));
    }
}

/// A source that plays the frames in a loop, each when it is due.
struct LoopSource {
    frames: Arc<Vec<Vec<u8>>>,
    /// Due time of the first frame.
    begin: Timestamp,
    number: u64,
    clock: Clock,
    stop: StopSignal,
}

impl OpenSource for LoopSource {
    fn open(&mut self) -> Result<Box<dyn FrameSource>, SourceError> {
        let Self { frames, begin, clock, stop, .. } = self;
        let (frames, stop) = (frames.clone(), stop.clone());
        Ok(Box::new(LoopSource { frames, begin: *begin, number: 0, clock: *clock, stop }))
    }
}

impl FrameSource for LoopSource {
    fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
        let due = |number: u64| self.begin.plus_seconds(number as f64 / RATE_HZ);
        let newest = (self.clock.now().seconds_since(self.begin) * RATE_HZ).max(0.0) as u64;
        let number = (self.number + 1).max(newest);
        let skipped = number - self.number - 1;
        self.number = number;
        let capture_time = due(number);
        if self.stop.wait(self.clock.until(capture_time)) {
            return Err(SourceError::Stopped);
        }
        let pixels = &self.frames[number as usize % ROUND];
        let frame = Frame::new(pixels, SIZE.0, SIZE.1, SIZE.0)
            .map_err(|error| SourceError::Failed(error.to_string()))?;
        Ok(LentFrame { frame, info: FrameInfo { skipped, ..FrameInfo::at(capture_time) } })
    }
}

/// A configuration of this number of cameras side by side, each above its own part of the floor.
fn config(mode: &str, cameras: usize, folder: &Path) -> Config {
    let lens = "image_width: 1280\nimage_height: 720\ncamera_name: many\n\
        camera_matrix: {rows: 3, cols: 3, data: [900.0, 0.0, 639.5, 0.0, 900.0, 359.5, 0.0, 0.0, 1.0]}\n\
        distortion_model: plumb_bob\n\
        distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0.02, 0.0, 0.0, 0.0]}\n";
    fs::write(folder.join("camera.yaml"), lens).expect("a camera file");
    let mut text = format!(
        "[server]\nlisten = \"127.0.0.1:0\"\n[detection]\nmode = \"{mode}\"\n\
         [[roundel]]\nname = \"robot\"\nouter_mm = 160\ninner_mm = 64\n"
    );
    for index in 0..cameras {
        let x_m = 20.0 * index as f64;
        text.push_str(&format!(
            "[[camera]]\nname = \"{index}\"\nsource = \"push:\"\ncalibration = \"camera.yaml\"\n\
             pose = {{ position_m = [{x_m}, 0.0, 5.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }}\n"
        ));
    }
    Config::parse(&text, folder).unwrap_or_else(|problems| panic!("{problems:#?}"))
}

/// Totals over all cameras: frames, dropped frames, detections.
fn totals(cameras: &BTreeMap<CameraId, CameraState>) -> [u64; 3] {
    cameras.values().fold([0; 3], |[frames, dropped, rings], camera| {
        let found = camera.counts.precise + camera.counts.fast + camera.counts.unlocated;
        [frames + camera.frames, dropped + camera.dropped, rings + found]
    })
}

fn median(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_by(f64::total_cmp);
    numbers.get(numbers.len() / 2).copied().unwrap_or_default()
}

async fn run(mode: &str, cameras: usize, length: Duration, frames: &Arc<Vec<Vec<u8>>>) {
    let folder = std::env::temp_dir().join(format!("roundel-many-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("a folder");
    let shown = frames.clone();
    let server = Server::start_with_sources(config(mode, cameras, &folder), move |setting| {
        // Shifts the phases of the cameras against each other.
        let phase_s = setting.index as f64 / (RATE_HZ * cameras as f64);
        let begin = setting.clock.now().plus_seconds(0.2 + phase_s);
        let (frames, clock, stop) = (shown.clone(), setting.clock, setting.stop);
        Box::new(LoopSource { frames, begin, number: 0, clock, stop })
    })
    .await
    .expect("a server");
    let _ = fs::remove_dir_all(&folder);
    tokio::time::sleep(WARM_UP).await;
    let (before, processor, begun) =
        (totals(&server.hub().cameras()), processor_s(), Instant::now());
    let fused = server.hub().fusion_counts();
    tokio::time::sleep(length).await;
    let elapsed_s = begun.elapsed().as_secs_f64();
    let share = (processor_s() - processor) / elapsed_s;
    let states = server.hub().cameras();
    let [frames, dropped, rings] = totals(&states);
    let [frames, dropped, rings] = [frames - before[0], dropped - before[1], rings - before[2]];
    let counts = server.hub().fusion_counts();
    let detect_ms = median(states.values().map(|camera| camera.detect_ms).collect());
    let objects = server.hub().snapshots().borrow().snapshot.objects.len();
    println!(
        "{cameras} cameras of {}x{} at {RATE_HZ} Hz, {ROUNDELS} roundels each, {mode}: {share:.2} of a core\n  \
         {frames} frames of {:.0} due searched, {dropped} dropped; {rings} rings of {} found; {detect_ms:.2} ms a frame\n  \
         fusion: {} detections of {} used; {objects} objects, {} tracks begun in all; {} threads",
        SIZE.0,
        SIZE.1,
        elapsed_s * RATE_HZ * cameras as f64,
        frames as usize * ROUNDELS,
        counts.used - fused.used,
        counts.detections - fused.detections,
        counts.begun,
        thread::available_parallelism().map_or(1, usize::from),
    );
    server.shutdown().await;
}
