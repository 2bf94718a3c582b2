//! The world that servers under test see: four cameras over a few robots whose poses are known at any time.

use std::{f64::consts::TAU, fmt::Write as _, fs, path::Path as FilePath, time::Instant};

use nalgebra::Vector3;
use roundel_core::{time::Timestamp, world::FrameObservations};
use roundel_proto::v1;
use roundel_server::{
    fusion::camera_manager::setup::installation,
    model::{clock::Clock, config::Config, convert, hub::Installation},
};

use super::timetable::CAMERAS;
use crate::{
    arena::{Arena, Kind, Path, look_at},
    export::camera_yaml,
    optics::{Distortion, Pinhole},
    random::Random,
    sensor::Sensing,
};

/// Kinds of roundel, as configured.
pub const CODED: &str = "robot";
const PLAIN: &str = "plain";
const PLAIN_ROBOTS: usize = 3;
const CODED_ROBOTS: usize = 3;
const FRAME_RATE_HZ: f64 = 15.0;
/// A camera that hostile senders may feed, far away from the others.
pub const SPARE_CAMERA: &str = "spare";
const SPARE_X_M: f64 = 50.0;
/// Objects beyond this are of hostile senders.
pub const FAR_M: f64 = 20.0;

/// How cameras err.
pub const SENSING: Sensing = Sensing { shows_rims: true, misread: 0.0, ..Sensing::DEFAULT };

/// An arena whose time is this machine's monotonic clock.
pub struct World {
    /// Where cameras and robots are.
    pub arena: Arena,
    clock: Clock,
    installation: Installation,
}

impl World {
    /// The world of a seed, which begins now; writes its configuration to `lab.toml` in `folder`.
    pub fn new(seed: u64, folder: &FilePath) -> anyhow::Result<Self> {
        let clock = Clock::anchored_now();
        let arena = Arena { start_ns: clock.start().as_ns(), ..arena(seed) };
        for site in &arena.sites {
            fs::write(
                folder.join(format!("{}.yaml", site.name)),
                camera_yaml(&site.name, &site.optics),
            )?;
        }
        let path = folder.join("lab.toml");
        fs::write(&path, configuration(&arena))?;
        let installation = installation(&Config::load(&path)?, clock.start());
        Ok(Self { arena, clock, installation })
    }

    /// Time of the arena.
    pub fn now(&self) -> Timestamp {
        self.clock.now()
    }

    /// Seconds since the world began.
    pub fn seconds(&self) -> f64 {
        self.now().seconds_since(self.clock.start())
    }

    /// The time of the arena at an instant.
    pub fn at(&self, instant: Instant) -> Timestamp {
        self.clock.at(instant)
    }

    /// A frame as it is sent.
    pub fn message(&self, frame: &FrameObservations) -> v1::PushedObservations {
        let mut observations = convert::observations(&self.installation, frame);
        // The lens is the configured one throughout.
        observations.calibration_version = 0;
        v1::PushedObservations { observations: Some(observations), ..Default::default() }
    }
}

/// Four cameras that see everything, at the corners of a small field, and robots in cells of their own.
pub fn arena(seed: u64) -> Arena {
    let mut random = Random::new(seed, 701);
    let mut arena = Arena::under_r4(seed, Kind::coded(8), Vec::new());
    for (index, site) in arena.sites.iter_mut().enumerate() {
        let (x, y) = ([-1.5, 1.5][index % 2], [-1.0, 1.0][index / 2]);
        site.optics = Pinhole::centered(1280, 720, 600.0, Distortion::PlumbBob([0.0; 5]));
        site.world_from_camera = look_at(Vector3::new(x, y, 4.5), Vector3::zeros());
        site.rate_hz = FRAME_RATE_HZ;
        site.offset_s = random.uniform(0.0, 1.0 / FRAME_RATE_HZ);
    }
    assert_eq!(arena.sites.len(), CAMERAS);
    for index in 0..CODED_ROBOTS + PLAIN_ROBOTS {
        let (column, row) = ((index % 3) as f64 - 1.0, (index / 3) as f64 - 0.5);
        let center_m = Vector3::new(column * 1.1, row * 1.1, 0.3);
        let path = match index % 3 {
            0 => Path::still(center_m),
            1 => Path::circuit(center_m, 0.3, 0.4, random.uniform(0.0, TAU)),
            _ => Path::wandering(center_m, 0.3, None, &mut random),
        };
        arena.add_robot(path);
    }
    arena.kinds.push(Kind { name: PLAIN.into(), ..Kind::robot() });
    for robot in &mut arena.robots[CODED_ROBOTS..] {
        (robot.kind, robot.code) = (PLAIN.into(), None);
    }
    arena
}

fn configuration(arena: &Arena) -> String {
    let mut text = "name = \"lab\"\n[server]\nlisten = \"127.0.0.1:0\"\nsnapshot_rate_hz = 20.0\n\
         [fusion]\nlost_after_ms = 6000.0\n[history]\n[recording]\nstart = true\nmin_free_mb = 0\n\
         rotate_mb = 0.3\nbudget_gb = 0.01\n"
        .to_owned();
    for kind in &arena.kinds {
        let (outer_mm, inner_mm) = (kind.outer_diameter_m * 1e3, kind.inner_diameter_m * 1e3);
        let _ = write!(
            text,
            "[[roundel]]\nname = \"{}\"\nouter_mm = {outer_mm:?}\ninner_mm = {inner_mm:?}\n",
            kind.name
        );
        if let Some(bits) = kind.code_bits {
            let _ = writeln!(text, "code = {{ bits = {bits}, min_distance = 1 }}");
        }
    }
    for site in &arena.sites {
        let (p, q) = (site.world_from_camera.translation.vector, site.world_from_camera.rotation);
        let pose = format!(
            "[{}, {}, {}], orientation_xyzw = [{}, {}, {}, {}]",
            p.x, p.y, p.z, q.i, q.j, q.k, q.w
        );
        text += &camera(&site.name, &site.name, site.imaging.line_time_s, &pose);
    }
    let far = format!("[{SPARE_X_M}, 0, 3], orientation_xyzw = [1, 0, 0, 0]");
    text + &camera(SPARE_CAMERA, &arena.sites[0].name, 0.0, &far)
}

fn camera(name: &str, lens: &str, line_time_s: f64, pose: &str) -> String {
    format!(
        "[[camera]]\nname = \"{name}\"\nsource = \"push:\"\ncalibration = \"{lens}.yaml\"\n\
         line_time_us = {:?}\npose = {{ position_m = {pose} }}\n",
        line_time_s * 1e6
    )
}
