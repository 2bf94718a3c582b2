//! Bumps cameras of R4, lets one drift, and prints what the watch makes of it as one table:
//! `cargo run --release -p roundel-tests --bin healing [-- HOURS]`; the long run takes 24 h of virtual time
//! without it. The column of tracks has the largest error of an object that is seen and said to be known to 1.5 mm,
//! within three seconds of the bump. Bumps that are not answered well are told on the standard error. Ends with 1 if a row misses
//! its bar.

use std::{process::ExitCode, time::Instant};

use roundel_core::{calib::watch::WatchParams, id::CameraId, world::FusionParams};
use roundel_tests::{
    healing::{Answer, Healing, Move, Outcome},
    normal::Random,
};

/// Errors of precise and of fast detections, pixels.
const PRECISE_PX: f64 = 0.03;
const FAST_PX: f64 = 0.1;
/// What tracks may be off by while a camera is bumped, metres.
const MOST_OFF_M: f64 = 5e-3;
/// Seeds of the short rows.
const SEEDS: u64 = 10;
/// A long run is of cameras with so many frames a second.
const SLOW_HZ: f64 = 12.0;
const BUMPS_A_DAY: f64 = 20.0;

fn main() -> ExitCode {
    let argument = std::env::args().nth(1);
    let hours = match argument.as_deref().map(str::parse) {
        None => 24.0,
        Some(Ok(hours)) if hours > 0.0 => hours,
        _ => {
            eprintln!("expected hours above 0, found {}", argument.unwrap_or_default());
            return ExitCode::from(2);
        }
    };
    println!(
        "| R4 | bumps | noticed, most | returned, most | off, most | tracks, most | imagined | corrections | else off, most | took | holds |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    let degree = 1f64.to_radians();
    let held = [
        bumped("2 cm", (0.02, 0.0), PRECISE_PX, 1),
        bumped("1°", (0.0, degree), PRECISE_PX, 1),
        bumped("2 cm, fast mode", (0.02, 0.0), FAST_PX, 1),
        bumped("1°, fast mode", (0.0, degree), FAST_PX, 1),
        bumped("two at once, 2 cm and 1°", (0.02, degree), PRECISE_PX, 2),
        drifting(),
        wrong_lenses(),
        lasting(hours),
    ];
    if held.iter().all(|held| *held) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// So many cameras of each seed bumped at once.
fn bumped(name: &str, size: (f64, f64), noise_px: f64, count: u64) -> bool {
    let begun = Instant::now();
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
            eprintln!("{name}, seed {seed}: {:?}", outcome.answers);
        }
        tracks_m = tracks_m.max(healing.follow(FusionParams::default(), 14.0).meanwhile_m);
        all.answers.extend(outcome.answers);
        all.imagined += outcome.imagined;
        all.corrections += outcome.corrections;
        all.worst_m = all.worst_m.max(outcome.worst_m);
    }
    let holds = all.is_healed() && tracks_m <= MOST_OFF_M;
    row(name, (&all, Some(tracks_m)), begun, holds)
}

/// One camera drifts by 1 cm an hour.
fn drifting() -> bool {
    let begun = Instant::now();
    let mut healing = Healing::r4(1, SLOW_HZ, PRECISE_PX);
    let size = (0.01, 0.02f64.to_radians());
    let drift = Move::bump(CameraId(1), 60.0, size, &mut Random::new(1, 79));
    healing.moves.push(Move { lasts_s: 3600.0, ..drift });
    let outcome = healing.run(WatchParams::default(), 3660.0);
    row(
        "1 h of drift, 1 cm",
        (&outcome, None),
        begun,
        outcome.is_healed() && outcome.worst_m <= 1e-3,
    )
}

/// Lenses are wrong. Places take that up as well as they can, within minutes; from then on nothing is to be corrected.
fn wrong_lenses() -> bool {
    let begun = Instant::now();
    let mut all = Outcome::default();
    for seed in 1..=4 {
        let healing = Healing::r4(seed, SLOW_HZ, PRECISE_PX).with_wrong_lenses();
        let first = healing.run(WatchParams::default(), 300.0);
        let outcome = healing.as_found(&first).run(WatchParams::default(), 3600.0);
        all.imagined += outcome.imagined;
        all.corrections += outcome.corrections;
        all.worst_m = all.worst_m.max(outcome.worst_m);
    }
    let holds = all.imagined == 0 && all.corrections == 0;
    row("4 × 1 h, lenses off by 0.05 % and 0.5 px", (&all, None), begun, holds)
}

/// Hours with bumps now and then.
fn lasting(hours: f64) -> bool {
    let begun = Instant::now();
    let seconds = hours * 3600.0;
    let bumps = (hours / 24.0 * BUMPS_A_DAY).round() as usize;
    let healing = Healing::r4(1, SLOW_HZ, PRECISE_PX).with_bumps(bumps, seconds);
    let outcome = healing.run(WatchParams::default(), seconds);
    for (bump, answer) in healing.moves.iter().zip(&outcome.answers) {
        let is_well = answer.returned_s.is_some() && answer.off_m <= 1e-3;
        if !is_well {
            eprintln!("{bump:?}: {answer:?}");
        }
    }
    row(&format!("{hours} h"), (&outcome, None), begun, outcome.is_healed())
}

fn row(
    name: &str,
    (outcome, tracks_m): (&Outcome, Option<f64>),
    begun: Instant,
    holds: bool,
) -> bool {
    let most = |part: fn(&Answer) -> f64| outcome.answers.iter().map(part).fold(0.0, f64::max);
    println!(
        "| {name} | {} | {:.2} s | {:.1} s | {:.2} mm, {:.4}° | {} | {} | {} | {:.2} mm | {:.0} s | {} |",
        outcome.answers.len(),
        most(|it| it.noticed_s.unwrap_or(f64::INFINITY)),
        most(|it| it.returned_s.unwrap_or(f64::INFINITY)),
        most(|it| it.off_m) * 1e3,
        most(|it| it.off_rad).to_degrees(),
        tracks_m.map_or("—".into(), |off_m| format!("{:.2} mm", off_m * 1e3)),
        outcome.imagined,
        outcome.corrections,
        outcome.worst_m * 1e3,
        begun.elapsed().as_secs_f64(),
        if holds { "yes" } else { "**no**" },
    );
    holds
}
