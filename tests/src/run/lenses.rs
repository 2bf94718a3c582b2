//! Lens calibration from 30 rendered views per seed, compared with ground truth and with the stated deviations. Fails
//! if focal lengths or the principal point are off by more than their bar, or the stated deviations are inconsistent.

use std::{
    collections::BTreeMap,
    fmt, fs,
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::Context;
#[cfg(not(feature = "chessboard"))]
use anyhow::bail;
use roundel_core::calib::lens::LensCalibration;
#[cfg(feature = "chessboard")]
use roundel_tests::board::{CHARUCO, CHESSBOARD, lens_of_chessboard};
use roundel_tests::{
    board::{
        SQUARE_M, SQUARES, board_print, camera, charuco_print, chessboard_print, imaging, lens,
        pictures, poses,
    },
    export::write_png,
    optics::Pinhole,
    random::Random,
    render::{Image, Print},
};

use super::exit_code;

const VIEWS: usize = 30;
/// Bars: relative error of focal lengths, and error of the principal point.
const MAX_FOCAL_SHARE: f64 = 5e-4;
const MAX_CENTER_PX: f64 = 0.5;
/// Bar for the rms of normalized errors, widened by this many deviations of chance.
const CONSISTENT: [f64; 2] = [0.85, 1.2];
const CHANCE: f64 = 3.0;

#[derive(clap::Args)]
pub struct Options {
    #[arg(default_value_t = 50, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    /// Calibrate from another board of the same size; needs the feature chessboard
    #[arg(long, value_enum, default_value_t = Board::Roundels)]
    board: Board,
    /// Write pictures of a chessboard at the same poses, for tests/compare/lens
    #[arg(long, value_name = "FOLDER")]
    export: Option<PathBuf>,
}

pub fn run(options: &Options) -> anyhow::Result<ExitCode> {
    let truth = camera();
    let print = options.board.print();
    let mut score = Score::default();
    for seed in 0..options.seeds {
        let poses = poses(&truth, VIEWS, &mut Random::new(seed, 0));
        let pictures = pictures(&truth, imaging(), &print, &poses, seed);
        let found = options.board.calibrate(&pictures).with_context(|| format!("seed {seed}"))?;
        score.add(&found, &truth);
        if let (0, Some(folder)) = (seed, &options.export) {
            export(folder, &poses, found.rms_px).with_context(|| folder.display().to_string())?;
        }
    }
    Ok(exit_code(score.report(&truth, options.seeds)))
}

/// Errors over all seeds.
#[derive(Default)]
struct Score {
    /// Errors over their stated deviations, by parameter.
    normalized: BTreeMap<&'static str, Vec<f64>>,
    max_focal_share: f64,
    max_center_px: f64,
    rms_px: Vec<f64>,
    models: Vec<String>,
    /// Calibrations that estimated a coefficient which is 0 in truth.
    overparameterized: usize,
}

impl Score {
    fn add(&mut self, found: &LensCalibration, truth: &Pinhole) {
        let intrinsics = found.camera.intrinsics();
        let errors = [
            intrinsics.fx_px - truth.focal_px[0],
            intrinsics.fy_px - truth.focal_px[1],
            intrinsics.cx_px - truth.center_px[0],
            intrinsics.cy_px - truth.center_px[1],
        ];
        for (error, focal_px) in errors.iter().zip(truth.focal_px) {
            self.max_focal_share = self.max_focal_share.max((error / focal_px).abs());
        }
        self.max_center_px = self.max_center_px.max(errors[2].hypot(errors[3]));
        self.rms_px.push(found.rms_px);
        self.models.push(format!("{:?}", found.model));
        let true_coefficients = truth.distortion.coefficients();
        let is_zero = |index: &usize| true_coefficients.get(*index).is_none_or(|it| *it == 0.0);
        self.overparameterized += usize::from(found.model.free().iter().any(is_zero));
        let coefficients = intrinsics.lens.coefficients().iter().zip(true_coefficients);
        let coefficient_errors: Vec<f64> =
            coefficients.map(|(found, truth)| found - truth).collect();
        let has_true_model = intrinsics.lens.name() == truth.distortion.name();
        let free = if has_true_model { found.model.free() } else { &[] };
        let free = free.iter().map(|&index| coefficient_errors[index]);
        let names = ["fx", "fy", "cx", "cy"].into_iter().chain(found.model.names());
        let errors = errors.into_iter().chain(free).zip(found.deviations());
        for (name, (error, deviation)) in names.zip(errors) {
            self.normalized.entry(name).or_default().push(error / deviation);
        }
    }

    /// Prints all, and returns whether the bars hold.
    fn report(mut self, truth: &Pinhole, seeds: u64) -> bool {
        self.models.sort();
        self.models.dedup();
        println!(
            "{VIEWS} views of {}x{}, noise 2, blur 0.8 px, {seeds} seeds",
            truth.width, truth.height
        );
        println!(
            "focal lengths at most {:.4} % off, centre {:.3} px; rms {:.4} px; {}",
            self.max_focal_share * 100.0,
            self.max_center_px,
            self.rms_px.iter().sum::<f64>() / seeds as f64,
            self.models.join(", ")
        );
        for (name, errors) in &self.normalized {
            println!("{name}: error over its stated deviation {}", Normalized(errors));
        }
        let all: Vec<f64> = self.normalized.into_values().flatten().collect();
        println!("all of them: {}", Normalized(&all));
        println!(
            "coefficients that are 0 in truth were estimated in {} of {seeds}",
            self.overparameterized
        );
        let is_exact =
            self.max_focal_share <= MAX_FOCAL_SHARE && self.max_center_px <= MAX_CENTER_PX;
        if !is_exact {
            eprintln!(
                "error: expected focal lengths at most {} % off and the centre {MAX_CENTER_PX} px",
                100.0 * MAX_FOCAL_SHARE
            );
        }
        let is_consistent = Normalized(&all).is_consistent();
        if !is_consistent {
            let [min, max] = CONSISTENT;
            eprintln!("error: expected errors of {min} to {max} times the stated deviations");
        }
        is_exact && is_consistent
    }
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Board {
    Roundels,
    Chessboard,
    Charuco,
}

impl Board {
    fn print(self) -> Print {
        match self {
            Self::Roundels => board_print(),
            Self::Chessboard => chessboard_print(),
            Self::Charuco => charuco_print(),
        }
    }

    fn calibrate(self, pictures: &[Image]) -> anyhow::Result<LensCalibration> {
        match self {
            Self::Roundels => lens(pictures).context("board of roundels"),
            #[cfg(feature = "chessboard")]
            Self::Chessboard => lens_of_chessboard(CHESSBOARD, pictures),
            #[cfg(feature = "chessboard")]
            Self::Charuco => lens_of_chessboard(CHARUCO, pictures),
            #[cfg(not(feature = "chessboard"))]
            Self::Chessboard | Self::Charuco => bail!("run it with --features chessboard"),
        }
    }
}

/// Errors over their stated deviations.
struct Normalized<'a>(&'a [f64]);

impl Normalized<'_> {
    fn rms(&self) -> f64 {
        (self.0.iter().map(|it| it * it).sum::<f64>() / self.0.len() as f64).sqrt()
    }

    fn is_consistent(&self) -> bool {
        let chance = CHANCE * (0.5 / self.0.len() as f64).sqrt();
        let [min, max] = CONSISTENT;
        (min - chance..=max + chance).contains(&self.rms())
    }
}

