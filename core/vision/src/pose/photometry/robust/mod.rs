//! The robust fit, for rings whose residual contradicts the plain model.
//!
//! In: the state where the plain fit ended, or that of the frame before (`resume`). Out: a solution with a realistic covariance, or a
//! rejection. The image is the same, with these extensions:
//!
//! * **Clipped levels.** A pixel at an end of the scale states only that its level m, with noise ε
//!   of standard deviation s, lies beyond. With z = (254.5 - m)/s its likelihood is Φ(-z), so its
//!   residual is s λ, λ = φ(z)/Φ(-z), with the weight λ (λ - z): that of any other pixel where m is
//!   far below, zero where m is far above (Tobit regression). The flanks determine the white level.
//! * **Bloom.** Where levels are clipped, white may spread into black across both rims: one more
//!   unknown, with a prior of [`BLOOM_PRIOR_PX`].
//! * **Cells.** Where that does not explain the residual, each stretch of either rim gets its own
//!   levels (`cells`). A ring half in shadow keeps all its information about the rims, and an
//!   occlusion without an edge near the rim has no effect.
//! * **Outliers.** Cells whose rim is off the model's, or whose residual exceeds that of most
//!   cells, are rejected until their set is stable.
//! * **No motion.** Motion within the exposure would explain anything that blurs one side more than
//!   another; it is held at zero.
//! * **Variance.** The variance of a pixel is multiplied by the mean of δ²/var(δ) over the kept
//!   cells: motion, JPEG and undetected occlusions move whole stretches, not single pixels.
//!
//! Rejected are rings of which fewer than [`MIN_KEPT`] of either rim's cells agree.
//!
//! **Accuracy** (`roundel-tests`, `tests/robustness.rs`): white at 330 of 255, with and without
//! bloom, the edge of a shadow across the ring, occlusions.

mod assign;
mod cell_outliers;
mod cells;
mod pixels;
mod resume;

use nalgebra::SVector;

use super::{
    FitError, FitScratch,
    model::{
        ModelScratch,
        column_products::{STILL, column},
    },
    solver::{
        cholesky::Unknowns,
        gauss_newton::{Damping, SETTLED},
        linearize,
        mirror::MirrorEstimate,
        normal_equations::NormalEquations,
        solution::{Covariance5, PoseEstimate, Solution},
        state::{Problem, State, UNKNOWNS, WHITE},
    },
};
use crate::scratch::reserve_total;
use cells::{Cell, Products, Reference, SPREAD};
use pixels::{CellLevels, PixelSums};
pub use resume::RobustState;

/// Standard deviation of the bloom where levels are clipped.
const BLOOM_PRIOR_PX: f64 = 0.3;
/// Levels are clipped if more than this share of the pixels is at an end of the scale.
const CUT_OFF: f64 = 0.02;
/// Share of each rim's cells that must agree.
const MIN_KEPT: f64 = 0.4;
const ROUNDS: usize = 6;
/// Steps of one round.
const STEPS: usize = 8;
/// Linearizations for both normals: twice as many as most rings need.
const MAX_LINEARIZATIONS: usize = 28;
/// A step that decreases the misfit by fewer variances is the last one.
const LAST_STEP: f64 = 0.3;
/// Work of a pixel, relative to the plain fit.
const ROBUST_WORK: u64 = 4;
/// Variance of a pixel before the first solution.
const FIRST_NOISE2: f64 = 4.0;
/// Lower limit of the standard deviation of a pixel.
const MIN_NOISE: f64 = 0.5;
/// Growth of the variance up to which one set of levels serves the whole ring.
const UNIFORM_GROWTH: f64 = 3.0;
/// Variance that face-on poses add to the tilt, in units of the elongation's standard deviation …
const FACE_ON: f64 = 1.5;
/// … up to about this elongation, in standard deviations.
const FACE_ON_END: f64 = 2.5;

#[derive(Clone, Debug, Default)]
pub struct RobustScratch {
    /// Cell of each counted pixel, in the window's order.
    assignment: Vec<u16>,
    cells: Vec<Cell>,
    levels: Vec<CellLevels>,
    /// Cells before a step, to restore them if it fails.
    saved: Vec<Cell>,
    list: Vec<f64>,
}

