//! The careful fit: for rings whose residual shows that the plain model does not hold.
//!
//! In: where the fast fit ended. Out: a solution whose covariance says what the picture holds, or a
//! refusal. The image is the same (`image`), but
//!
//! * **cut off levels.** A pixel at an end of the scale says only that its level m, with noise ε of
//!   deviation s, lies beyond: with z = (254.5 - m)/s its likelihood is Φ(-z), so that it pulls by
//!   s λ, λ = φ(z)/Φ(-z), with the weight λ (λ - z): as any other pixel where m is far below, not at
//!   all where m is far above (Tobit's regression). The flanks say how high white is.
//! * **bloom.** Where levels are cut off, white may spread into black across both rims: one more
//!   unknown, expected within [`BLOOM_PRIOR_PX`].
//! * **cells.** Where that does not explain the residual, each stretch of either rim gets levels of its
//!   own (`cells`): half of a ring in shadow keeps its say on where the rims are, and a cover without
//!   an edge near the rim has none.
//! * **drops.** Cells whose rim stands off the model's, or whose pixels are left with more than most
//!   cells' are, leave the fit until their number settles.
//! * **no motion.** Motion within the exposure would pass for whatever blurs one side more than another: it is
//!   held at none.
//! * **growth.** The variance of a pixel is multiplied by the mean of δ²/var(δ) over the cells that
//!   stay: motion, JPEG and covers that were not seen move whole stretches, not single pixels.
//!
//! Refused are rings of which fewer than [`LEAST_KEPT`] of either rim's cells agree.
//!
//! **Accuracy** (`roundel-tests`, `tests/robustness.rs`): white at 330 of 255, with and without bloom, a
//! shadow's edge across the ring, covers.

mod cell_outliers;
mod cells;
mod image;
mod pixels;

use nalgebra::{SVector, Vector3};

use super::{
    FitError, FitScratch, Placed,
    model::column_products::{STILL, column},
    solver::{
        linearize::{self, Parts},
        mirror::Glance,
        normal_equations::Linear,
        solution::{Covariance5, Solution},
        state::{BLUR, Problem, State, UNKNOWNS, WHITE},
    },
    window_of,
};
use crate::{ellipse::Ellipse, room::make_room};
use cells::{Cell, Known, Products, SPREAD};
use image::{Images, Normal};
use pixels::Pixel;

/// Deviation of the bloom where levels are cut off, pixels.
const BLOOM_PRIOR_PX: f64 = 0.3;
/// Levels are cut off if more than this share of the pixels stands at an end of the scale.
const CUT_OFF: f64 = 0.02;
/// Least share of each rim's cells that must agree.
const LEAST_KEPT: f64 = 0.4;
/// Rounds of dropping cells.
const ROUNDS: usize = 6;
/// Steps of one round.
const STEPS: usize = 8;
/// Looks at the picture, of both normals: twice as many as most rings need.
const LOOKS: usize = 28;
/// A step that lowers the misfit by less than this many variances is the last one.
const LAST_STEP: f64 = 0.3;
/// A step that promises less than this many variances, and does not keep it, is left out.
const SETTLED: f64 = 4.0;
/// Deviation of a pixel, at least.
const LEAST_NOISE: f64 = 0.5;
/// The growth up to which one set of levels is enough for the whole ring.
const EVEN: f64 = 3.0;
/// Variance that face-on adds to the tilt, in units of the elongation's deviation …
const FACE_ON: f64 = 1.5;
/// … up to an elongation of about so many deviations.
const FACE_ON_END: f64 = 2.5;

/// Memory of the careful fit.
#[derive(Clone, Debug, Default)]
pub struct Careful {
    normal: Normal,
    images: Images,
    pixels: Vec<Pixel>,
    cells: Vec<Cell>,
    /// The cells before a step that may not hold.
    before: Vec<Cell>,
    list: Vec<f64>,
}

impl Careful {
    /// Room for windows of so many pixels.
    pub fn make_room(&mut self, pixels: usize) {
        self.images.make_room(pixels);
        make_room(&mut self.pixels, pixels);
        make_room(&mut self.cells, cells::MOST);
        make_room(&mut self.before, cells::MOST);
        make_room(&mut self.list, cells::MOST);
    }

