//! Bumps cameras of R4, lets one drift, and prints how the watch reacts as one table. The column "tracks" is the largest
//! error, within three seconds of a bump, of an observed object whose stated deviation is below 1.5 mm. Details of bumps
//! that miss a bar go to standard error.

use std::{process::ExitCode, time::Instant};

use roundel_core::{calib::watch::WatchParams, id::CameraId, world::FusionParams};
use roundel_tests::{
    healing::{BumpSize, Healing, Move, Outcome, Response},
    random::Random,
};

use super::{exit_code, positive};

/// Noise of precise and of fast detections.
const PRECISE_PX: f64 = 0.03;
const FAST_PX: f64 = 0.1;
/// Bar for tracks while a camera is bumped.
const MAX_TRACK_ERROR_M: f64 = 5e-3;
/// Seeds of each short row.
const SEEDS: u64 = 10;
/// Frame rate of the long runs.
const SLOW_HZ: f64 = 12.0;
const BUMPS_A_DAY: f64 = 20.0;

#[derive(clap::Args)]
pub struct Options {
    /// Virtual time of the long run
    #[arg(default_value = "24", value_parser = positive)]
    hours: f64,
}

pub fn run(options: &Options) -> ExitCode {
    println!(
        "| R4 | bumps | detected, max | returned, max | error then, max | tracks, max | false alarms | corrections | error otherwise, max | took | holds |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    let degree = 1f64.to_radians();
    let holds = [
        bumped("2 cm", BumpSize::shift(0.02), PRECISE_PX, 1),
        bumped("1°", BumpSize::turn(degree), PRECISE_PX, 1),
        bumped("2 cm, fast mode", BumpSize::shift(0.02), FAST_PX, 1),
        bumped("1°, fast mode", BumpSize::turn(degree), FAST_PX, 1),
        bumped(
            "two at once, 2 cm and 1°",
            BumpSize { shift_m: 0.02, turn_rad: degree },
            PRECISE_PX,
            2,
        ),
        drifting(),
        wrong_lenses(),
        long_run(options.hours),
    ];
    exit_code(holds.iter().all(|holds| *holds))
}

/// Bumps `count` cameras of each seed at almost the same time.
fn bumped(name: &str, size: BumpSize, noise_px: f64, count: u64) -> bool {
    let started = Instant::now();
    let (mut all, mut tracks_m) = (Outcome::default(), 0.0f64);
    for seed in 1..=SEEDS {
        let mut healing = Healing::r4(seed, 60.0, noise_px);
        let mut random = Random::new(seed, 78);
        for other in 0..count {
            let camera = CameraId(((seed + other) % 4) as u32);
            let at_s = 10.03 + 0.02 * other as f64;
            healing.moves.push(Move::bump(camera, at_s, size, &mut random));
        }
        let outcome = healing.run(WatchParams::default(), 45.0);
        if !outcome.is_healed() {
            eprintln!("{name}, seed {seed}: {:?}", outcome.responses);
        }
        tracks_m = tracks_m.max(healing.track(FusionParams::default(), 14.0).aftermath_m);
        all.responses.extend(outcome.responses);
        all.false_alarms += outcome.false_alarms;
        all.corrections += outcome.corrections;
        all.worst_m = all.worst_m.max(outcome.worst_m);
    }
    let holds = all.is_healed() && tracks_m <= MAX_TRACK_ERROR_M;
    row(name, &all, Some(tracks_m), started, holds)
}

/// One camera drifts by 1 cm an hour.
fn drifting() -> bool {
    let started = Instant::now();
    let mut healing = Healing::r4(1, SLOW_HZ, PRECISE_PX);
    let size = BumpSize { shift_m: 0.01, turn_rad: 0.02f64.to_radians() };
    let drift = Move::bump(CameraId(1), 60.0, size, &mut Random::new(1, 79));
    healing.moves.push(Move { lasts_s: 3600.0, ..drift });
    let outcome = healing.run(WatchParams::default(), 3660.0);
    row(
        "1 h of drift, 1 cm",
        &outcome,
        None,
        started,
        outcome.is_healed() && outcome.worst_m <= 1e-3,
    )
}

/// Wrong lenses. Camera poses absorb their errors within minutes; from then on nothing must be corrected.
fn wrong_lenses() -> bool {
    let started = Instant::now();
    let mut all = Outcome::default();
    for seed in 1..=4 {
        let healing = Healing::r4(seed, SLOW_HZ, PRECISE_PX).with_wrong_lenses();
        let first = healing.run(WatchParams::default(), 300.0);
        let outcome = healing.with_corrections(&first).run(WatchParams::default(), 3600.0);
        all.false_alarms += outcome.false_alarms;
        all.corrections += outcome.corrections;
        all.worst_m = all.worst_m.max(outcome.worst_m);
    }
    let holds = all.false_alarms == 0 && all.corrections == 0;
    row("4 × 1 h, lenses off by 0.05 % and 0.5 px", &all, None, started, holds)
}

/// Hours with twenty bumps a day.
fn long_run(hours: f64) -> bool {
    let started = Instant::now();
    let seconds = hours * 3600.0;
    let bumps = (hours / 24.0 * BUMPS_A_DAY).round() as usize;
    let healing = Healing::r4(1, SLOW_HZ, PRECISE_PX).with_bumps(bumps, seconds);
    let outcome = healing.run(WatchParams::default(), seconds);
    for (bump, response) in healing.moves.iter().zip(&outcome.responses) {
        let is_healed = response.returned_s.is_some() && response.position_error_m <= 1e-3;
        if !is_healed {
            eprintln!("{bump:?}: {response:?}");
        }
    }
    row(&format!("{hours} h"), &outcome, None, started, outcome.is_healed())
}

fn row(
    name: &str,
    outcome: &Outcome,
    tracks_m: Option<f64>,
    started: Instant,
    holds: bool,
) -> bool {
    let max = |part: fn(&Response) -> f64| outcome.responses.iter().map(part).fold(0.0, f64::max);
    println!(
        "| {name} | {} | {:.2} s | {:.1} s | {:.2} mm, {:.4}° | {} | {} | {} | {:.2} mm | {:.0} s | {} |",
        outcome.responses.len(),
        max(|it| it.detected_s.unwrap_or(f64::INFINITY)),
        max(|it| it.returned_s.unwrap_or(f64::INFINITY)),
        max(|it| it.position_error_m) * 1e3,
        max(|it| it.rotation_error_rad).to_degrees(),
        tracks_m
            .map_or("—".into(), |position_error_m| format!("{:.2} mm", position_error_m * 1e3)),
        outcome.false_alarms,
        outcome.corrections,
        outcome.worst_m * 1e3,
        started.elapsed().as_secs_f64(),
        if holds { "yes" } else { "**no**" },
    );
    holds
}