impl RobustScratch {
    /// Reserves memory for windows of this size.
    pub fn reserve(&mut self, pixels: usize) {
        reserve_total(&mut self.assignment, pixels);
        reserve_total(&mut self.cells, cells::MAX_CELLS);
        reserve_total(&mut self.levels, cells::MAX_CELLS);
        reserve_total(&mut self.saved, cells::MAX_CELLS);
        reserve_total(&mut self.list, cells::MAX_CELLS);
    }

    /// Whether all cells of the inner rim agreed in the last fit.
    pub fn disc_is_unobstructed(&self) -> bool {
        self.cells.iter().all(|cell| cell.rim == 0 || cell.kept)
    }
}

/// Whether the ring or each cell has its own levels.
#[derive(Clone, Copy, Debug, PartialEq)]
enum LevelScope {
    Ring,
    Cells,
}

struct RobustFit<'a> {
    problem: &'a Problem<'a>,
    model: &'a mut ModelScratch,
    scratch: &'a mut RobustScratch,
    reference: Reference,
    levels: LevelScope,
    /// Whether levels are clipped, and the bloom is free.
    cut_off: bool,
    bloom_px: f64,
    /// Products of the last column before its elimination.
    bloom: SVector<f64, STILL>,
    /// Coefficients of the columns for the step that was taken since the products were summed.
    taken: SVector<f64, STILL>,
    /// Misfit before levels and bloom are updated.
    misfit: f64,
    iterations: usize,
}

/// Solves from a start, with the state that an earlier frame left, if any; returns that for the next
/// frame as well.
pub fn solve(
    problem: &Problem,
    start: &State,
    before: Option<&RobustState>,
    scratch: &mut FitScratch,
) -> Result<(PoseEstimate, RobustState), FitError> {
    let FitScratch { model, robust: scratch, .. } = scratch;
    let reference = Reference { levels: [start.white, start.step], noise2: FIRST_NOISE2 };
    let mut fitter = RobustFit {
        problem,
        model,
        scratch,
        reference,
        levels: LevelScope::Ring,
        cut_off: false,
        bloom_px: 0.0,
        bloom: SVector::zeros(),
        taken: no_step(),
        misfit: 0.0,
        iterations: 0,
    };
    fitter.assign_cells(start);
    if let Some(before) = before
        && let Some(resumed) = fitter.resume(start, before)
        && let Ok(solution) = fitter.run_resumed(&resumed)
    {
        let mut next = fitter.state(&solution, Some(before));
        let (solution, second) = fitter.resumed_against_mirrored(solution, before, &mut next);
        return Ok((estimate(problem, solution, second)?, next));
    }
    fitter.reset(start);
    let solution = fitter.run(start)?;
    let next = fitter.state(&solution, None);
    let (solution, second) = fitter.against_mirrored(solution);
    Ok((estimate(problem, solution, second)?, next))
}

fn estimate(
    problem: &Problem,
    solution: Solution,
    second: Option<MirrorEstimate>,
) -> Result<PoseEstimate, FitError> {
    let Solution { state, noise2, equations, .. } = &solution;
    let (factor, _) = equations.factor(state, *noise2, 0.0).ok_or(FitError::Uninformative)?;
    let mut own: Covariance5 = factor.inverse_of_last() * *noise2;
    let unit = (2.0 * noise2 / equations.elongation).sqrt();
    let tilt = equations.tilt_information(state) / noise2 * unit;
    let face_on = FACE_ON * (-(tilt / FACE_ON_END).powi(4)).exp() * unit;
    own[(3, 3)] += face_on;
    own[(4, 4)] += face_on;
    Ok(solution.estimate(problem, &own, second))
}

/// The residual as it is.
fn no_step() -> SVector<f64, STILL> {
    let mut coefficients = SVector::zeros();
    coefficients[0] = 1.0;
    coefficients
}

