//! The other place that looks nearly the same: the roundel mirrored along the line of sight.
//!
//! Where a point of the plane has the relative inverse depth q (1 in the middle), it has 2 - 1/q over q
//! in the mirrored place, so its ray t goes to t/(2 q - 1). The image changes by this displacement times
//! -∇d, one column m more beside those of the unknowns (J, residual r): the mirrored place leaves r - m.
//! Where this place turns by τ, the mirrored one turns by -τ, and m grows by the share κ·τ, as the tangent
//! of the tilt does: in this place's turns the mirrored one's columns are J + m κᵀ. So with the products
//! of m all that a step from there comes to is known without looking at the picture again.
//! Linear in the displacement, this serves up to [`LINEAR_BLURS`]; beyond, the picture decides, unless
//! the mirrored place is worse by [`EXCLUDED`] variances even so.

use nalgebra::Vector3;

use super::{
    cholesky::{Cholesky, MAX_UNKNOWNS},
    linearize::linearize,
    normal_equations::NormalEquations,
    state::{Problem, RANGE, SHIFT, State, TILT},
};
use crate::pose::photometry::{FitScratch, model::projection::PrintPose};

/// Displacement of the outer rim up to which the image follows it linearly, in deviations of its edges.
const LINEAR_BLURS: f64 = 0.6;
/// A place whose misfit is greater by so many variances is not the right one.
const EXCLUDED: f64 = 200.0;

/// What the mirrored place of a solution comes to.
pub struct MirrorEstimate {
    /// Sum of squared residuals after one step, grey levels².
    pub misfit: f64,
    /// The same without the step.
    pub initial_misfit: f64,
    /// How far from the solution's that step's position is, local frame, metres.
    pub other_offset_m: Vector3<f64>,
    /// Where to go on from: where the step leads, if it can be relied on.
    pub state: State,
}

/// The mirrored place after one step; `None` where it has none. `known` is the linear problem at the
/// state, of which a pixel's variance is `noise2`, and `factor` that of its information with what is known
/// beforehand, where there is one.
pub fn evaluate_mirrored(
    problem: &Problem,
    state: &State,
    (equations, noise2, factor): (&NormalEquations, f64, Option<&Cholesky>),
    scratch: &mut FitScratch,
) -> Option<MirrorEstimate> {
    let mirrored = state.mirrored();
    let own = equations.mirrored(state);
    let found = step(&mirrored, &own, noise2, factor)?;
    if is_linear(state, equations) || found.misfit > equations.misfit + EXCLUDED * noise2 {
        return Some(found);
    }
    let mut own = linearize(problem, &mirrored, Some(&own), scratch).ok()?;
    negate_turns(&mut own.gradient);
    // A step so far from where the information holds says which place is nearer, and no more.
    let found = step(&mirrored, &own, noise2, factor)?;
    Some(MirrorEstimate { state: mirrored, ..found })
}

/// Whether the mirrored place moves the rims by so little that the image follows it linearly.
pub fn is_linear(state: &State, equations: &NormalEquations) -> bool {
    equations.apart_px < LINEAR_BLURS * state.edge_px()
}

/// One step from the mirrored place, with the information of the other, whose turns the gradient's are.
fn step(
    mirrored: &State,
    equations: &NormalEquations,
    noise2: f64,
    factor: Option<&Cholesky>,
) -> Option<MirrorEstimate> {
    // Of the information only the tilts' is another.
    let mut change = match factor {
        Some(factor) => equations.step_beside(mirrored, noise2, factor)?,
        None => equations.step(mirrored, noise2, 0.0)?,
    };
    let gain: f64 = change.iter().zip(&equations.gradient).map(|(x, g)| x * g).sum();
    negate_turns(&mut change);
    let other_offset_m = Vector3::new(change[SHIFT], change[SHIFT + 1], 0.0) * equations.unit_m
        + mirrored.pose.position_m * change[RANGE];
    let state = mirrored.moved(equations, &change)?;
    Some(MirrorEstimate {
        misfit: equations.misfit - gain,
        initial_misfit: equations.misfit,
        other_offset_m,
        state,
    })
}

impl NormalEquations {
    /// That of the mirrored place, in this one's turns.
    fn mirrored(&self, state: &State) -> Self {
        let mut other = self.clone();
        let (with_unknowns, with_residual, own) = &self.mirror;
        let grown = state.mirror_growth();
        for (i, row) in other.information.iter_mut().enumerate() {
            for (j, value) in row.iter_mut().enumerate() {
                *value += with_unknowns[i] * grown[j]
                    + grown[i] * with_unknowns[j]
                    + grown[i] * grown[j] * own;
            }
        }
        for (i, gradient) in other.gradient.iter_mut().enumerate() {
            *gradient += grown[i] * (with_residual - own) - with_unknowns[i];
        }
        other.misfit += own - 2.0 * with_residual;
        other
    }
}

impl State {
    /// κ: by which share each unknown makes m grow.
    fn mirror_growth(&self) -> [f64; MAX_UNKNOWNS] {
        let PrintPose { position_m, axes } = &self.pose;
        let along = axes.transpose() * position_m.normalize();
        let across2 = along.x * along.x + along.y * along.y;
        let mut growth = [0.0; MAX_UNKNOWNS];
        if across2 > 0.0 {
            growth[TILT] = along.y / (along.z * across2);
            growth[TILT + 1] = -along.x / (along.z * across2);
        }
        growth
    }
}

/// From one place's turns to the other's.
fn negate_turns(unknowns: &mut [f64; MAX_UNKNOWNS]) {
    unknowns[TILT] *= -1.0;
    unknowns[TILT + 1] *= -1.0;
}
