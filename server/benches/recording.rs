//! Processor and disk load of a recording: `cargo bench -p roundel-server --bench recording -- [SECONDS]`.
//!
//! Observations and snapshots of the reference installations, with numbers of full precision, arrive at their rates
//! through the hub's tap. The load is that of the recording thread only.

#[path = "shared/object.rs"]
mod object;

use std::{
    collections::BTreeMap,
    fs,
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use nalgebra::Vector3;
use roundel_core::{
    camera::PixelPoint,
    ellipse::Ellipse,
    id::{CameraId, KindId, TrackNumber},
    marker::{Code, CodeReading, Ring},
    pose::{Detection, RoundelPose},
    rigid::Covariance6,
    time::Timestamp,
    world::{FrameObservations, Snapshot},
};
use roundel_server::{
    archive::record::{Recorder, RecordingOptions},
    model::{
        clock::Clock,
        config::RecordingConfig,
        hub::{CameraInfo, Hub, Installation},
        tap::RecordedItem,
    },
};

const RATE_HZ: f64 = 60.0;
/// Clock ticks in `/proc`, equal on all common Linux systems.
const TICKS_PER_S: f64 = 100.0;

fn main() {
    let seconds = std::env::args().skip(1).find_map(|it| it.parse().ok()).unwrap_or(20.0);
    // In R4, each camera sees about half of the robots; in R16, the views of neighbours overlap by a third.
    run("R4, 24 objects", (4, 14), 24, seconds);
    run("R16, 200 objects", (16, 28), 200, seconds);
}

fn detection(track: u64, phase: f64, capture_time: Timestamp) -> Detection {
    let phase = phase + track as f64 * 0.37;
    let rim = |semi_px: f64| Ellipse {
        center: PixelPoint { u: 900.0 + 800.0 * phase.sin(), v: 500.0 + 400.0 * phase.cos() },
        semi_major_px: semi_px + phase.sin(),
        semi_minor_px: semi_px * (0.9 + 0.05 * phase.cos()),
        angle_rad: phase.sin(),
    };
    let factor = Covariance6::from_fn(|row, column| {
        ((row * 6 + column) as f64 + phase).sin() * 1e-3 + f64::from(u8::from(row == column)) * 1e-2
    });
    let normal = Vector3::new(0.3 * phase.sin(), 0.2 * phase.cos(), -1.0).normalize();
    let pose = RoundelPose {
        position_m: Vector3::new(2.0 * phase.sin(), phase.cos(), 5.0 + 0.1 * phase.sin()),
        normal,
        normal_likelihood: 0.9 + 0.1 * phase.sin().abs(),
        other_normal: Vector3::new(-normal.x, -normal.y, normal.z),
        yaw_rad: Some(phase.sin()),
        yaw_symmetry: 1,
        covariance: factor * factor.transpose(),
    };
    let zero = PixelPoint { u: 900.0 + phase.cos(), v: 500.0 + phase.sin() };
    let code = CodeReading::certain(Code { bits: 8, number: 1 + (track % 16) as u16 }, zero);
    let ring =
        Ring { kind: Some(KindId(0)), code: Some(code), ..Ring::of_rims(rim(20.0), rim(12.0)) };
    Detection { track: TrackNumber(track), ring, capture_time, pose: Some(pose) }
}

fn hub(cameras: u32, clock: &Clock) -> Arc<Hub> {
    let camera = |number: u32| CameraInfo {
        name: format!("camera {number}"),
        source: "sim:".into(),
        ..CameraInfo::default()
    };
    Arc::new(Hub::new(Installation {
        name: "bench".into(),
        source_id: "bench".into(),
        started: clock.now(),
        snapshot_rate_hz: RATE_HZ,
        cameras: Installation::number_cameras((0..cameras).map(camera)),
        kinds: vec!["robot".into()],
        object_names: BTreeMap::new(),
        body_names: Vec::new(),
    }))
}

fn run(name: &str, (cameras, roundels): (u32, u64), objects: u64, seconds: f64) {
    let folder = std::env::temp_dir().join(format!("roundel-recording-{}", std::process::id()));
    let clock = Clock::anchored_now();
    let hub = hub(cameras, &clock);
    let config =
        RecordingConfig { folder: folder.clone(), min_free_bytes: 0, ..RecordingConfig::default() };
    let recorder = Recorder::new(hub.clone(), clock, config, Box::new(String::new));
    recorder.start(&RecordingOptions::default()).expect("a recording");
    let begun = Instant::now();
    let steps = (seconds * RATE_HZ) as u64;
    for step in 0..steps {
        let due = Duration::from_secs_f64(step as f64 / RATE_HZ);
        thread::sleep(due.saturating_sub(begun.elapsed()));
        let (now, phase) = (clock.now(), step as f64 * 0.013);
        for camera in 0..cameras {
            let phase = phase + f64::from(camera);
            let frame = FrameObservations {
                camera: CameraId(camera),
                frame: step + 1,
                capture_time: now,
                received_time: now,
                calibration_version: 0,
                detections: (0..roundels).map(|it| detection(it, phase, now)).collect(),
            };
            hub.tap().offer(|| RecordedItem::Detections(Arc::new(frame), now));
        }
        let states = (0..objects).map(|id| object::object(id, phase, now)).collect();
        let snapshot = Snapshot { pose_time: now, capture_time: Some(now), objects: states };
        hub.publish_snapshot(snapshot, now);
    }
    let (elapsed_s, used_s) = (begun.elapsed().as_secs_f64(), processor_s("recording"));
    recorder.stop().expect("it runs");
    let status = recorder.status();
    println!(
        "{name}: {:.1} % of one core, {:.1} GB an hour; {} messages in {elapsed_s:.1} s, {} dropped",
        used_s / elapsed_s * 100.0,
        status.bytes as f64 / elapsed_s * 3600.0 / 1e9,
        status.messages,
        status.dropped
    );
    let _ = fs::remove_dir_all(folder);
}

/// Processor time of this process' thread with this name, seconds.
fn processor_s(name: &str) -> f64 {
    let tasks = fs::read_dir("/proc/self/task").expect("Linux' /proc/self/task").flatten();
    let ticks = tasks.filter_map(|task| {
        let line = fs::read_to_string(task.path().join("stat")).ok()?;
        let (head, fields) = line.rsplit_once(')')?;
        // utime and stime are the 14th and 15th field.
        let fields = fields.split_whitespace().skip(11).take(2);
        head.ends_with(&format!("({name}"))
            .then(|| fields.filter_map(|field| field.parse::<f64>().ok()).sum::<f64>())
    });
    ticks.sum::<f64>() / TICKS_PER_S
}
