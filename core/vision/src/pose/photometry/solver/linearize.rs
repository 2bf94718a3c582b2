//! One look at the pixels: from a state to its image, and from that to the linear problem.

use nalgebra::{Vector2, Vector3};

use super::{
    normal_equation_cache::RecalledProducts,
    normal_equations::Linear,
    state::{Problem, State},
};
use crate::pose::photometry::{
    FitError, FitScratch, SPACING,
    model::{
        blur_kernel::Taps,
        motion,
        projection::{self, Nodes, Place},
        residual_patches,
        window::Model,
    },
};

/// Fewest pixels.
const MIN_PIXELS: f64 = 30.0;

/// What is known of a linear problem beforehand: with it the pixels are asked for the rest only.
#[derive(Clone, Copy)]
enum Known<'a> {
    /// The one at a state near by.
    Near(&'a Linear),
    /// Products of columns, from a frame before.
    Recalled(&'a RecalledProducts),
}

/// The linear problem at a state where a fit begins: with what is recalled, if that serves there.
pub fn begin(
    problem: &Problem,
    state: &State,
    scratch: &mut FitScratch,
) -> Result<Linear, FitError> {
    let pixels = scratch.window.pixels();
    let recalled = problem.recalled.filter(|recalled| recalled.serve(problem, state, pixels));
    look(problem, state, recalled.map(Known::Recalled), scratch)
}

/// The linear problem at a state; with the information that is known from near by, if there is one.
pub fn linearize(
    problem: &Problem,
    state: &State,
    known: Option<&Linear>,
    scratch: &mut FitScratch,
) -> Result<Linear, FitError> {
    look(problem, state, known.map(Known::Near), scratch)
}

fn look(
    problem: &Problem,
    state: &State,
    known: Option<Known>,
    scratch: &mut FitScratch,
) -> Result<Linear, FitError> {
    let kernel = scratch.kernels.near(state.blur2.sqrt());
    let radius_px = project(
        problem,
        state,
        kernel.blur_px,
        &mut Parts {
            level: scratch.level,
            contours: &mut scratch.contours,
            nodes: &mut scratch.nodes,
            window: scratch.window.origin,
        },
    );
    if !motion::is_linear(&state.motion2) {
        let motion_px = motion::of_square(&state.motion2);
        let places = motion::places(&state.motion2, kernel.blur_px);
        scratch.nodes.smear(scratch.level, &motion_px, places);
    }
    if !scratch.window.scatter(scratch.level, &scratch.nodes, kernel) {
        return Err(FitError::Away);
    }
    let model = model(problem, state, kernel.blur_px, scratch.window.origin);
    let sums = &mut scratch.sums;
    scratch.window.gather(scratch.level, &model, sums, known.is_none());
    let mut linear = match known {
        None => Linear::new(problem, state, (&sums.products, &model), radius_px),
        Some(Known::Near(known)) => known.updated(&sums.products),
        Some(Known::Recalled(recalled)) => {
            recalled.put(&mut sums.products);
            let mut linear = Linear::new(problem, state, (&sums.products, &model), radius_px);
            linear.pixels = scratch.window.pixels() as f64;
            (linear.reused, linear.recalled) = (true, true);
            linear
        }
    };
    linear.together = residual_patches::share(f64::from(sums.patches), linear.misfit);
    if linear.pixels < MIN_PIXELS { Err(FitError::Flat) } else { Ok(linear) }
}

/// What carrying the contour into the window needs of the scratch.
pub struct Parts<'a> {
    pub level: fearless_simd::Level,
    pub contours: &'a mut crate::pose::photometry::model::contour::Contours,
    pub nodes: &'a mut Nodes,
    pub window: (i64, i64),
}

/// The outer rim's radius, pixels.
pub fn radius_px(problem: &Problem, state: &State) -> f64 {
    // The largest stretch of the lens is at most the slope's norm.
    let scale_px = problem.lens.slope.norm() * std::f64::consts::FRAC_1_SQRT_2;
    scale_px * problem.radius_m / (state.place.position_m.z * problem.lens.spread)
}

/// Carries the contour into the window; returns the outer rim's radius, pixels.
pub fn project(problem: &Problem, state: &State, blur_px: f64, parts: &mut Parts) -> f64 {
    let radius_px = radius_px(problem, state);
    let around_px = std::f64::consts::TAU * radius_px * 1.1;
    let contour = parts.contours.of(problem.kind, problem.teeth, around_px, SPACING * blur_px);
    let at = (problem.lens, &state.place, problem.radius_m);
    projection::project(parts.level, at, contour, parts.window, parts.nodes);
    radius_px
}

pub fn model(problem: &Problem, state: &State, table_px: f64, window: (i64, i64)) -> Model {
    let (lens, Place { position_m: p, axes }) = (problem.lens, &state.place);
    let s = lens.spread;
    let [a, b, n] = [0, 1, 2].map(|i| axes.column(i).into_owned());
    let nearness = Vector3::new(n.x * s, n.y * s, n.z) * (p.z / n.dot(p));
    let in_plane = |axis: Vector3<f64>| {
        let ray = Vector3::new(axis.x * s, axis.y * s, axis.z) * p.z;
        (ray - nearness * axis.dot(p)) / problem.radius_m
    };
    let inverse = lens.slope.try_inverse().unwrap_or_default();
    // t = slope⁻¹ (pixel - pixel of t = 0): for the columns an affine lens is enough.
    let from = Vector2::new(
        window.0 as f64 - lens.origin.u - f64::from(lens.terms[0][0]),
        window.1 as f64 - lens.origin.v - f64::from(lens.terms[1][0]),
    );
    let constant = inverse * from;
    let missing = motion::missing(&state.motion2);
    let plane = |v: Vector3<f64>| [v.z as f32, v.x as f32, v.y as f32];
    let lift = Vector3::new(n.x / s, n.y / s, n.z) * (problem.radius_m / p.z);
    Model {
        white: state.white as f32,
        step: state.step as f32,
        blur: (0.5 * (state.blur2 - table_px * table_px + missing.norm() / 24.0)) as f32,
        motion: (!problem.is_still)
            .then(|| [missing.x, missing.y].map(|part| (part / 48.0) as f32)),
        taps: Taps::of(table_px),
        slope: [lens.slope.m11, lens.slope.m12, lens.slope.m21, lens.slope.m22].map(|m| m as f32),
        light: [state.light.x as f32, state.light.y as f32],
        t: [0, 1].map(|i| [constant[i] as f32, inverse[(i, 0)] as f32, inverse[(i, 1)] as f32]),
        nearness: plane(nearness),
        plane: [plane(in_plane(a)), plane(in_plane(b))],
        lift: [lift.x as f32, lift.y as f32, lift.z as f32],
        middle: [(p.x / (s * p.z)) as f32, (p.y / (s * p.z)) as f32],
    }
}
