//! Days of operation in minutes: the fusion thread's code, the hub, history and recording, fed with made-up times.
//!
//! Two cameras see three robots ten times a second; one of these is out of sight for a minute each hour. Fusion takes its time
//! from the observations, the history its own from the snapshots. Retention is scaled so that everything that is kept has
//! reached its final size after a third of the time.

mod history;
mod sample;

use std::{
    fs,
    path::Path,
    sync::{Arc, mpsc::sync_channel},
};

use anyhow::Context;
use nalgebra::Vector3;
use roundel_core::{
    id::CameraId,
    rigid::Covariance6,
    time::Timestamp,
    world::{CameraPlacement, ClockPrior, FrameObservations},
};
use roundel_server::{
    archive::record::{Recorder, RecordingOptions},
    capture::worker::WorkerOutput,
    fusion::{FusionTask, camera_manager::setup::installation, setup::fusion_machine},
    model::{
        clock::Clock,
        command::{CameraChange, CameraModel, CameraUpdate, ClockModel, FusionCommand},
        config::Config,
        hub::Hub,
    },
};

use crate::{
    arena::{Arena, Kind, Path as RobotPath, SiteClock, look_at},
    export::camera_yaml,
    sensor::{Sensing, Stream},
};
use history::HistoryWriter;
pub use sample::{Sample, clock_problems, growths};

const DAY_S: f64 = 86_400.0;
const SNAPSHOT_INTERVAL_S: f64 = 2.0;
/// Frames of each camera. Slower cameras have too few frames within a comparison of clocks.
const FRAME_RATE_HZ: f64 = 24.0;
/// The robot that is hidden, and from when to when in each hour.
const HIDDEN_ROBOT: usize = 2;
const HIDDEN_S: (f64, f64) = (1800.0, 1860.0);
/// The camera whose clock is estimated, and its error.
const LATE_CAMERA: usize = 1;
const AHEAD_S: f64 = 0.02;
/// The coarsest tier of the history is kept for this share of the time, and the finest for 1 / 3650 of that.
const KEPT_SHARE: f64 = 0.2;
/// Samples of a run.
const SAMPLES: usize = 30;

/// Runs the server's long-lived parts for a number of simulated days, and calls `report` with each sample.
pub fn run(days: f64, mut report: impl FnMut(&Sample)) -> anyhow::Result<Vec<Sample>> {
    let folder = tempfile::tempdir()?;
    let (arena, config) = installation_for(days, folder.path())?;
    let start = Timestamp::from_ns(arena.start_ns);
    let clock = Clock::anchored_now();
    let hub = Arc::new(Hub::new(installation(&config, start)));
    let (_worker, outputs) = sync_channel(1);
    let task = FusionTask::new(fusion_machine(&config)?, hub.clone(), clock, outputs);
    let (mut task, commands) = task.with_commands();
    let clock_model = ClockModel::Estimated(ClockPrior { offset_s: 0.05, skew: 1e-5 });
    let model = CameraModel { clock: Some(clock_model), ..CameraModel::default() };
    let change = CameraChange::Set(Box::new(model));
    commands
        .send(FusionCommand::UpdateCamera(CameraUpdate {
            camera: CameraId(LATE_CAMERA as u32),
            change,
        }))
        .context("fusion has ended")?;
    let recorder =
        Recorder::new(hub.clone(), clock, config.recording.clone(), Box::new(String::new));
    recorder.start(&RecordingOptions::default())?;
    let settings = config.history.as_ref().context("no history")?;
    let mut history = HistoryWriter::new(settings, hub.clone())?;
    let mut samples = Vec::new();
    let mut next_snapshot_s = SNAPSHOT_INTERVAL_S;
    let mut placed = vec![false; arena.sites.len()];
    for frame in Stream::new(&arena, Sensing::DEFAULT, days * DAY_S) {
        let time = frame.received_time;
        let is_placed = std::mem::replace(&mut placed[frame.camera.0 as usize], true);
        let placement = (!is_placed).then(|| placement(&arena, &frame));
        task.observe(&WorkerOutput { observations: Arc::new(frame), placement });
        if time.seconds_since(start) < next_snapshot_s {
            continue;
        }
        next_snapshot_s += SNAPSHOT_INTERVAL_S;
        task.publish(time, Some(time));
        history.take(&hub.snapshots().borrow().snapshot)?;
        let day = time.seconds_since(start) / DAY_S;
        if day >= days * (samples.len() + 1) as f64 / SAMPLES as f64 {
            let sample = Sample::now(day, &hub, folder.path())?;
            report(&sample);
            samples.push(sample);
        }
    }
    recorder.stop()?;
    Ok(samples)
}

fn placement(arena: &Arena, frame: &FrameObservations) -> CameraPlacement {
    let world_from_camera = arena.sites[frame.camera.0 as usize].world_from_camera;
    CameraPlacement { world_from_camera, covariance: Covariance6::zeros() }
}

fn installation_for(days: f64, folder: &Path) -> anyhow::Result<(Arena, Config)> {
    let paths = (0..3).map(|index| {
        let center_m = Vector3::new(index as f64 - 1.0, 0.0, 0.3);
        RobotPath::circuit(center_m, 0.4, 0.8, 2.0 * index as f64)
    });
    let mut arena = Arena::under_r4(1, Kind::coded(8), paths.collect());
    arena.sites.truncate(2);
    for (index, site) in arena.sites.iter_mut().enumerate() {
        // Clocks can be compared only by what both cameras see.
        let eye_m = Vector3::new(2.0 * index as f64 - 1.0, -1.0, 5.0);
        site.world_from_camera = look_at(eye_m, Vector3::zeros());
        site.rate_hz = FRAME_RATE_HZ;
        site.offset_s = 0.5 * index as f64 / FRAME_RATE_HZ;
        fs::write(
            folder.join(format!("{}.yaml", site.name)),
            camera_yaml(&site.name, &site.optics),
        )?;
    }
    arena.sites[LATE_CAMERA].clock = SiteClock { ahead_s: AHEAD_S, skew: 0.0 };
    let hours = (days * 24.0).ceil() as u32;
    let hidden = |hour: u32| [HIDDEN_S.0, HIDDEN_S.1].map(|it| f64::from(hour) * 3600.0 + it);
    arena.robots[HIDDEN_ROBOT].hidden_s =
        (0..hours).map(hidden).map(|[from, until]| (from, until)).collect();
    let keep_hours = days * 24.0 * KEPT_SHARE / 3650.0;
    let mut text = format!(
        "name = \"soak\"\n[fusion]\npredicted_after_ms = 3000.0\nlost_after_ms = 10000.0\nacceleration_m_s2 = 1.0\n\
         [history]\nkeep_hours = {keep_hours:?}\n[recording]\nmin_free_mb = 0\nrotate_mb = 1\nbudget_gb = 0.004\n\
         [[roundel]]\nname = \"robot\"\nouter_mm = 160.0\ninner_mm = 96.0\n\
         code = {{ bits = 8, min_distance = 1 }}\n"
    );
    for site in &arena.sites {
        text += &format!(
            "[[camera]]\nname = \"{0}\"\nsource = \"push:\"\ncalibration = \"{0}.yaml\"\n\
             pose = {{ position_m = [0, 0, 5], orientation_xyzw = [1, 0, 0, 0] }}\n",
            site.name
        );
    }
    let path = folder.join("soak.toml");
    fs::write(&path, text)?;
    Ok((arena, Config::load(&path)?))
}
