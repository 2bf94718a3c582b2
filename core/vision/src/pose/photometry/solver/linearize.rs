//! One linearization: from a state to its image, and from that to the normal equations.

use nalgebra::{Vector2, Vector3};

use super::{
    normal_equations::{NormalEquations, RingScale},
    state::{Problem, State},
};
use crate::pose::photometry::{
    FitError,
    model::{
        ModelScratch,
        blur_kernel::DifferenceWeights,
        columns::PixelModel,
        contour::SPACING_BLURS,
        motion,
        projection::{self, PrintPose, ProjectedPrint},
        residual_patches,
    },
};

const MIN_PIXELS: f64 = 30.0;

/// Linearizes at a state; with the information of a state nearby, if given, the pixels give the
/// gradient only.
pub fn linearize(
    problem: &Problem,
    state: &State,
    reuse: Option<&NormalEquations>,
    scratch: &mut ModelScratch,
) -> Result<NormalEquations, FitError> {
    let model = draw(problem, state, 0.0, scratch)?;
    scratch.work += scratch.window.counted as u64;
    let sums = &mut scratch.sums;
    scratch.window.gather(scratch.level, &model, sums, reuse.is_none());
    let mut equations = match reuse {
        None => NormalEquations::new(state, &sums.products, scale(problem, state, &model)),
        Some(reuse) => reuse.updated(&sums.products),
    };
    equations.patch_ratio =
        residual_patches::correlation_ratio(f64::from(sums.patches), equations.misfit);
    if equations.pixels < MIN_PIXELS { Err(FitError::Uninformative) } else { Ok(equations) }
}

/// Scatters the contour, with both rims moved into the black by a bloom, and returns the model for
/// the columns.
pub fn draw(
    problem: &Problem,
    state: &State,
    bloom_px: f64,
    scratch: &mut ModelScratch,
) -> Result<PixelModel, FitError> {
    let window = scratch.window.origin;
    let blur_px = scratch.kernels.nearest(state.blur2.sqrt()).blur_px;
    project(problem, state, blur_px, window, scratch);
    let shift_px = problem.print.shift_px + bloom_px;
    if shift_px != 0.0 {
        scratch.nodes.move_rims(scratch.level, shift_px);
    }
    if !motion::is_linear(&state.motion2) {
        let motion_px = motion::from_square(&state.motion2);
        let quadrature = motion::quadrature(&state.motion2, blur_px);
        scratch.nodes.smear(scratch.level, &motion_px, quadrature);
    }
    let kernel = scratch.kernels.nearest(blur_px);
    if !scratch.window.scatter(scratch.level, &scratch.nodes, kernel) {
        return Err(FitError::OutOfWindow);
    }
    Ok(pixel_model(problem, state, blur_px, window))
}

/// Radius of the outer rim.
pub fn radius_px(problem: &Problem, state: &State) -> f64 {
    // The largest stretch of the lens is at most the norm of its derivative.
    let scale_px = problem.lens.slope.norm() * std::f64::consts::FRAC_1_SQRT_2;
    scale_px * problem.radius_m / (state.pose.position_m.z * problem.lens.spread)
}

pub fn scale(problem: &Problem, state: &State, model: &PixelModel) -> RingScale {
    let radius_px = radius_px(problem, state);
    RingScale {
        radius_px,
        disc_ratio: problem.disc_ratio(),
        mirror_px: 2.0 * radius_px * model.nearness[1].hypot(model.nearness[2]) as f64,
        unit_m: state.pose.position_m.z * problem.lens.spread,
        motion_prior: (!problem.is_still).then_some(problem.motion_prior),
    }
}

/// Projects the contour into the window with this top left pixel.
pub fn project(
    problem: &Problem,
    state: &State,
    blur_px: f64,
    window: (i64, i64),
    scratch: &mut ModelScratch,
) {
    let around_px = std::f64::consts::TAU * radius_px(problem, state) * 1.1;
    let ModelScratch { level, contours, nodes, .. } = scratch;
    let contour = contours.get(problem.kind, problem.teeth, around_px, SPACING_BLURS * blur_px);
    let (lens, radius_m) = (problem.lens, problem.radius_m);
    let disc_scale = problem.print.disc_scale;
    let print = ProjectedPrint { lens, pose: &state.pose, radius_m, disc_scale, window };
    projection::project(*level, &print, contour, nodes);
}

pub fn pixel_model(
    problem: &Problem,
    state: &State,
    table_px: f64,
    window: (i64, i64),
) -> PixelModel {
    let (lens, PrintPose { position_m: p, axes }) = (problem.lens, &state.pose);
    let s = lens.spread;
    let [a, b, n] = [0, 1, 2].map(|i| axes.column(i).into_owned());
    let nearness = Vector3::new(n.x * s, n.y * s, n.z) * (p.z / n.dot(p));
    let in_plane = |axis: Vector3<f64>| {
        let ray = Vector3::new(axis.x * s, axis.y * s, axis.z) * p.z;
        (ray - nearness * axis.dot(p)) / problem.radius_m
    };
    let inverse = lens.slope.try_inverse().unwrap_or_default();
    // t = slope⁻¹ (pixel - pixel of t = 0): an affine lens is enough for the columns.
    let from = Vector2::new(
        window.0 as f64 - lens.origin.u - f64::from(lens.terms[0][0]),
        window.1 as f64 - lens.origin.v - f64::from(lens.terms[1][0]),
    );
    let constant = inverse * from;
    let linear_part = motion::linear_part(&state.motion2);
    let plane = |v: Vector3<f64>| [v.z as f32, v.x as f32, v.y as f32];
    let lift = Vector3::new(n.x / s, n.y / s, n.z) * (problem.radius_m / p.z);
    PixelModel {
        white: state.white as f32,
        step: state.step as f32,
        blur: (0.5 * (state.blur2 - table_px * table_px + linear_part.norm() / 24.0)) as f32,
        motion: (!problem.is_still)
            .then(|| [linear_part.x, linear_part.y].map(|part| (part / 48.0) as f32)),
        taps: DifferenceWeights::new(table_px),
        slope: [lens.slope.m11, lens.slope.m12, lens.slope.m21, lens.slope.m22].map(|m| m as f32),
        light: [state.light.x as f32, state.light.y as f32],
        t: [0, 1].map(|i| [constant[i] as f32, inverse[(i, 0)] as f32, inverse[(i, 1)] as f32]),
        nearness: plane(nearness),
        plane: [plane(in_plane(a)), plane(in_plane(b))],
        lift: [lift.x as f32, lift.y as f32, lift.z as f32],
        middle: [(p.x / (s * p.z)) as f32, (p.y / (s * p.z)) as f32],
    }
}
