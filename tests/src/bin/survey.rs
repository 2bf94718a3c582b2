//! Calibrates reference installations from robots that drive about and prints one table:
//! `cargo run --release -p roundel-tests --bin survey [-- SEEDS [NAME…]]`; 20 seeds without them, and of rows those
//! whose names have one of the words in them. What is under way is told on the standard error. Ends with 1 if a row
//! misses its bar.

use std::{process::ExitCode, time::Instant};

use roundel_core::calib::arena::{ArenaParams, Recording, calibrate};
use roundel_tests::{
    arena::Arena,
    sensor::Sensing,
    survey::{Survey, SurveyError},
};

/// What precise detections of the reference installations err by, at most, pixels.
const NOISE_PX: f64 = 0.03;

/// An installation with its bar.
struct Case {
    name: &'static str,
    arena: fn(u64) -> Arena,
    seconds: f64,
    most_hz: f64,
    seeds: u64,
    record: fn(&Survey, &Case) -> Recording,
    most_m: f64,
    most_deg: f64,
    most_s: f64,
}

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let argument = arguments.next();
    let words: Vec<String> = arguments.collect();
    let seeds = match argument.as_deref().map(str::parse) {
        None => 20,
        Some(Ok(seeds)) if seeds > 0 => seeds,
        _ => {
            eprintln!("expected a number of seeds above 0, found {}", argument.unwrap_or_default());
            return ExitCode::from(2);
        }
    };
    let sensed: fn(&Survey, &Case) -> Recording = |survey, case| {
        let sensing = Sensing { noise_px: NOISE_PX, ..Sensing::USUAL };
        survey.record(sensing, case.seconds, case.most_hz)
    };
    let r4 = Case {
        name: "R4, clocks unknown",
        arena: |seed| Arena::r4(seed).with_unset_clocks(),
        seconds: 60.0,
        most_hz: 60.0,
        seeds,
        record: sensed,
        most_m: 0.5e-3,
        most_deg: 0.005,
        most_s: 20.0,
    };
    let pixels = Case {
        name: "R4 from pixels, clocks right, every sixth frame",
        arena: |seed| {
            let mut arena = Arena::r4(seed);
            arena.sites.iter_mut().for_each(|site| site.rate_hz = 10.0);
            arena
        },
        seeds: seeds.div_ceil(10),
        record: |survey, case| survey.record_pixels((case.seconds * 10.0) as usize),
        ..r4
    };
    let r16 = Case {
        name: "R16, clocks unknown",
        arena: |seed| Arena::r16(seed).with_unset_clocks(),
        seconds: 120.0,
        most_hz: 20.0,
        seeds: seeds.div_ceil(5),
        most_m: 3e-3,
        most_deg: 0.02,
        most_s: 180.0,
        ..r4
    };
    println!(
        "| installation | cameras, rms (stated) | rotation, rms (stated) | inside 95 % | clocks, rms | time, most | bar | holds |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- |");
    let is_wanted = |case: &&Case| {
        words.is_empty() || words.iter().any(|word| case.name.contains(word.as_str()))
    };
    let held: Vec<bool> = [r4, pixels, r16].iter().filter(is_wanted).map(run).collect();
    if held.iter().all(|held| *held) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn run(case: &Case) -> bool {
    let mut errors: Vec<SurveyError> = Vec::new();
    let (mut stated_m, mut stated_rad, mut took_s) = (0.0, 0.0, 0.0f64);
    let (mut along, mut last_m) = (Vec::new(), (0.0, 0.0));
    for seed in 1..=case.seeds {
        let survey = Survey::new((case.arena)(seed));
        let recording = (case.record)(&survey, case);
        let begun = Instant::now();
        let found = calibrate(
            &recording,
            &survey.cameras(),
            &survey.references,
            &ArenaParams::default(),
            |_| true,
        );
        took_s = took_s.max(begun.elapsed().as_secs_f64());
        let found = match found {
            Ok(found) => found,
            Err(error) => {
                println!("| {} | seed {seed}: {error} | | | | | | **no** |", case.name);
                return false;
            }
        };
        for finding in &found.findings {
            eprintln!("{}, seed {seed}: {finding}", case.name);
        }
        for camera in &found.cameras {
            errors.push(survey.error(camera, case.seconds));
            stated_m += camera.covariance.fixed_view::<3, 3>(0, 0).trace();
            stated_rad += camera.covariance.fixed_view::<3, 3>(3, 3).trace();
        }
        let deviation =
            |index: usize| found.cameras[index].covariance.fixed_view::<3, 3>(0, 0).trace().sqrt();
        last_m = (deviation(0), deviation(found.cameras.len() - 1));
        along.push(found.cameras.len());
        eprintln!("{}, seed {seed}: {:.1} s", case.name, begun.elapsed().as_secs_f64());
    }
    let count = errors.len() as f64;
    let rms = |part: fn(&SurveyError) -> f64| {
        (errors.iter().map(|it| part(it).powi(2)).sum::<f64>() / count).sqrt()
    };
    let (off_m, turn_deg) = (rms(|it| it.off_m), rms(|it| it.turn_rad).to_degrees());
    // χ², 6 degrees of freedom.
    let inside = errors.iter().filter(|it| it.square < 12.592).count() as f64 / count;
    let complete = along.iter().all(|cameras| *cameras as f64 == count / case.seeds as f64);
    let holds =
        complete && off_m <= case.most_m && turn_deg <= case.most_deg && took_s <= case.most_s;
    println!(
        "| {}, {:.0} s, {} seeds | {:.2} mm ({:.2}); first and last camera stated {:.2} and {:.2} | {:.4}° ({:.4}) | {:.0} % | {:.3} ms | {:.1} s | {} mm, {}°, {} s | {} |",
        case.name,
        case.seconds,
        case.seeds,
        off_m * 1e3,
        (stated_m / count).sqrt() * 1e3,
        last_m.0 * 1e3,
        last_m.1 * 1e3,
        turn_deg,
        (stated_rad / count).sqrt().to_degrees(),
        inside * 100.0,
        rms(|it| it.clock_s) * 1e3,
        took_s,
        case.most_m * 1e3,
        case.most_deg,
        case.most_s,
        if holds { "yes" } else { "**no**" },
    );
    holds
}