impl RobustFit<'_> {
    /// Back to a first fit from a start.
    fn reset(&mut self, start: &State) {
        self.reference = Reference { levels: [start.white, start.step], noise2: FIRST_NOISE2 };
        self.levels = LevelScope::Ring;
        self.bloom_px = 0.0;
        self.iterations = 0;
        for cell in &mut self.scratch.cells {
            (cell.kept, cell.levels) = (true, self.reference.levels);
        }
    }

    fn assign_cells(&mut self, state: &State) {
        let RobustScratch { assignment, cells, .. } = &mut *self.scratch;
        let window = &self.model.window;
        let blur_px = state.blur2.sqrt();
        let model = linearize::pixel_model(self.problem, state, blur_px, window.origin);
        let ratio = self.problem.disc_ratio();
        let radius_px = linearize::radius_px(self.problem, state);
        let counts =
            [1.0, ratio].map(|share| cells::count(std::f64::consts::TAU * share * radius_px));
        cells.clear();
        for (rim, &count) in counts.iter().enumerate() {
            cells.extend((0..count).map(|_| Cell::new(rim, self.reference.levels)));
        }
        assignment.clear();
        let clipped = assign::assign(self.model.level, window, &model, ratio, counts, assignment);
        self.cut_off = clipped as f64 > CUT_OFF * assignment.len() as f64;
    }

    /// Fits with the levels of the ring, then with those of the cells if necessary.
    fn run(&mut self, start: &State) -> Result<Solution, FitError> {
        let (state, equations, settled) = self.iterate(start.clone())?;
        let changed = self.reject_outliers();
        let variance_growth = self.variance_growth(&equations);
        if changed || variance_growth > UNIFORM_GROWTH || !settled {
            self.levels = LevelScope::Cells;
            self.reference.levels = [state.white, state.step];
            for cell in &mut self.scratch.cells {
                cell.levels = self.reference.levels;
            }
            return self.run_resumed(&state);
        }
        self.finished(state, equations, variance_growth)
    }

    /// Fits with the current cells until none of them changes.
    fn run_resumed(&mut self, start: &State) -> Result<Solution, FitError> {
        let mut state = start.clone();
        for _ in 0..ROUNDS {
            let (next, equations, settled) = self.iterate(state)?;
            if !self.reject_outliers() {
                let variance_growth = self.variance_growth(&equations);
                let is_uniform =
                    self.levels == LevelScope::Cells || variance_growth < UNIFORM_GROWTH;
                if !settled || !is_uniform {
                    break;
                }
                return self.finished(next, equations, variance_growth);
            }
            state = next;
        }
        Err(FitError::NotConverged)
    }

    fn finished(
        &self,
        state: State,
        mut equations: NormalEquations,
        variance_growth: f64,
    ) -> Result<Solution, FitError> {
        let share = self.share_kept();
        if share < MIN_KEPT {
            return Err(FitError::Obstructed);
        }
        equations.elongation *= share;
        let noise2 = equations.noise2() * variance_growth;
        let misfit = equations.misfit;
        Ok(Solution { state, misfit, noise2, iterations: self.iterations, equations })
    }

    /// The more likely of a solution and the one from its mirrored pose, with the other one.
    fn against_mirrored(&mut self, first: Solution) -> (Solution, Option<MirrorEstimate>) {
        let Ok((state, mut equations, _)) = self.iterate(first.state.mirrored()) else {
            return (first, None);
        };
        equations.elongation = first.equations.elongation;
        let (misfit, noise2, iterations) = (equations.misfit, first.noise2, self.iterations);
        let second = Solution { state, misfit, noise2, iterations, equations };
        let other_offset_m = second.state.pose.position_m - first.state.pose.position_m;
        let (better, worse, other_offset_m) = if second.misfit < first.misfit {
            (second, first, -other_offset_m)
        } else {
            (first, second, other_offset_m)
        };
        let (misfit, state) = (worse.misfit, worse.state);
        let other = MirrorEstimate { misfit, initial_misfit: misfit, other_offset_m, state };
        (better, Some(other))
    }

    /// Damped Gauss-Newton steps; the flag is set if they converged.
    fn iterate(&mut self, start: State) -> Result<(State, NormalEquations, bool), FitError> {
        let mut state = start;
        let mut equations = self.assemble(&state)?;
        let mut misfit = self.misfit;
        let mut damping = Damping::default();
        for _ in 0..STEPS {
            if self.iterations >= MAX_LINEARIZATIONS {
                break;
            }
            let noise2 = equations.noise2();
            self.reference.noise2 = noise2;
            let change =
                equations.bounded_step(&state, noise2, damping.0).ok_or(FitError::Uninformative)?;
            let gain = equations.gain(&change) + misfit - equations.misfit;
            if damping.is_none() && gain < LAST_STEP * noise2 {
                return Ok((state, equations, true));
            }
            let next = state.moved(equations.ring.unit_m, &change).ok_or(FitError::OutOfWindow)?;
            if damping.is_none() && !self.cut_off && equations.is_linear_over(&state, &change) {
                self.taken = self.update_levels(&equations, &change);
                let left = (equations.misfit - equations.gain(&change)).max(0.0);
                equations.advance(&change, left);
                return Ok((next, equations, true));
            }
            let bloom_px = self.bloom_px;
            let RobustScratch { cells, saved, .. } = &mut *self.scratch;
            saved.clone_from(cells);
            self.update_levels(&equations, &change);
            match self.assemble(&next) {
                Ok(found) if self.misfit <= misfit + noise2 => {
                    (state, equations, misfit) = (next, found, self.misfit);
                    damping.relax();
                }
                found => {
                    let RobustScratch { cells, saved, .. } = &mut *self.scratch;
                    cells.clone_from(saved);
                    self.bloom_px = bloom_px;
                    // The approximate columns, not the model, prevent so small a decrease.
                    if found.is_ok() && gain < SETTLED * noise2 {
                        return Ok((state, equations, true));
                    }
                    damping.tighten();
                }
            }
        }
        Ok((state, equations, false))
    }

    /// Updates bloom and the cells' levels for a step of the shared unknowns; returns the columns'
    /// coefficients, which give the residual after it.
    fn update_levels(
        &mut self,
        equations: &NormalEquations,
        change: &Unknowns,
    ) -> SVector<f64, STILL> {
        let mut coefficients = no_step();
        for unknown in WHITE..UNKNOWNS {
            coefficients[unknown + 1 - WHITE] = -change[unknown] * equations.scale[unknown];
        }
        if self.cut_off {
            let bloom = self.bloom.dot(&coefficients) / self.bloom[SPREAD];
            coefficients[SPREAD] = -bloom;
            self.bloom_px += bloom / self.reference.levels[1];
        }
        if self.levels == LevelScope::Cells {
            // The levels' own coefficients are the unknowns here.
            (coefficients[column::WHITE], coefficients[column::STEP]) = (0.0, 0.0);
            for cell in &mut self.scratch.cells {
                cell.update_levels(&self.reference, &coefficients);
            }
        }
        coefficients
    }

    fn assemble(&mut self, state: &State) -> Result<NormalEquations, FitError> {
        self.iterations += 1;
        self.taken = no_step();
        self.model.work += ROBUST_WORK * self.model.window.counted as u64;
        let model = linearize::draw(self.problem, state, self.bloom_px, self.model)?;
        if self.levels == LevelScope::Ring {
            self.reference.levels = [state.white, state.step];
            for cell in &mut self.scratch.cells {
                cell.levels = self.reference.levels;
            }
        }
        let deviation = self.reference.noise2.sqrt().max(MIN_NOISE);
        let ModelScratch { level, window, sums, .. } = &mut *self.model;
        let (reference, robust) = (self.reference, &mut *self.scratch);
        pixels::add_all(*level, &model, PixelSums { reference, deviation, window, sums, robust });
        let products = self.summed_products();
        let ring = linearize::scale(self.problem, state, &model);
        Ok(NormalEquations::new(state, &products, ring))
    }

    /// Products of the kept cells, with the bloom eliminated where it is free.
    fn summed_products(&mut self) -> Products {
        let mut sum: Products = self.model.sums.products.fixed_view::<STILL, STILL>(0, 0).into();
        let kept = || self.scratch.cells.iter().filter(|cell| cell.kept);
        self.misfit = kept().map(|cell| cell.misfit(&self.reference)).sum();
        sum[(0, 0)] = self.misfit;
        if self.levels == LevelScope::Cells {
            for cell in kept() {
                cell.marginalize(&self.reference, &mut sum);
            }
            sum.fill_lower_triangle_with_upper_triangle();
            for level in [column::WHITE, column::STEP] {
                sum.fill_row(level, 0.0);
                sum.fill_column(level, 0.0);
            }
            // The pixels that are not used up by the levels.
            sum[(column::WHITE, column::WHITE)] =
                kept().map(|cell| (cell.pixels() - 2.0).max(0.0)).sum();
            sum[(column::STEP, column::STEP)] = 1.0;
        }
        if self.cut_off {
            let step = self.reference.levels[1];
            let prior = self.reference.noise2 / (BLOOM_PRIOR_PX * step).powi(2);
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
