//! Calibrates reference installations from robots that drive about and prints one table:
//! `cargo run --release -p roundel-tests --bin survey [-- SEEDS [NAME…]]`; 20 seeds without them, and of rows those
//! whose names have one of the words in them. What is under way is told on the standard error. Ends with 1 if a row
//! misses its bar.

use std::{process::ExitCode, time::Instant};

use roundel_core::calib::arena::{
    ArenaCalibration, ArenaCamera, ArenaParams, LensDeviation, Recording, calibrate,
};
use roundel_tests::{
    arena::Arena,
    sensor::Sensing,
    survey::{Mistaken, Survey, SurveyError, world_error_m},
};

/// What precise detections of the reference installations err by, at most, pixels.
const NOISE_PX: f64 = 0.03;
/// Mean of errors squared over their covariance, a degree of freedom, from so many seeds on.
const HONEST: std::ops::RangeInclusive<f64> = 0.6..=1.4;
const ENOUGH_SEEDS: u64 = 10;
/// How well lenses that are to be refined are known: focal length, relative, and principal point, pixels.
const LENS: (f64, f64) = (5e-4, 0.5);

/// An installation with its bar.
struct Case {
    name: &'static str,
    arena: fn(u64) -> Arena,
    seconds: f64,
    most_hz: f64,
    seeds: u64,
    record: fn(&Survey, &Case) -> (Recording, Vec<ArenaCamera>),
    most: Most,
}

/// Of a case's errors: cameras' places and turns, points of the arena, and the time that it takes.
#[derive(Clone, Copy, Debug)]
struct Most {
    off_m: f64,
    turn_deg: f64,
    world_m: f64,
    took_s: f64,
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
    println!(
        "| installation | cameras, rms (stated) | rotation, rms (stated) | inside 95 %, mean square | points of the arena, rms | clocks, rms | time, most | bar | holds |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    let is_wanted = |case: &&Case| {
        words.is_empty() || words.iter().any(|word| case.name.contains(word.as_str()))
    };
    let held: Vec<bool> = cases(seeds).iter().filter(is_wanted).map(run).collect();
    if held.iter().all(|held| *held) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn cases(seeds: u64) -> [Case; 4] {
    let r4 = Case {
        name: "R4, clocks unknown",
        arena: |seed| Arena::r4(seed).with_unset_clocks(),
        seconds: 60.0,
        most_hz: 60.0,
        seeds,
        record: |survey, case| {
            (survey.record(sensing(), case.seconds, case.most_hz), survey.cameras())
        },
        most: Most { off_m: 0.5e-3, turn_deg: 0.005, world_m: 0.5e-3, took_s: 20.0 },
    };
    let lenses = Case {
        name: "R4, lenses known to 0.05 % and 0.5 px, refined",
        record: |survey, case| {
            let mistaken = Mistaken::drawn(survey, LENS.0, LENS.1);
            let deviation = LensDeviation { focal: LENS.0, center_px: LENS.1, radial: 1e-4 };
            let recording = mistaken.record(survey, sensing(), case.seconds, case.most_hz);
            (recording, mistaken.cameras(survey, Some(deviation)))
        },
        // Where a lens and its place make up for one another the world is what counts.
        most: Most { off_m: 5e-3, turn_deg: 0.05, world_m: 1e-3, took_s: 60.0 },
        ..r4
    };
    let pixels = Case {
        name: "R4 from pixels, clocks right, every sixth frame",
        arena: |seed| {
            let mut arena = Arena::r4(seed);
            arena.sites.iter_mut().for_each(|site| site.rate_hz = 10.0);
            arena
        },
        seeds: seeds.div_ceil(10),
        record: |survey, case| {
            (survey.record_pixels((case.seconds * 10.0) as usize), survey.cameras())
        },
        ..r4
    };
    let r16 = Case {
        name: "R16, clocks unknown",
        arena: |seed| Arena::r16(seed).with_unset_clocks(),
        seconds: 120.0,
        most_hz: 20.0,
        seeds: seeds.div_ceil(5),
        most: Most { off_m: 3e-3, turn_deg: 0.02, world_m: 3e-3, took_s: 180.0 },
        ..r4
    };
    [r4, lenses, pixels, r16]
}

fn sensing() -> Sensing {
    Sensing { noise_px: NOISE_PX, is_kept_while_still: true, ..Sensing::USUAL }
}

/// What all seeds of a case gave.
#[derive(Default)]
struct Score {
    errors: Vec<SurveyError>,
    /// Squares of what is stated: metres and radians, of each error.
    stated: Vec<[f64; 2]>,
    world_m: Vec<f64>,
    took_s: f64,
}

impl Score {
    fn add(&mut self, survey: &Survey, case: &Case, found: &ArenaCalibration) {
        for camera in &found.cameras {
            self.errors.push(survey.error(camera, case.seconds));
            let part = |first: usize| camera.covariance.fixed_view::<3, 3>(first, first).trace();
            self.stated.push([part(0), part(3)]);
        }
    }

