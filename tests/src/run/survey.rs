//! Calibrates reference installations from robots that drive about, and prints one table. Progress goes to standard error.

use std::{process::ExitCode, time::Instant};

use roundel_core::calib::arena::{
    ArenaCalibration, ArenaCamera, ArenaParams, LensDeviation, Recording, calibrate,
};
use roundel_tests::{
    arena::Arena,
    sensor::Sensing,
    survey::{Survey, SurveyError, WrongLenses, world_error_m},
};

use super::exit_code;

/// Noise of precise detections, an upper limit.
const NOISE_PX: f64 = 0.03;
/// Bar for the mean normalized squared error per degree of freedom, from [`MIN_SEEDS`] on.
const CONSISTENT: std::ops::RangeInclusive<f64> = 0.6..=1.4;
const MIN_SEEDS: u64 = 10;
/// Deviations of lenses before they are refined: focal length, relative, and principal point, pixels.
const LENS: (f64, f64) = (5e-4, 0.5);

/// One row: an installation and its bar.
struct Case {
    name: &'static str,
    arena: fn(u64) -> Arena,
    seconds: f64,
    max_hz: f64,
    seeds: u64,
    record: fn(&Survey, &Case) -> (Recording, Vec<ArenaCamera>),
    bar: Bar,
}

/// Largest errors allowed: positions and rotations of cameras, points of the arena; and the longest calibration.
#[derive(Clone, Copy, Debug)]
struct Bar {
    position_m: f64,
    rotation_deg: f64,
    world_m: f64,
    took_s: f64,
}

#[derive(clap::Args)]
pub struct Options {
    #[arg(default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    /// Only rows whose names contain one of these words
    words: Vec<String>,
}

