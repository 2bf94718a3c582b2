//! How well lenses are found: 30 rendered views a seed, next to the truth and to what is stated.
//!
//! `cargo run --release -p roundel-tests --bin lenses -- [SEEDS] [--board chessboard|charuco] [--export DIR]`. With
//! `--board` (and `--features chessboard`) the views are of a chessboard of the same size. With `--export` pictures of
//! that from the same places are written, for `tests/compare/lens`. It ends with an error where focal lengths or the centre are
//! further off than they may be, or the stated deviations do not hold.

use std::{collections::BTreeMap, fmt, fs, path::PathBuf, process::ExitCode};

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
    normal::Random,
    render::{Image, Print},
};

const VIEWS: usize = 30;
/// What focal lengths may be off by, as a share, and the centre, pixels.
const FOCAL_SHARE: f64 = 5e-4;
const CENTER_PX: f64 = 0.5;
/// What errors over their stated deviations may be, rms, and how many more deviations of as many right ones.
const CONSISTENT: [f64; 2] = [0.85, 1.2];
const CHANCE: f64 = 3.0;

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let (mut seeds, mut export, mut board) = (50, None, Board::Roundels);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--export" => export = arguments.next().map(PathBuf::from),
            "--board" => match arguments.next().as_deref() {
                Some("chessboard") => board = Board::Chessboard,
                Some("charuco") => board = Board::Charuco,
                other => {
                    eprintln!("expected --board chessboard or charuco, found {other:?}");
                    return ExitCode::from(2);
                }
            },
            number => match number.parse::<u64>() {
                Ok(number) if number > 0 => seeds = number,
                _ => {
                    eprintln!(
                        "expected a number of seeds, --board or --export DIR, found {number:?}"
                    );
                    return ExitCode::from(2);
                }
            },
        }
    }
    let truth = camera();
    let print = board.print();
    let mut ratios: BTreeMap<&'static str, Vec<f64>> = BTreeMap::new();
    let (mut worst_focal, mut worst_center_px, mut rms_px, mut models) =
        (0.0_f64, 0.0_f64, 0.0, Vec::new());
    let mut needless = 0;
    for seed in 0..seeds {
        let poses = poses(&truth, VIEWS, &mut Random::new(seed, 0));
        let found = match board.lens(&pictures(&truth, imaging(), &print, &poses, seed)) {
            Ok(found) => found,
            Err(error) => {
                eprintln!("seed {seed}: {error:#}");
                return ExitCode::FAILURE;
            }
        };
        let is = found.camera.intrinsics();
        let errors = [
            is.fx_px - truth.focal_px[0],
            is.fy_px - truth.focal_px[1],
            is.cx_px - truth.center_px[0],
            is.cy_px - truth.center_px[1],
        ];
        for (error, focal_px) in errors.iter().zip(truth.focal_px) {
            worst_focal = worst_focal.max((error / focal_px).abs());
        }
        worst_center_px = worst_center_px.max(errors[2].hypot(errors[3]));
        rms_px += found.rms_px / seeds as f64;
        models.push(format!("{:?}", found.model));
        let of_truth = truth.distortion.coefficients();
        let is_needless = |&&index: &&usize| of_truth.get(index).is_none_or(|it| *it == 0.0);
        needless += usize::from(found.model.free().iter().any(|index| is_needless(&index)));
        let coefficients = is.lens.coefficients().iter().zip(truth.distortion.coefficients());
        let coefficients: Vec<f64> = coefficients.map(|(is, was)| is - was).collect();
        let is_alike = is.lens.name() == truth.distortion.name();
        let free = if is_alike { found.model.free() } else { &[] };
        let free = free.iter().map(|&index| coefficients[index]);
        let names = ["fx", "fy", "cx", "cy"].into_iter().chain(found.model.names());
        let errors = errors.into_iter().chain(free).zip(found.deviations());
        for (name, (error, deviation)) in names.zip(errors) {
            ratios.entry(name).or_default().push(error / deviation);
        }
        if let (0, Some(folder)) = (seed, &export)
            && let Err(error) = write(folder, &poses, found.rms_px)
        {
            eprintln!("{}: {error}", folder.display());
            return ExitCode::FAILURE;
        }
    }
    models.sort();
    models.dedup();
    let is_exact = worst_focal <= FOCAL_SHARE && worst_center_px <= CENTER_PX;
    println!(
        "{VIEWS} views of {}x{}, noise 2, blur 0.8 px, {seeds} seeds",
        truth.width, truth.height
    );
    println!(
        "focal lengths at most {:.4} % off, centre {:.3} px; rms {rms_px:.4} px; {}",
        worst_focal * 100.0,
        worst_center_px,
        models.join(", ")
    );
    for (name, ratios) in &ratios {
        println!("{name}: error over its stated deviation {}", Told(ratios));
    }
    let all: Vec<f64> = ratios.into_values().flatten().collect();
    println!("all of them: {}", Told(&all));
    println!("coefficients that are 0 in truth were estimated in {needless} of {seeds}");
    let is_consistent = Told(&all).is_consistent();
    if is_exact && is_consistent {
        return ExitCode::SUCCESS;
    }
    if !is_exact {
        eprintln!(
            "error: expected focal lengths at most {} % off and the centre {CENTER_PX} px",
            100.0 * FOCAL_SHARE
        );
    }
    if !is_consistent {
        let [least, most] = CONSISTENT;
        eprintln!(
            "error: expected errors of {least} to {most} times what is stated, but for chance"
        );
    }
    ExitCode::FAILURE
}

/// What is held before the camera.
#[derive(Clone, Copy)]
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

    fn lens(self, pictures: &[Image]) -> anyhow::Result<LensCalibration> {
        match self {
            Self::Roundels => lens(pictures).context("of roundels"),
            #[cfg(feature = "chessboard")]
            Self::Chessboard => lens_of_chessboard(CHESSBOARD, pictures),
            #[cfg(feature = "chessboard")]
            Self::Charuco => lens_of_chessboard(CHARUCO, pictures),
            #[cfg(not(feature = "chessboard"))]
            Self::Chessboard | Self::Charuco => bail!("run it with --features chessboard"),
        }
    }
}

/// Errors over their deviations.
struct Told<'a>(&'a [f64]);

impl Told<'_> {
    fn rms(&self) -> f64 {
        (self.0.iter().map(|it| it * it).sum::<f64>() / self.0.len() as f64).sqrt()
    }

    /// Whether the stated deviations hold, as far as so many errors can tell.
    fn is_consistent(&self) -> bool {
        let chance = CHANCE * (0.5 / self.0.len() as f64).sqrt();
        let [least, most] = CONSISTENT;
        (least - chance..=most + chance).contains(&self.rms())
    }
}

impl fmt::Display for Told<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let count = self.0.len() as f64;
        let rms = self.rms();
        let mean = self.0.iter().sum::<f64>() / count;
        let inside = self.0.iter().filter(|it| it.abs() < 1.96).count() as f64 / count;
        // As many right ones would vary by so much, were they independent.
        let (of_rms, of_share) = ((0.5 / count).sqrt(), (0.95 * 0.05 / count).sqrt());
        write!(
            out,
            "{rms:.2} rms (1 ± {of_rms:.2}), {mean:+.2} on average (0 ± {:.2}), {:.1} % inside the stated 95 % (± {:.1})",
            count.sqrt().recip(),
            100.0 * inside,
            100.0 * of_share
        )
    }
}

/// The chessboard from the same places, and what Roundel's board gave there.
fn write(folder: &PathBuf, poses: &[nalgebra::Isometry3<f64>], rms_px: f64) -> std::io::Result<()> {
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