    fn rms(&self, part: impl Fn(&SurveyError) -> f64) -> f64 {
        rms(self.errors.iter().map(part))
    }

    /// Of each camera in turn: how far off and how far stated, rms over seeds, mm.
    fn along_mm(&self, cameras: usize) -> Vec<(f64, f64)> {
        let one = |camera: usize| {
            let of = |index: &usize| index % cameras == camera;
            let indices = || (0..self.errors.len()).filter(of);
            let off = rms(indices().map(|index| self.errors[index].off_m));
            (off * 1e3, rms(indices().map(|index| self.stated[index][0].sqrt())) * 1e3)
        };
        (0..cameras).map(one).collect()
    }
}

fn run(case: &Case) -> bool {
    let mut score = Score::default();
    let mut cameras_of = 0;
    for seed in 1..=case.seeds {
        let survey = Survey::new((case.arena)(seed));
        cameras_of = survey.arena.sites.len();
        let (recording, cameras) = (case.record)(&survey, case);
        let begun = Instant::now();
        let params = ArenaParams::default();
        let found = calibrate(&recording, &cameras, &survey.references, &params, |_| true);
        score.took_s = score.took_s.max(begun.elapsed().as_secs_f64());
        let found = match found {
            Ok(found) => found,
            Err(error) => {
                println!("| {} | seed {seed}: {error} | | | | | | | **no** |", case.name);
                return false;
            }
        };
        for finding in &found.findings {
            eprintln!("{}, seed {seed}: {finding}", case.name);
        }
        score.add(&survey, case, &found);
        score.world_m.extend(world_error_m(&survey, &found, &cameras));
        eprintln!("{}, seed {seed}: {:.1} s", case.name, begun.elapsed().as_secs_f64());
    }
    let is_complete = score.errors.len() as u64 == cameras_of as u64 * case.seeds;
    let holds = report(case, &score) && is_complete;
    println!("{} |", if holds { "yes" } else { "**no**" });
    if is_complete && cameras_of > 4 {
        let along = score.along_mm(cameras_of).into_iter();
        let along: Vec<String> =
            along.map(|(off, stated)| format!("{off:.2} ({stated:.2})")).collect();
        eprintln!("{}, cameras in turn, mm (stated): {}", case.name, along.join(", "));
    }
    holds
}

/// Prints the row up to whether it holds, and says so.
fn report(case: &Case, score: &Score) -> bool {
    let (off_m, turn_deg) = (score.rms(|it| it.off_m), score.rms(|it| it.turn_rad).to_degrees());
    let stated = |which: usize| rms(score.stated.iter().map(|stated| stated[which].sqrt()));
    let count = score.errors.len() as f64;
    // χ², 6 degrees of freedom; cameras of one arena share the references' errors, so a few seeds say little.
    let inside = score.errors.iter().filter(|it| it.square < 12.592).count() as f64 / count;
    let square = score.errors.iter().map(|it| it.square).sum::<f64>() / (6.0 * count);
    let world_m = rms(score.world_m.iter().copied());
    print!(
        "| {}, {:.0} s, {} seeds | {:.2} mm ({:.2}) | {turn_deg:.4}° ({:.4}) | {:.0} %, {square:.2} | {:.2} mm | {:.3} ms | {:.1} s | {} mm, {}°, {} mm, {} s | ",
        case.name,
        case.seconds,
        case.seeds,
        off_m * 1e3,
        stated(0) * 1e3,
        stated(1).to_degrees(),
        inside * 100.0,
        world_m * 1e3,
        score.rms(|it| it.clock_s) * 1e3,
        score.took_s,
        case.most.off_m * 1e3,
        case.most.turn_deg,
        case.most.world_m * 1e3,
        case.most.took_s,
    );
    let is_honest = case.seeds < ENOUGH_SEEDS || HONEST.contains(&square);
    is_honest
        && off_m <= case.most.off_m
        && turn_deg <= case.most.turn_deg
        && world_m <= case.most.world_m
        && score.took_s <= case.most.took_s
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) =
        values.fold((0.0, 0.0), |(sum, count), value| (sum + value * value, count + 1.0));
    (sum / count).sqrt()
}
