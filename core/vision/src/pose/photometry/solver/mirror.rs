//! The other pose that looks nearly the same: the roundel mirrored along the line of sight.
//!
//! A point of the plane with relative inverse depth q (1 in the middle) has 2 - 1/q over q in the
//! mirrored pose, so its ray t becomes t/(2 q - 1). This displacement times -∇d changes the image
//! by m, one more column besides those of the unknowns (J, residual r): the mirrored pose leaves r - m.
//! Where this pose rotates by τ, the mirrored one rotates by -τ, and m grows by the share κ·τ,
//! as the tangent of the tilt does: in rotations of this pose the columns of the mirrored one are J + m
//! κᵀ. With the products of m, the result of a step from the mirrored pose is known without
//! another pass over the pixels. This is linear in the displacement and holds up to
//! [`LINEAR_BLURS`]. Beyond that the pixels decide, unless the mirrored pose is worse by
//! [`EXCLUDED`] variances anyway.

use nalgebra::Vector3;

use super::{
    cholesky::Unknowns,
    linearize::linearize,
    normal_equations::{MirrorProducts, NormalEquations},
    state::{Problem, RANGE, SHIFT, State, TILT},
};
use crate::pose::photometry::model::{ModelScratch, projection::PrintPose};

/// Displacement of the outer rim up to which the image is linear in it, in standard deviations of
/// its edges.
const LINEAR_BLURS: f64 = 0.6;
/// A pose with a misfit larger by this number of variances is excluded.
const EXCLUDED: f64 = 200.0;

/// Estimate of the mirrored pose.
pub struct MirrorEstimate {
    /// Sum of squared residuals after one step, grey levels².
    pub misfit: f64,
    /// `misfit` without the step.
    pub initial_misfit: f64,
    /// From the solution's position to that after the step, local frame.
    pub other_offset_m: Vector3<f64>,
    /// Where to continue: after the step, if it is reliable.
    pub state: State,
}

/// The mirrored pose after one step; `None` where there is none. `equations` is the problem at the
/// state, and `noise2` the variance of a pixel.
pub fn evaluate_mirrored(
    problem: &Problem,
    state: &State,
    equations: &NormalEquations,
    noise2: f64,
    scratch: &mut ModelScratch,
) -> Option<MirrorEstimate> {
    let mirrored = state.mirrored();
    let own = equations.mirrored(state);
    let found = step(&mirrored, &own, noise2)?;
    if is_linear(state, equations) || found.misfit > equations.misfit + EXCLUDED * noise2 {
        return Some(found);
    }
    let mut own = linearize(problem, &mirrored, Some(&own), scratch).ok()?;
    negate_turns(&mut own.gradient);
    // The information does not hold this far: the step decides which pose is closer, and is not
    // taken.
    let found = step(&mirrored, &own, noise2)?;
    Some(MirrorEstimate { state: mirrored, ..found })
}

/// Whether the mirrored pose displaces the rims by so little that the image is linear in it.
pub fn is_linear(state: &State, equations: &NormalEquations) -> bool {
    equations.ring.mirror_px < LINEAR_BLURS * state.edge_px()
}

/// One step from the mirrored pose, with the information and in the rotations of the other.
fn step(mirrored: &State, equations: &NormalEquations, noise2: f64) -> Option<MirrorEstimate> {
    let mut change = equations.step(mirrored, noise2, 0.0)?;
    let gain = equations.gain(&change);
    negate_turns(&mut change);
    let other_offset_m = Vector3::new(change[SHIFT], change[SHIFT + 1], 0.0)
        * equations.ring.unit_m
        + mirrored.pose.position_m * change[RANGE];
    let state = mirrored.moved(equations.ring.unit_m, &change)?;
    Some(MirrorEstimate {
        misfit: equations.misfit - gain,
        initial_misfit: equations.misfit,
        other_offset_m,
        state,
    })
}

impl NormalEquations {
    /// The problem at the mirrored pose, in rotations of this one.
    fn mirrored(&self, state: &State) -> Self {
        let mut other = self.clone();
        let MirrorProducts { with_unknowns, with_residual, own } = &self.mirror;
        let grown = state.mirror_growth();
        let cross = with_unknowns * grown.transpose();
        other.information += cross + cross.transpose() + grown * grown.transpose() * *own;
        other.gradient += grown * (with_residual - own) - with_unknowns;
        other.misfit += own - 2.0 * with_residual;
        other
    }
}

impl State {
    /// κ: relative growth of m by each unknown.
    fn mirror_growth(&self) -> Unknowns {
        let PrintPose { position_m, axes } = &self.pose;
        let along = axes.transpose() * position_m.normalize();
        let across2 = along.x * along.x + along.y * along.y;
        let mut growth = Unknowns::zeros();
        if across2 > 0.0 {
            growth[TILT] = along.y / (along.z * across2);
            growth[TILT + 1] = -along.x / (along.z * across2);
        }
        growth
    }
}

/// Converts between the rotations of the two poses.
fn negate_turns(unknowns: &mut Unknowns) {
    unknowns[TILT] *= -1.0;
    unknowns[TILT + 1] *= -1.0;
}