    /// Whether all of the inner rim's cells agreed in the newest fit.
    pub fn keeps_disc(&self) -> bool {
        self.cells.iter().all(|cell| cell.rim == 0 || cell.kept)
    }
}

/// Whose levels hold.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Levels {
    Ring,
    Cells,
}

/// A fit at work.
struct Fitter<'a> {
    problem: &'a Problem<'a>,
    scratch: &'a mut FitScratch,
    known: Known,
    levels: Levels,
    /// Whether levels are cut off, and the bloom is free.
    cut_off: bool,
    bloom_px: f64,
    /// The last column's products, from before it was eliminated.
    bloom: SVector<f64, STILL>,
    /// The misfit as it is, before levels and bloom have followed.
    misfit: f64,
    iterations: usize,
}

/// Fits from a state, over the pixels within `counted`.
pub fn solve(
    problem: &Problem,
    start: &State,
    counted: &Ellipse,
    scratch: &mut FitScratch,
) -> Result<Placed, FitError> {
    let (columns, rows) = window_of(counted);
    scratch.careful.images.lay(columns, rows);
    let known = Known { levels: [start.white, start.step], noise2: 4.0 };
    let mut fitter = Fitter {
        problem,
        scratch,
        known,
        levels: Levels::Ring,
        cut_off: false,
        bloom_px: 0.0,
        bloom: SVector::zeros(),
        misfit: 0.0,
        iterations: 0,
    };
    fitter.lay_cells(start);
    let (solution, second) = fitter.run(start)?;
    place(problem, solution, second)
}

/// The solution with its covariance.
fn place(
    problem: &Problem,
    solution: Solution,
    second: Option<Glance>,
) -> Result<Placed, FitError> {
    let Solution { state, noise2, linear, .. } = &solution;
    let (factor, _) = linear.factor(state, *noise2, 0.0).ok_or(FitError::Flat)?;
    let mut own: Covariance5 = factor.inverse_of_last() * *noise2;
    let unit = (2.0 * noise2 / linear.elongation).sqrt();
    let seen = linear.tilt_information(state) / noise2 * unit;
    let face_on = FACE_ON * (-(seen / FACE_ON_END).powi(4)).exp() * unit;
    own[(3, 3)] += face_on;
    own[(4, 4)] += face_on;
    let turns = [0, 1].map(|axis| state.place.axes.column(axis).into_owned());
    let worse = second
        .as_ref()
        .map_or(f64::INFINITY, |other| (other.misfit - solution.misfit).max(0.0) / noise2);
    Ok(Placed {
        other_normal: state.mirrored().place.axes.column(2).into_owned(),
        likelihood: 1.0 / (1.0 + (-0.5 * worse).exp()),
        apart_m: second.map_or(Vector3::zeros(), |other| other.apart_m),
        covariance: solution.carried(problem, state, &own, &turns),
        noise2: *noise2,
        motion_variance: None,
        iterations: solution.iterations,
        recalled: None,
        state: solution.state,
    })
}