impl fmt::Display for Normalized<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let count = self.0.len() as f64;
        let rms = self.rms();
        let mean = self.0.iter().sum::<f64>() / count;
        let inside = self.0.iter().filter(|it| it.abs() < 1.96).count() as f64 / count;
        // Deviations of chance, if errors were independent.
        let (rms_chance, share_chance) = ((0.5 / count).sqrt(), (0.95 * 0.05 / count).sqrt());
        write!(
            out,
            "{rms:.2} rms (1 ± {rms_chance:.2}), {mean:+.2} on average (0 ± {:.2}), {:.1} % inside the stated 95 % (± {:.1})",
            count.sqrt().recip(),
            100.0 * inside,
            100.0 * share_chance
        )
    }
}

/// Pictures of the chessboard at the same poses, with the result of Roundel's board.
fn export(folder: &Path, poses: &[nalgebra::Isometry3<f64>], rms_px: f64) -> std::io::Result<()> {
    fs::create_dir_all(folder)?;
    let images = pictures(&camera(), imaging(), &chessboard_print(), poses, 1000);
    for (index, image) in images.iter().enumerate() {
        write_png(&folder.join(format!("chess-{index:02}.png")), image)?;
    }
    let truth = camera();
    fs::write(
        folder.join("board.json"),
        format!(
            "{{\"corners\": [{}, {}], \"square_m\": {SQUARE_M}, \"rms_px\": {rms_px}, \"focal_px\": {:?}, \
             \"center_px\": {:?}}}\n",
            SQUARES.0 - 1,
            SQUARES.1 - 1,
            truth.focal_px,
            truth.center_px
        ),
    )
}
