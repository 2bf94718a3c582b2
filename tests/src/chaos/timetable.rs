//! Which faults happen when, as a seed chooses.

use std::time::Duration;

use crate::random::Random;

/// Cameras of the world.
pub const CAMERAS: usize = 4;
/// Time without faults at the start.
const BEFORE_S: f64 = 1.5;
/// Time without faults at the end.
pub const AFTER_S: f64 = 1.5;
/// How a server is run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// In this process, as a library.
    Library,
    /// `roundel serve`, with its disk and its clock disturbed.
    Process,
}

/// Something that goes wrong.
#[expect(missing_docs, reason = "the comments of the variants cover their fields")]
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// The link of a camera's sender carries nothing for a while, and everything late.
    StallLink { camera: usize, lasts: Duration },
    /// The link of a camera's sender breaks in the middle of a message.
    BreakLink { camera: usize },
    /// The sender of a camera ends; another run of it begins later.
    LoseSender { camera: usize, lasts: Duration },
    /// Another sender tries to feed the same camera.
    DuplicateSender { camera: usize },
    /// Connections that send nothing useful.
    FloodConnections { count: usize },
    /// Subscriptions with different selections.
    FloodSubscriptions { count: usize },
    /// Random bytes on the port.
    Garbage,
    /// Subscribers that do not read.
    SlowReaders { count: usize },
    /// Messages far larger than allowed.
    Oversized,
    /// Requests with a foreign host name.
    BadHost,
    /// A sender that repeats sequence numbers, sends nonsense and stops in the middle.
    HostileSender,
    /// The server is stopped and started again.
    Restart { pause: Duration },
    /// The server is killed and started again.
    Kill { pause: Duration },
    /// The disk has no space left.
    FullDisk { lasts: Duration },
    /// Each call to the disk takes long.
    SlowDisk { lasts: Duration, delay: Duration },
    /// Calls to the disk do not return.
    HungDisk { lasts: Duration },
    /// The clock of the server's computer is set.
    StepClock { by_s: f64 },
}

/// The faults of a run in the order of their times.
#[derive(Clone, Debug, PartialEq)]
pub struct Timetable {
    /// A camera without faults.
    pub healthy_camera: usize,
    /// Time from the start of the world to the stop of the server.
    pub length_s: f64,
    /// Seconds after the start of the world.
    pub faults: Vec<(f64, Fault)>,
    /// The disk hangs while the server is stopped.
    pub disk_hangs_at_stop: bool,
}

impl Timetable {
    /// The faults of a seed.
    pub fn new(seed: u64, stage: Stage) -> Self {
        let mut random = Random::new(seed, 700);
        let healthy_camera = below(&mut random, CAMERAS);
        let (length_s, count) = match stage {
            Stage::Library => (random.uniform(5.0, 7.0), 4 + below(&mut random, 6)),
            Stage::Process => (random.uniform(9.0, 12.0), 6 + below(&mut random, 6)),
        };
        let mut times: Vec<f64> =
            (0..count).map(|_| random.uniform(BEFORE_S, length_s - AFTER_S)).collect();
        times.sort_by(f64::total_cmp);
        let mut faults: Vec<(f64, Fault)> = Vec::new();
        for at_s in times {
            let fault = choose(&mut random, stage, healthy_camera);
            // Each start takes a while; a server that never runs promises nothing.
            let is_start =
                |fault: &Fault| matches!(fault, Fault::Restart { .. } | Fault::Kill { .. });
            let starts = faults.iter().filter(|(_, it)| is_start(it)).count();
            if !is_start(&fault) || starts < 2 {
                faults.push((at_s, fault));
            }
        }
        let disk_hangs_at_stop = stage == Stage::Process && random.uniform(0.0, 1.0) < 0.25;
        Self { healthy_camera, length_s, faults, disk_hangs_at_stop }
    }
}

fn choose(random: &mut Random, stage: Stage, healthy_camera: usize) -> Fault {
    let camera = (healthy_camera + 1 + below(random, CAMERAS - 1)) % CAMERAS;
    let lasts = Duration::from_secs_f64(random.uniform(0.2, 2.5));
    let pause = Duration::from_secs_f64(random.uniform(0.0, 0.5));
    let by_s =
        random.uniform(0.05, 100.0) * if random.uniform(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
    let choices = match stage {
        Stage::Library => 12,
        Stage::Process => 18,
    };
    match below(random, choices) {
        0 => Fault::StallLink { camera, lasts },
        1 => Fault::BreakLink { camera },
        2 => Fault::LoseSender { camera, lasts },
        3 => Fault::DuplicateSender { camera: below(random, CAMERAS) },
        4 => Fault::FloodConnections { count: 20 + below(random, 100) },
        5 => Fault::FloodSubscriptions { count: 10 + below(random, 40) },
        6 => Fault::Garbage,
        7 => Fault::SlowReaders { count: 1 + below(random, 10) },
        8 => Fault::Oversized,
        9 => Fault::BadHost,
        10 => Fault::HostileSender,
        11 => Fault::Restart { pause },
        12 | 13 => Fault::Kill { pause },
        14 => Fault::FullDisk { lasts },
        15 => Fault::SlowDisk { lasts, delay: Duration::from_secs_f64(random.uniform(0.001, 0.1)) },
        16 => Fault::HungDisk { lasts },
        _ => Fault::StepClock { by_s },
    }
}

fn below(random: &mut Random, count: usize) -> usize {
    (random.next_u64() % count as u64) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_has_one_timetable_and_its_healthy_camera_has_no_fault() {
        for seed in 0..200 {
            let timetable = Timetable::new(seed, Stage::Process);
            assert_eq!(timetable, Timetable::new(seed, Stage::Process));
            for (at_s, fault) in &timetable.faults {
                assert!((BEFORE_S..timetable.length_s).contains(at_s));
                if let Fault::StallLink { camera, .. }
                | Fault::BreakLink { camera }
                | Fault::LoseSender { camera, .. } = fault
                {
                    assert_ne!(*camera, timetable.healthy_camera);
                }
            }
        }
    }
}