impl Fitter<'_> {
    /// Deals the pixels out to cells.
    fn lay_cells(&mut self, state: &State) {
        let careful = &mut self.scratch.careful;
        let (origin, width, height) =
            (careful.images.origin, careful.images.width, careful.images.height);
        let model = linearize::model(self.problem, state, state.blur2.sqrt(), origin);
        let ratio = self.problem.kind.mean_ratio();
        let radius_px = linearize::radius_px(self.problem, state);
        let counts =
            [1.0, ratio].map(|share| cells::count(std::f64::consts::TAU * share * radius_px));
        careful.cells.clear();
        for (rim, &count) in counts.iter().enumerate() {
            careful.cells.extend((0..count).map(|_| Cell::new(rim, self.known.levels)));
        }
        careful.pixels.clear();
        let frame = self.problem.frame;
        let mut ends = 0usize;
        for row in 0..height {
            let v = origin.1 + row as i64;
            if !(0..frame.height() as i64).contains(&v) {
                continue;
            }
            let (from, to) = self.problem.chords.span(v as f64);
            let from = (from.ceil() as i64).max(origin.0).max(0);
            let to = (to.ceil() as i64).min(frame.width() as i64).min(origin.0 + width as i64);
            for u in from..to {
                let column = (u - origin.0) as usize;
                let (p, q) = (column as f32, row as f32);
                let t = model.t.map(|[c, by_p, by_q]| c + by_p * p + by_q * q);
                let of = |terms: &[f32; 3]| terms[0] + terms[1] * t[0] + terms[2] * t[1];
                let (near, x, y) = (of(&model.nearness), of(&model.plane[0]), of(&model.plane[1]));
                let rim = usize::from(x.hypot(y) < 0.5 * (1.0 + ratio as f32) * near);
                let turn = f64::from(y.atan2(x)) / std::f64::consts::TAU + 0.5;
                let place = ((turn * counts[rim] as f64) as usize).min(counts[rim] - 1);
                let grey = frame.row(v as usize)[u as usize];
                ends += usize::from(grey == 0 || grey == 255);
                careful.pixels.push(Pixel {
                    column: column as u16,
                    row: row as u16,
                    cell: (rim * counts[0] + place) as u16,
                    grey: f32::from(grey),
                });
            }
        }
        self.cut_off = ends as f64 > CUT_OFF * careful.pixels.len() as f64;
    }

    fn run(&mut self, start: &State) -> Result<(Solution, Option<Glance>), FitError> {
        let (mut state, mut linear, mut settled) = self.descend(start.clone())?;
        let mut changed = self.drop_cells();
        let mut growth = self.growth(&linear);
        if changed || growth > EVEN || !settled {
            self.levels = Levels::Cells;
            self.known.levels = [state.white, state.step];
            for cell in &mut self.scratch.careful.cells {
                cell.levels = self.known.levels;
            }
            for _ in 0..ROUNDS {
                (state, linear, settled) = self.descend(state)?;
                changed = self.drop_cells();
                if !changed {
                    break;
                }
            }
            growth = self.growth(&linear);
        }
        if changed || !settled {
            return Err(FitError::Restless);
        }
        let share = self.share_kept();
        if share < LEAST_KEPT {
            return Err(FitError::Disturbed);
        }
        linear.elongation *= share;
        let noise2 = linear.noise2() * growth;
        let misfit = linear.misfit;
        let solution = Solution { state, misfit, noise2, iterations: self.iterations, linear };
        Ok(self.against_mirrored(solution))
    }

    /// The likelier of a solution and the one from its mirrored place, with what the other comes to.
    fn against_mirrored(&mut self, first: Solution) -> (Solution, Option<Glance>) {
        let Ok((state, mut linear, _)) = self.descend(first.state.mirrored()) else {
            return (first, None);
        };
        linear.elongation = first.linear.elongation;
        let apart_m = state.place.position_m - first.state.place.position_m;
        let misfit = linear.misfit;
        if misfit >= first.misfit {
            return (first, Some(Glance { misfit, unmoved: misfit, apart_m, state }));
        }
        let glance = Glance {
            misfit: first.misfit,
            unmoved: first.misfit,
            apart_m: -apart_m,
            state: first.state,
        };
        let noise2 = first.noise2;
        (Solution { state, misfit, noise2, iterations: self.iterations, linear }, Some(glance))
    }

    /// Steps down from a state; whether it settled.
    fn descend(&mut self, start: State) -> Result<(State, Linear, bool), FitError> {
        let mut state = start;
        let mut linear = self.look(&state)?;
        let mut misfit = self.misfit;
        let mut damping = 0.0;
        for _ in 0..STEPS {
            if self.iterations >= LOOKS {
                break;
            }
            let noise2 = linear.noise2();
            self.known.noise2 = noise2;
            let flat = || FitError::Flat;
            let (factor, right) = linear.factor(&state, noise2, damping).ok_or_else(flat)?;
            let mut change = factor.solve(&right);
            if state.blur_ends(change[BLUR]) {
                linear.hold(BLUR);
                let (factor, right) = linear.factor(&state, noise2, damping).ok_or_else(flat)?;
                change = factor.solve(&right);
            }
            let gain: f64 = change.iter().zip(&linear.gradient).map(|(x, g)| x * g).sum();
            let gain = gain + misfit - linear.misfit;
            if damping < 1e-3 && gain < LAST_STEP * noise2 {
                return Ok((state, linear, true));
            }
            let next = state.moved(&linear, &change).ok_or(FitError::Away)?;
            let bloom_px = self.bloom_px;
            let Careful { cells, before, .. } = &mut self.scratch.careful;
            before.clone_from(cells);
            self.settle(&linear, &change);
            match self.look(&next) {
                Ok(found) if self.misfit <= misfit + noise2 => {
                    (state, linear, misfit) = (next, found, self.misfit);
                    damping *= 0.1;
                }
                found => {
                    let Careful { cells, before, .. } = &mut self.scratch.careful;
                    cells.clone_from(before);
                    self.bloom_px = bloom_px;
                    // The columns, not the model, stand in the way of so little.
                    if found.is_ok() && gain < SETTLED * noise2 {
                        return Ok((state, linear, true));
                    }
                    damping = (10.0 * damping).max(0.01);
                }
            }
        }
        Ok((state, linear, false))
    }

    /// Moves bloom and the cells' levels along with the shared unknowns.
    fn settle(&mut self, linear: &Linear, change: &[f64]) {
        let mut coefficients = SVector::<f64, STILL>::zeros();
        coefficients[0] = 1.0;
        for unknown in WHITE..UNKNOWNS {
            coefficients[unknown + 1 - WHITE] = -change[unknown] * linear.scale[unknown];
        }
        if self.cut_off {
            let bloom = self.bloom.dot(&coefficients) / self.bloom[SPREAD];
            coefficients[SPREAD] = -bloom;
            self.bloom_px += bloom / self.known.levels[1];
        }
        if self.levels == Levels::Cells {
            // The levels' own coefficients are what is looked for.
            (coefficients[column::WHITE], coefficients[column::STEP]) = (0.0, 0.0);
            for cell in &mut self.scratch.careful.cells {
                cell.settle(&self.known, &coefficients);
            }
        }
    }

    /// The linear problem at a state.
    fn look(&mut self, state: &State) -> Result<Linear, FitError> {
        self.iterations += 1;
        let blur_px = state.blur2.sqrt();
        let FitScratch { level, contours, nodes, careful, .. } = &mut *self.scratch;
        let Careful { normal, images, .. } = careful;
        let mut parts = Parts { level: *level, contours, nodes, window: images.origin };
        let radius_px = linearize::project(self.problem, state, blur_px, &mut parts);
        if self.bloom_px != 0.0 {
            images.spread(nodes, self.bloom_px);
        }
        if !images.draw(*level, nodes, blur_px, normal) {
            return Err(FitError::Away);
        }
        if self.levels == Levels::Ring {
            self.known.levels = [state.white, state.step];
            for cell in &mut careful.cells {
                cell.levels = self.known.levels;
            }
        }
        let FitScratch { level, careful, .. } = &mut *self.scratch;
        let deviation = self.known.noise2.sqrt().max(LEAST_NOISE);
        pixels::add_all(*level, (self.problem, state), careful, deviation);
        let products = self.combined();
        let origin = self.scratch.careful.images.origin;
        let model = linearize::model(self.problem, state, blur_px, origin);
        Ok(Linear::new(self.problem, state, (&products, &model), radius_px))
    }

    /// The products of all cells that count, with bloom free or held.
    fn combined(&mut self) -> Products {
        let mut sum = Products::zeros();
        self.misfit = 0.0;
        for cell in self.scratch.careful.cells.iter().filter(|cell| cell.kept) {
            self.misfit += cell.misfit(&self.known);
            match self.levels {
                Levels::Ring => sum += cell.products(self.known.levels[1]),
                Levels::Cells => {
                    if let Some(products) = cell.freed(&self.known) {
                        sum += products;
                    }
                }
            }
        }
        if self.levels == Levels::Cells {
            sum[(column::STEP, column::STEP)] = 1.0;
        }
        if self.cut_off {
            let step = self.known.levels[1];
            let prior = self.known.noise2 / (BLOOM_PRIOR_PX * step).powi(2);
            sum[(SPREAD, SPREAD)] += prior;
            let pull = -prior * self.bloom_px * step;
            sum[(0, SPREAD)] += pull;
            sum[(SPREAD, 0)] += pull;
            let prior = prior * (self.bloom_px * step).powi(2);
            sum[(0, 0)] += prior;
            self.misfit += prior;
            self.bloom = sum.column(SPREAD).into_owned();
            sum -= self.bloom * self.bloom.transpose() / self.bloom[SPREAD];
        }
        sum
    }
}