pub fn run(options: &Options) -> ExitCode {
    println!(
        "| installation | cameras, rms (stated) | rotation, rms (stated) | inside 95 %, mean square | points of the arena, rms | clocks, rms | time, max | bar | holds |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    let words = &options.words;
    let mut holds = true;
    for case in cases(options.seeds) {
        if words.is_empty() || words.iter().any(|word| case.name.contains(word.as_str())) {
            holds &= run_case(&case);
        }
    }
    exit_code(holds)
}

fn cases(seeds: u64) -> [Case; 4] {
    let r4 = Case {
        name: "R4, clocks unknown",
        arena: |seed| Arena::r4(seed).with_unsynchronized_clocks(),
        seconds: 60.0,
        max_hz: 60.0,
        seeds,
        record: |survey, case| {
            (survey.record(sensing(), case.seconds, case.max_hz), survey.cameras())
        },
        bar: Bar { position_m: 0.5e-3, rotation_deg: 0.005, world_m: 0.5e-3, took_s: 20.0 },
    };
    let lenses = Case {
        name: "R4, lenses known to 0.05 % and 0.5 px, refined",
        record: |survey, case| {
            let wrong = WrongLenses::drawn(survey, LENS.0, LENS.1);
            let deviation = LensDeviation { focal: LENS.0, center_px: LENS.1, radial: 1e-4 };
            let recording = wrong.record(survey, sensing(), case.seconds, case.max_hz);
            (recording, wrong.cameras(survey, Some(deviation)))
        },
        // A lens and its camera pose can compensate for each other, so only the world's error is held tightly.
        bar: Bar { position_m: 5e-3, rotation_deg: 0.05, world_m: 1e-3, took_s: 60.0 },
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
        arena: |seed| Arena::r16(seed).with_unsynchronized_clocks(),
        seconds: 120.0,
        max_hz: 20.0,
        seeds: seeds.div_ceil(5),
        bar: Bar { position_m: 3e-3, rotation_deg: 0.02, world_m: 3e-3, took_s: 180.0 },
        ..r4
    };
    [r4, lenses, pixels, r16]
}

fn sensing() -> Sensing {
    Sensing { noise_px: NOISE_PX, bias_persists_while_still: true, ..Sensing::DEFAULT }
}

/// Errors over all seeds of a case.
#[derive(Default)]
struct Score {
    errors: Vec<SurveyError>,
    /// Stated variances of each error: of the position in m², of the rotation in rad².
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

    /// Position error and stated deviation of each camera, rms over seeds, mm.
    fn by_camera_mm(&self, cameras: usize) -> Vec<(f64, f64)> {
        let one = |camera: usize| {
            let is_own = |index: &usize| index % cameras == camera;
            let indices = || (0..self.errors.len()).filter(is_own);
            let error = rms(indices().map(|index| self.errors[index].position_m));
            (error * 1e3, rms(indices().map(|index| self.stated[index][0].sqrt())) * 1e3)
        };
        (0..cameras).map(one).collect()
    }
}

fn run_case(case: &Case) -> bool {
    let mut score = Score::default();
    let mut camera_count = 0;
    for seed in 1..=case.seeds {
        let survey = Survey::new((case.arena)(seed));
        camera_count = survey.arena.sites.len();
        let (recording, cameras) = (case.record)(&survey, case);
        let started = Instant::now();
        let params = ArenaParams::default();
        let found = calibrate(&recording, &cameras, &survey.references, &params, |_| true);
        score.took_s = score.took_s.max(started.elapsed().as_secs_f64());
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
        eprintln!("{}, seed {seed}: {:.1} s", case.name, started.elapsed().as_secs_f64());
    }
    let is_complete = score.errors.len() as u64 == camera_count as u64 * case.seeds;
    let holds = report(case, &score) && is_complete;
    println!("{} |", if holds { "yes" } else { "**no**" });
    if is_complete && camera_count > 4 {
        let pairs = score.by_camera_mm(camera_count).into_iter();
        let texts: Vec<String> =
            pairs.map(|(error, stated)| format!("{error:.2} ({stated:.2})")).collect();
        eprintln!("{}, by camera, mm (stated): {}", case.name, texts.join(", "));
    }
    holds
}

/// Prints the row except its last column, and returns whether it holds.
fn report(case: &Case, score: &Score) -> bool {
    let (position_m, rotation_deg) =
        (score.rms(|it| it.position_m), score.rms(|it| it.rotation_rad).to_degrees());
    let stated = |which: usize| rms(score.stated.iter().map(|stated| stated[which].sqrt()));
    let count = score.errors.len() as f64;
    // χ² with 6 degrees of freedom. Cameras of one arena share the references' errors, so a few seeds show little.
    let inside = score.errors.iter().filter(|it| it.square < 12.592).count() as f64 / count;
    let square = score.errors.iter().map(|it| it.square).sum::<f64>() / (6.0 * count);
    let world_m = rms(score.world_m.iter().copied());
    print!(
        "| {}, {:.0} s, {} seeds | {:.2} mm ({:.2}) | {rotation_deg:.4}° ({:.4}) | {:.0} %, {square:.2} | {:.2} mm | {:.3} ms | {:.1} s | {} mm, {}°, {} mm, {} s | ",
        case.name,
        case.seconds,
        case.seeds,
        position_m * 1e3,
        stated(0) * 1e3,
        stated(1).to_degrees(),
        inside * 100.0,
        world_m * 1e3,
        score.rms(|it| it.clock_s) * 1e3,
        score.took_s,
        case.bar.position_m * 1e3,
        case.bar.rotation_deg,
        case.bar.world_m * 1e3,
        case.bar.took_s,
    );
    let is_consistent = case.seeds < MIN_SEEDS || CONSISTENT.contains(&square);
    is_consistent
        && position_m <= case.bar.position_m
        && rotation_deg <= case.bar.rotation_deg
        && world_m <= case.bar.world_m
        && score.took_s <= case.bar.took_s
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) =
        values.fold((0.0, 0.0), |(sum, count), value| (sum + value * value, count + 1.0));
    (sum / count).sqrt()
}
