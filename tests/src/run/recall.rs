//! Share of roundels that are found, by size, with every miss and every false detection; then the false detections in
//! frames of clutter alone.

use std::process::ExitCode;

use rayon::prelude::*;
use roundel_core::marker::Scratch;
use roundel_tests::{
    clutter::Clutter,
    recall::{Outcome, Plan, Range, Scene, Scenes},
};

/// Limits of the table's rows: shorter diameters.
const SIZES_PX: [f64; 8] = [10.0, 12.0, 16.0, 24.0, 40.0, 70.0, 120.0, 200.0];

#[derive(clap::Args)]
pub struct Options {
    #[arg(default_value_t = 5000)]
    roundels: usize,
    #[arg(default_value_t = 1000)]
    clutter_frames: u64,
    #[arg(default_value_t = 1)]
    seed: u64,
}

pub fn run(options: &Options) -> ExitCode {
    roundels(options.roundels, options.seed);
    clutter(options.clutter_frames, options.seed);
    ExitCode::SUCCESS
}

fn roundels(count: usize, seed: u64) {
    let plans: Vec<Plan> = Scenes::new(Range::default(), count, seed).collect();
    println!("{count} roundels in {} frames", plans.len());
    let judged: Vec<(Scene, [Outcome; 2])> = plans
        .into_par_iter()
        .map(|plan| {
            let mut scene = plan.render();
            let mut scratch = Scratch::default();
            let outcomes = [true, false]
                .map(|print_is_known| scene.judge(&scene.detector(print_is_known), &mut scratch));
            // The report does not need the pixels.
            scene.image.pixels = Vec::new();
            (scene, outcomes)
        })
        .collect();
    for (which, name) in ["print known", "any ratio"].into_iter().enumerate() {
        report(name, judged.iter().map(|(scene, outcomes)| (scene, &outcomes[which])));
    }
}

fn report<'a>(name: &str, judged: impl Iterator<Item = (&'a Scene, &'a Outcome)>) {
    println!("\n{name}");
    let mut bins = [(0, 0); SIZES_PX.len() - 1];
    let mut false_detections = 0;
    for (scene, outcome) in judged {
        let about = format!(
            "frame {:#x}, ratio {:.3}, blur {:.2} px, noise {:.1}, black {:.0}, white {:.0}, \
             gradient {:+.2} {:+.2}",
            scene.seed,
            scene.ratio,
            scene.imaging.blur_px,
            scene.imaging.noise,
            scene.imaging.black,
            scene.imaging.white,
            scene.imaging.gradient[0],
            scene.imaging.gradient[1],
        );
        for shown in &scene.shown {
            let minor_px = 2.0 * shown.rim.semi_minor_px;
            let bin = SIZES_PX[1..].iter().position(|&limit| minor_px < limit);
            bins[bin.unwrap_or(bins.len() - 1)].0 += 1;
        }
        for miss in &outcome.missed {
            let rim = &miss.shown.rim;
            let minor_px = 2.0 * rim.semi_minor_px;
            let bin = SIZES_PX[1..].iter().position(|&limit| minor_px < limit);
            bins[bin.unwrap_or(bins.len() - 1)].1 += 1;
            println!(
                "  missed {:.1} x {:.1} px, tilt {:.0}°, at ({:.1}, {:.1}), {about}: {:?}",
                2.0 * rim.semi_major_px,
                minor_px,
                miss.shown.tilt_rad.to_degrees(),
                rim.center.x,
                rim.center.y,
                miss.rejects
            );
        }
        for ring in &outcome.false_detections {
            false_detections += 1;
            println!(
                "  false {:.1} x {:.1} px, ratio {:.2}, at ({:.1}, {:.1}), {about}",
                2.0 * ring.outer.semi_major_px,
                2.0 * ring.outer.semi_minor_px,
                ring.inner.mean_radius_px() / ring.outer.mean_radius_px(),
                ring.outer.center.u,
                ring.outer.center.v
            );
        }
    }
    println!("  shorter diameter | shown | missed | found");
    for (sizes, (shown, missed)) in SIZES_PX.windows(2).zip(bins) {
        let found = 100.0 * f64::from(shown - missed) / f64::from(shown.max(1));
        println!(
            "  {:4.0} to {:4.0} px  | {shown:5} | {missed:6} | {found:.2} %",
            sizes[0], sizes[1]
        );
    }
    let (shown, missed) = bins.iter().fold((0, 0), |sum, bin| (sum.0 + bin.0, sum.1 + bin.1));
    println!(
        "  found {} of {shown}: {:.3} %; {false_detections} false detections",
        shown - missed,
        100.0 * f64::from(shown - missed) / f64::from(shown.max(1))
    );
}

fn clutter(frames: u64, seed: u64) {
    println!("\n{frames} frames of clutter, any ratio");
    let false_detections: usize = (0..frames)
        .into_par_iter()
        .map(|frame| {
            let scene = Plan::empty(Clutter::JUNK, (seed << 40) + frame).render();
            let outcome = scene.judge(&scene.detector(false), &mut Scratch::default());
            for ring in &outcome.false_detections {
                println!("  false in frame {:#x}: {ring:?}", scene.seed);
            }
            outcome.false_detections.len()
        })
        .sum();
    println!("  {false_detections} false detections");
}
