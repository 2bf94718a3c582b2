//! Errors of found rims against drawn ones, for the test that bounds them and the benchmark that prints them all.

use super::drawing::{Drawing, Roundel, ellipse, frame};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use roundel_core::marker::{Detector, Kind, Params, Scratch};

const RATIO: f64 = 0.4;
const BACKGROUND: f64 = 90.0;

/// Errors of one quantity.
#[derive(Default)]
pub struct Errors {
    n: f64,
    sum: f64,
    squares: f64,
}

impl Errors {
    fn add(&mut self, error: f64) {
        self.n += 1.0;
        self.sum += error;
        self.squares += error * error;
    }

    pub fn bias(&self) -> f64 {
        self.sum / self.n
    }

    pub fn rms(&self) -> f64 {
        (self.squares / self.n).sqrt()
    }
}

/// Measurements for one case.
#[derive(Default)]
pub struct Cell {
    pub missed: u32,
    pub center: Errors,
    pub inner_center: Errors,
    pub major: Errors,
    pub minor: Errors,
    pub inner_major: Errors,
    pub inner_minor: Errors,
    /// Relative error of the geometric mean of the semiaxes, which is that of the depth.
    pub size: Errors,
}

#[derive(Clone, Copy)]
pub struct Case {
    pub diameter_px: f64,
    pub tilt_deg: f64,
    pub blur_px: f64,
    pub noise: f64,
    pub margin: f64,
    pub kind: bool,
}

pub fn measure(case: &Case, trials: u64) -> Cell {
    let kind = Kind::plain("drawn", 1.0, RATIO);
    let kinds = if case.kind { vec![kind] } else { Vec::new() };
    let detector = Detector::new(kinds, Params::default()).unwrap();
    let mut scratch = Scratch::default();
    let mut cell = Cell::default();
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let side = (case.diameter_px * case.margin) as usize + 24;
    for trial in 0..trials {
        let mut jitter = || rng.random_range(-0.5..0.5);
        let middle = 0.5 * side as f64;
        let major = 0.5 * case.diameter_px + 0.5 * jitter();
        let minor = major * case.tilt_deg.to_radians().cos();
        let at = (middle + jitter(), middle + jitter());
        let angle = std::f64::consts::PI * jitter();
        let outer = ellipse(at, (major, minor), angle);
        let roundel =
            Roundel { outer, ratio: RATIO, margin: case.margin, black: 40.0, white: 200.0 };
        let mut drawing = Drawing::new(side, side, BACKGROUND, case.blur_px);
        drawing.add(&roundel, BACKGROUND);
        let picture = drawing.picture(case.noise, trial);
        let [ring] = detector.detect(&frame(&picture, side), &mut scratch) else {
            cell.missed += 1;
            continue;
        };
        for (errors, found, truth) in
            [(&mut cell.center, ring.outer, outer), (&mut cell.inner_center, ring.inner, outer)]
        {
            errors.add(found.center.u - truth.center.u);
            errors.add(found.center.v - truth.center.v);
        }
        let inner = roundel.inner();
        cell.major.add(ring.outer.semi_major_px - outer.semi_major_px);
        cell.minor.add(ring.outer.semi_minor_px - outer.semi_minor_px);
        cell.inner_major.add(ring.inner.semi_major_px - inner.semi_major_px);
        cell.inner_minor.add(ring.inner.semi_minor_px - inner.semi_minor_px);
        cell.size.add(ring.outer.mean_radius_px() / outer.mean_radius_px() - 1.0);
    }
    cell
}

pub fn print_head() {
    println!(
        "diameter tilt blur noise margin kind | missed | centre rms outer inner | \
         major bias rms | minor bias rms | inner major bias rms | minor bias rms | size % bias rms"
    );
}

pub fn print_row(case: &Case, cell: &Cell) {
    print!(
        "{:5.0} {:4.0} {:5.1} {:4.0} {:6.2} {:5} | {:3} | {:.4} {:.4} ",
        case.diameter_px,
        case.tilt_deg,
        case.blur_px,
        case.noise,
        case.margin,
        case.kind,
        cell.missed,
        cell.center.rms(),
        cell.inner_center.rms(),
    );
    for errors in [&cell.major, &cell.minor, &cell.inner_major, &cell.inner_minor] {
        print!("| {:+.4} {:.4} ", errors.bias(), errors.rms());
    }
    println!("| {:+.3} {:.3}", 100.0 * cell.size.bias(), 100.0 * cell.size.rms());
}

/// Sizes, tilts and (blur, noise) of the table, without those that appear too flat.
pub fn cases(sizes: &[f64], margin: f64, kind: bool) -> Vec<Case> {
    let mut cases = Vec::new();
    for &diameter_px in sizes {
        for tilt_deg in [0.0f64, 30.0, 60.0] {
            if 0.5 * diameter_px * tilt_deg.to_radians().cos() < 5.0 {
                continue;
            }
            for (blur_px, noise) in [(0.5, 1.0), (0.7, 2.0), (1.1, 4.0)] {
                cases.push(Case { diameter_px, tilt_deg, blur_px, noise, margin, kind });
            }
        }
    }
    cases
}
