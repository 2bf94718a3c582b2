//! One linearization: from a state to its image, and from that to the normal equations.

use nalgebra::{Vector2, Vector3};

use super::{
    normal_equation_cache::NormalEquationCache,
    normal_equations::NormalEquations,
    state::{Problem, State},
};
use crate::pose::photometry::{
    FitError, FitScratch, SPACING,
    model::{
        blur_kernel::DifferenceWeights,
        motion,
        projection::{self, Nodes, PrintPose},
        residual_patches,
        window::PixelModel,
    },
};

const MIN_PIXELS: f64 = 30.0;

/// Information that is reused; the pixels then give the gradient only.
#[derive(Clone, Copy)]
enum Reuse<'a> {
    /// That of a state nearby.
    Near(&'a NormalEquations),
    /// That of an earlier frame.
    Recalled(&'a NormalEquationCache),
}

/// Linearizes at the start of a fit, with the cache where it is valid.
pub fn linearize_start(
    problem: &Problem,
    state: &State,
    scratch: &mut FitScratch,
) -> Result<NormalEquations, FitError> {
    let pixels = scratch.window.pixels();
    let cache = problem.cache.filter(|cache| cache.is_valid_for(problem, state, pixels));
    assemble(problem, state, cache.map(Reuse::Recalled), scratch)
}

/// Linearizes at a state, with the information of a state nearby if given.
pub fn linearize(
    problem: &Problem,
    state: &State,
    reuse: Option<&NormalEquations>,
    scratch: &mut FitScratch,
) -> Result<NormalEquations, FitError> {
    assemble(problem, state, reuse.map(Reuse::Near), scratch)
}

fn assemble(
    problem: &Problem,
    state: &State,
    reuse: Option<Reuse>,
    scratch: &mut FitScratch,
) -> Result<NormalEquations, FitError> {
    let kernel = scratch.kernels.nearest(state.blur2.sqrt());
    let radius_px = project(
        problem,
        state,
        kernel.blur_px,
        &mut ProjectionScratch {
            level: scratch.level,
            contours: &mut scratch.contours,
            nodes: &mut scratch.nodes,
            window: scratch.window.origin,
        },
    );
    if !motion::is_linear(&state.motion2) {
        let motion_px = motion::from_square(&state.motion2);
        let quadrature = motion::quadrature(&state.motion2, kernel.blur_px);
        scratch.nodes.smear(scratch.level, &motion_px, quadrature);
    }
    if !scratch.window.scatter(scratch.level, &scratch.nodes, kernel) {
        return Err(FitError::OutOfWindow);
    }
    let pixel_model = pixel_model(problem, state, kernel.blur_px, scratch.window.origin);
    let sums = &mut scratch.sums;
    scratch.window.gather(scratch.level, &pixel_model, sums, reuse.is_none());
    let mut equations = match reuse {
        None => NormalEquations::new(problem, state, (&sums.products, &pixel_model), radius_px),
        Some(Reuse::Near(reuse)) => reuse.updated(&sums.products),
        Some(Reuse::Recalled(cache)) => {
            cache.write_to(&mut sums.products);
            let mut equations =
                NormalEquations::new(problem, state, (&sums.products, &pixel_model), radius_px);
            equations.pixels = scratch.window.pixels() as f64;
            (equations.reused, equations.cache) = (true, true);
            equations
        }
    };
    equations.patch_ratio =
        residual_patches::correlation_ratio(f64::from(sums.patches), equations.misfit);
    if equations.pixels < MIN_PIXELS { Err(FitError::Uninformative) } else { Ok(equations) }
}

pub struct ProjectionScratch<'a> {
    pub level: fearless_simd::Level,
    pub contours: &'a mut crate::pose::photometry::model::contour::Contours,
    pub nodes: &'a mut Nodes,
    pub window: (i64, i64),
}

/// Radius of the outer rim.
pub fn radius_px(problem: &Problem, state: &State) -> f64 {
    // The largest stretch of the lens is at most the norm of its derivative.
    let scale_px = problem.lens.slope.norm() * std::f64::consts::FRAC_1_SQRT_2;
    scale_px * problem.radius_m / (state.pose.position_m.z * problem.lens.spread)
}

/// Projects the contour into the window; returns the radius of the outer rim, pixels.
pub fn project(
    problem: &Problem,
    state: &State,
    blur_px: f64,
    parts: &mut ProjectionScratch,
) -> f64 {
    let radius_px = radius_px(problem, state);
    let around_px = std::f64::consts::TAU * radius_px * 1.1;
    let contour = parts.contours.of(problem.kind, problem.teeth, around_px, SPACING * blur_px);
    let at = (problem.lens, &state.pose, problem.radius_m);
    projection::project(parts.level, at, contour, parts.window, parts.nodes);
    radius_px
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
        taps: DifferenceWeights::of(table_px),
        slope: [lens.slope.m11, lens.slope.m12, lens.slope.m21, lens.slope.m22].map(|m| m as f32),
        light: [state.light.x as f32, state.light.y as f32],
        t: [0, 1].map(|i| [constant[i] as f32, inverse[(i, 0)] as f32, inverse[(i, 1)] as f32]),
        nearness: plane(nearness),
        plane: [plane(in_plane(a)), plane(in_plane(b))],
        lift: [lift.x as f32, lift.y as f32, lift.z as f32],
        middle: [(p.x / (s * p.z)) as f32, (p.y / (s * p.z)) as f32],
    }
}
