//! State of the robust fit from frame to frame.
//!
//! A disturbance lasts: the same stretches of the rims are occluded, shaded or clipped in the next
//! frame. A fit that starts from the cells of the frame before takes about two linearizations, a first
//! one ten to thirty. The other normal, if clearly worse, is tested again every
//! [`MAX_MIRROR_AGE`] frames only.

use nalgebra::{Vector2, Vector3};

use super::{
    LevelScope, RobustFit,
    cells::{Cell, MAX_CELLS, Reference},
};
use crate::pose::photometry::solver::{mirror::MirrorEstimate, solution::Solution, state::State};

/// Decrease of the likelihood, in variances of the misfit, from which the other normal is clearly
/// worse.
const CLEARLY_WORSE: f64 = 40.0;
/// Frames in which that is not tested again.
const MAX_MIRROR_AGE: u8 = 8;
/// Every this many frames the plain fit is tried first.
const PLAIN_INTERVAL: u8 = 8;

/// What the next robust fit of a tracked ring reuses.
#[derive(Clone, Copy, Debug)]
pub struct RobustState {
    scope: LevelScope,
    /// Numbers of cells of outer and inner rim.
    counts: [usize; 2],
    /// One bit for each kept cell.
    kept: u64,
    /// W and C of the cells, grey levels.
    levels: [[f32; 2]; MAX_CELLS],
    /// W and C of the ring, grey levels, and the gradient of its light.
    white: f64,
    step: f64,
    light: Vector2<f64>,
    bloom_px: f64,
    noise2: f64,
    other: OtherNormal,
    /// Number of robust fits since the plain fit was tried.
    frames: u8,
}

/// How much worse the other normal is.
#[derive(Clone, Copy, Debug)]
struct OtherNormal {
    /// In variances of the misfit.
    excess: f64,
    offset_m: Vector3<f64>,
    age: u8,
}

impl RobustState {
    /// Whether the plain fit should be tried before.
    pub fn expects_plain(&self) -> bool {
        self.frames >= PLAIN_INTERVAL
    }

    /// After a frame for which the plain fit sufficed.
    pub fn after_plain(self) -> Self {
        Self { frames: PLAIN_INTERVAL, ..self }
    }
}

impl RobustFit<'_> {
    /// Starts from cells and levels of the frame before; `None` if its cells are others.
    pub(super) fn resume(&mut self, start: &State, before: &RobustState) -> Option<State> {
        let cells = &mut self.scratch.cells;
        if counts(cells) != before.counts {
            return None;
        }
        for (index, (cell, levels)) in cells.iter_mut().zip(&before.levels).enumerate() {
            cell.kept = before.kept >> index & 1 == 1;
            cell.levels = levels.map(f64::from);
        }
        self.levels = before.scope;
        self.bloom_px = if self.cut_off { before.bloom_px } else { 0.0 };
        let RobustState { white, step, light, noise2, .. } = *before;
        self.reference = Reference { levels: [white, step], noise2 };
        Some(State { white, step, light, ..start.clone() })
    }

    /// State for the next frame, before the other normal is known.
    pub(super) fn state(&self, solution: &Solution, before: Option<&RobustState>) -> RobustState {
        let State { white, step, light, .. } = solution.state;
        let cells = &self.scratch.cells;
        let mut levels = [[0.0; 2]; MAX_CELLS];
        let mut kept = 0;
        for (index, cell) in cells.iter().enumerate() {
            levels[index] = cell.levels.map(|level| level as f32);
            kept |= u64::from(cell.kept) << index;
        }
        RobustState {
            scope: self.levels,
            counts: counts(cells),
            kept,
            levels,
            white,
            step,
            light,
            bloom_px: self.bloom_px,
            noise2: solution.equations.noise2(),
            other: OtherNormal { excess: 0.0, offset_m: Vector3::zeros(), age: MAX_MIRROR_AGE },
            frames: before.map_or(0, |before| before.frames % PLAIN_INTERVAL) + 1,
        }
    }

    /// A solution from a resumed start with the other normal, which is taken from the frame before
    /// where it was clearly worse, and else tested by one step.
    pub(super) fn resumed_against_mirrored(
        &mut self,
        first: Solution,
        before: &RobustState,
        next: &mut RobustState,
    ) -> (Solution, Option<MirrorEstimate>) {
        let OtherNormal { excess, offset_m, age } = before.other;
        if excess > CLEARLY_WORSE && age < MAX_MIRROR_AGE {
            next.other = OtherNormal { age: age + 1, ..before.other };
            let misfit = first.misfit + excess * first.noise2;
            let state = first.state.mirrored();
            let other =
                MirrorEstimate { misfit, initial_misfit: misfit, other_offset_m: offset_m, state };
            return (first, Some(other));
        }
        let mirrored = first.state.mirrored();
        let Ok(mut equations) = self.assemble(&mirrored) else { return (first, None) };
        let Some(change) = equations.bounded_step(&mirrored, first.noise2, 0.0) else {
            return (first, None);
        };
        let misfit = equations.misfit - equations.gain(&change);
        if misfit < first.misfit {
            return self.against_mirrored(first);
        }
        let unit_m = equations.ring.unit_m;
        let other_offset_m = mirrored
            .moved(unit_m, &change)
            .map_or(Vector3::zeros(), |moved| moved.pose.position_m - first.state.pose.position_m);
        let excess = (misfit - first.misfit) / first.noise2;
        next.other = OtherNormal { excess, offset_m: other_offset_m, age: 0 };
        let other =
            MirrorEstimate { misfit, initial_misfit: misfit, other_offset_m, state: mirrored };
        (first, Some(other))
    }
}

fn counts(cells: &[Cell]) -> [usize; 2] {
    let inner = cells.iter().filter(|cell| cell.rim == 1).count();
    [cells.len() - inner, inner]
}
