//! The fit's unknowns, and the steps that find them.

use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};

use super::{
    FitError, FitScratch, SPACING,
    blur::{BLUR_LIMITS_PX, Taps},
    image::Model,
    lens::LocalLens,
    mirror::{glance, is_linear},
    normal::{Products, column},
    patches,
    solution::Solution,
    solve::{Factor, MOST},
    teeth::Teeth,
    view::{self, Nodes, Place},
};
use crate::{
    ellipse::Chords,
    frame::Frame,
    marker::{Kind, Ring},
};

/// What stays the same during one fit.
pub struct Problem<'a> {
    pub frame: &'a Frame<'a>,
    pub kind: &'a Kind,
    /// Of a coded print, as read.
    pub teeth: Option<Teeth>,
    pub radius_m: f64,
    pub lens: &'a LocalLens,
    /// Pixels that count.
    pub chords: Chords,
}

/// The unknowns.
#[derive(Clone, Debug)]
pub struct State {
    pub place: Place,
    /// σ², px².
    pub blur2: f64,
    /// W, grey levels.
    pub white: f64,
    /// C = B - W, grey levels.
    pub step: f64,
    /// ℓ: relative change of the light by t.
    pub light: Vector2<f64>,
}

/// The linear problem at a state.
#[derive(Clone, Debug)]
pub struct Linear {
    pub information: [[f64; MOST]; MOST],
    /// From columns to unknowns.
    pub scale: [f64; MOST],
    pub gradient: [f64; MOST],
    /// Sum of squared residuals, grey levels².
    pub misfit: f64,
    pixels: f64,
    /// How far residuals hang together ([`patches::share`]).
    pub together: f64,
    /// Products of what tells the mirrored place from this one: with the unknowns, with the residual and
    /// with itself.
    pub mirror: ([f64; MOST], f64, f64),
    /// How far the mirrored place moves the outer rim, pixels.
    pub apart_px: f64,
    /// Whether the information is that of an earlier state.
    reused: bool,
    /// Information of a move of both rims.
    edges: f64,
    /// The outer rim's radius, pixels.
    radius_px: f64,
    /// Information of a rim's elongation, both rims.
    pub elongation: f64,
    /// p₃ s: metres that a unit of shift is.
    pub unit_m: f64,
}

/// Unknowns.
pub const UNKNOWNS: usize = 10;
/// Column of the mirrored place.
const MIRROR: usize = column::MIRROR;
/// Steps at most.
const MAX_STEPS: usize = 16;
/// A step that lowers the misfit by less than this many variances is the last one.
const LAST_STEP: f64 = 0.5;
/// A step is the last one too if it moves the rims by less than this on average, pixels …
const LAST_MOVE_PX: f64 = 0.03;
/// … which the pixels tell with a misfit of no more variances: what the columns miss of it is far below
/// the noise …
const LAST_MOVE: f64 = 25.0;
/// … by no more through the square of its turn …
const LAST_BEND_PX: f64 = 0.002;
/// … and σ² by less than this share of the radius, px² to px: the smaller the rims, the less they tell blur
/// from size and levels, and the further the columns' errors carry.
const LAST_BLUR_PX: f64 = 8e-4;
/// After a step that was to lower the misfit by less than this many variances the information is
/// not taken anew.
const SMALL_STEP: f64 = 100.0;
/// The least damping, other than none.
const LEAST_DAMPING: f64 = 0.01;
/// Nor is it where a step turned the plane by more than this share of its tilt: of a roundel that is
/// seen face-on the information about its tilt comes with the tilt.
const SMALL_TURN: f64 = 0.3;
/// A step that promises less than this many variances, and does not keep it, is left out.
const SETTLED: f64 = 4.0;
/// The mirrored place's misfit is to be smaller by so many variances for the fit to go on there.
const MIRRORED: f64 = 10.0;
/// Sine of the tilt from which on a first step tells the two normals apart.
const TILTED: f64 = 0.2;
/// Deviation of the light's gradient: relative change over a radius.
const LIGHT_PRIOR: f64 = 0.1;
/// Least difference of black and white, grey levels.
const MIN_STEP: f64 = 5.0;
/// Fewest pixels.
const MIN_PIXELS: f64 = 30.0;
/// Largest turn of one step, radians.
const MAX_TURN_RAD: f64 = 0.3;
/// [`patches::share`] of noise exceeds 1 by no more than this over the root of the number of pixels: three
/// deviations, since a clean ring that is taken for a disturbed one costs as much as a hundred others.
const EVEN: f64 = 15.0;

pub const WHITE: usize = column::WHITE - 1;
pub const STEP: usize = column::STEP - 1;
pub const BLUR: usize = column::BLUR - 1;
pub const LIGHT: usize = column::LIGHT - 1;
pub const SHIFT: usize = column::SHIFT - 1;
pub const RANGE: usize = column::RANGE - 1;
pub const TILT: usize = column::TILT - 1;

impl State {
    pub fn new(place: Place, ring: &Ring, blur_px: f64) -> Self {
        Self {
            place,
            blur2: blur_px * blur_px,
            white: ring.white,
            step: ring.black - ring.white,
            light: Vector2::zeros(),
        }
    }

    /// The other place that looks nearly the same: mirrored along the line of sight.
    pub fn mirrored(&self) -> Self {
        let sight = self.place.position_m.normalize();
        let flip = |axis: Vector3<f64>| axis - sight * (2.0 * sight.dot(&axis));
        let axes = &self.place.axes;
        // The normal's component along the sight stays, those of the plane's axes turn round.
        let a = flip(axes.column(0).into_owned());
        let normal = -flip(axes.column(2).into_owned());
        let place = Place {
            position_m: self.place.position_m,
            axes: Matrix3::from_columns(&[a, normal.cross(&a), normal]),
        };
        Self { place, ..self.clone() }
    }

    /// Whether the blur is at the end of its range, and a change would take it out.
    pub fn blur_ends(&self, change: f64) -> bool {
        let (low, high) = BLUR_LIMITS_PX;
        (change < 0.0 && self.blur2 <= low * low) || (change > 0.0 && self.blur2 >= high * high)
    }

    /// The blur's variance changed, within its limits.
    pub fn widen(&mut self, change: f64) {
        let (low, high) = BLUR_LIMITS_PX;
        self.blur2 = (self.blur2 + change).clamp(low * low, high * high);
    }

    /// Whether a change turns the plane by little, compared to its tilt.
    fn is_turned_little(&self, change: &[f64; MOST]) -> bool {
        let cosine = self.place.axes.column(2).dot(&self.place.position_m.normalize());
        let turn2 = change[TILT].powi(2) + change[TILT + 1].powi(2);
        turn2 < SMALL_TURN * SMALL_TURN * (1.0 - cosine * cosine)
    }

    /// Whether the two normals are so far apart that a first step tells them apart: nearer to face-on
    /// it goes as far as they are, and what it says of the other one is worth nothing.
    fn is_tilted(&self) -> bool {
        let place = &self.place;
        let cosine = place.axes.column(2).dot(&place.position_m.normalize());
        1.0 - cosine * cosine > TILTED * TILTED
    }

    /// Moved by a solution; `None` if that is no roundel in front of the camera.
    pub fn moved(&self, linear: &Linear, change: &[f64; MOST]) -> Option<Self> {
        let mut next = self.clone();
        next.white += change[WHITE];
        next.step += change[STEP];
        // Shape's columns were taken times the step; it is known better now.
        let ratio = self.step / next.step;
        if !(0.2..5.0).contains(&ratio) {
            return Some(next);
        }
        next.widen(ratio * change[BLUR]);
        next.light += Vector2::new(change[LIGHT], change[LIGHT + 1]);
        let turn = Vector2::new(change[TILT], change[TILT + 1]) * ratio;
        // A turn too large for its own linearization is cut, and all else with it.
        let cut = (MAX_TURN_RAD / turn.norm()).min(1.0) * ratio;
        let place = &mut next.place;
        let shift = Vector3::new(change[SHIFT], change[SHIFT + 1], 0.0) * linear.unit_m;
        place.position_m *= (cut * change[RANGE]).clamp(-0.2, 0.2).exp();
        place.position_m += shift * cut;
        let (a, b) = (place.axes.column(0), place.axes.column(1));
        let turn = (a * change[TILT] + b * change[TILT + 1]) * cut;
        place.axes = Rotation3::new(turn).matrix() * place.axes;
        let normal = place.axes.column(2);
        let faces = normal.dot(&place.position_m) < 0.0 && place.position_m.z > 0.0;
        faces.then_some(next)
    }
}

/// Finds the unknowns from a start.
pub fn solve(
    problem: &Problem,
    start: State,
    scratch: &mut FitScratch,
) -> Result<Solution, FitError> {
    let mut state = start;
    let mut linear = linearize(problem, &state, None, scratch)?;
    let mut damping = 0.0;
    for step in 1..=MAX_STEPS {
        let noise2 = linear.noise2();
        let mut change = linear.step(&state, noise2, damping).ok_or(FitError::Flat)?;
        if state.blur_ends(change[BLUR]) {
            linear.hold(BLUR);
            change = linear.step(&state, noise2, damping).ok_or(FitError::Flat)?;
        }
        let gain: f64 = change.iter().zip(&linear.gradient).map(|(x, g)| x * g).sum();
        let next = state.moved(&linear, &change).ok_or(FitError::Away)?;
        let left = (linear.misfit - gain).max(0.0);
        let settled = gain < LAST_STEP * linear.noise2_of(left);
        let last = damping == 0.0 && (settled || linear.holds_over(&state, &change));
        if last && next.step.abs() < MIN_STEP {
            return Err(FitError::Flat);
        }
        if last {
            let noise2 = linear.noise2_of(left);
            linear.carry(&change, left);
            return Ok(Solution { state: next, misfit: left, noise2, iterations: step, linear });
        }
        if step == 1 && gain > SMALL_STEP * noise2 && next.is_tilted() && is_linear(&state, &linear)
        {
            let mut behind = linear.clone();
            behind.carry(&change, left);
            let left2 = linear.noise2_of(left);
            // From the wrong place of two, the first step already says so.
            if let Some(other) = glance(problem, &next, (&behind, left2), scratch)
                && other.misfit < left - MIRRORED * left2
                && let Ok(found) = linearize(problem, &other.state, None, scratch)
            {
                (state, linear) = (other.state, found);
                continue;
            }
        }
        // The information hardly changes over a small step; the residual does.
        let small = gain < SMALL_STEP * noise2 && damping == 0.0 && state.is_turned_little(&change);
        let known = (small && !linear.reused).then_some(&linear);
        match linearize(problem, &next, known, scratch) {
            // Another blur's table moves the misfit by less than a variance.
            Ok(found) if found.misfit <= linear.misfit + noise2 => {
                (state, linear) = (next, found);
                damping = if damping > LEAST_DAMPING { 0.1 * damping } else { 0.0 };
            }
            Err(FitError::Flat) => return Err(FitError::Flat),
            // Rounding, not the model, stands in the way of so little.
            Ok(_) if gain < SETTLED * noise2 => {
                let misfit = linear.misfit;
                return Ok(Solution { state, misfit, noise2, iterations: step, linear });
            }
            _ => damping = (10.0 * damping).max(LEAST_DAMPING),
        }
    }
    Err(FitError::Restless)
}

pub fn linearize(
    problem: &Problem,
    state: &State,
    known: Option<&Linear>,
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
    if !scratch.window.scatter(scratch.level, &scratch.nodes, kernel) {
        return Err(FitError::Away);
    }
    let model = model(problem, state, kernel.blur_px, scratch.window.origin);
    let sums = &mut scratch.sums;
    scratch.window.gather(scratch.level, &model, sums, known.is_none());
    let mut linear = match known {
        None => Linear::new(problem, state, (&sums.products, &model), radius_px),
        Some(known) => known.updated(&sums.products),
    };
    linear.together = patches::share(f64::from(sums.patches), linear.misfit);
    if linear.pixels < MIN_PIXELS { Err(FitError::Flat) } else { Ok(linear) }
}

/// What carrying the contour into the window needs of the scratch.
pub struct Parts<'a> {
    pub level: fearless_simd::Level,
    pub contours: &'a mut super::Contours,
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
    view::project(parts.level, at, contour, parts.window, parts.nodes);
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
    let plane = |v: Vector3<f64>| [v.z as f32, v.x as f32, v.y as f32];
    let lift = Vector3::new(n.x / s, n.y / s, n.z) * (problem.radius_m / p.z);
    Model {
        white: state.white as f32,
        step: state.step as f32,
        blur: (0.5 * (state.blur2 - table_px * table_px)) as f32,
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

impl Linear {
    pub fn new(
        problem: &Problem,
        state: &State,
        (products, model): (&Products, &Model),
        radius_px: f64,
    ) -> Self {
        let mut scale = [1.0; MOST];
        scale[BLUR] = 0.5 * state.step;
        scale[SHIFT..UNKNOWNS].fill(state.step);
        let mut information = [[0.0; MOST]; MOST];
        let (mut gradient, mut mirror) = ([0.0; MOST], [0.0; MOST]);
        let step = state.step;
        for i in 0..UNKNOWNS {
            for j in 0..UNKNOWNS {
                information[i][j] = products[(i + 1, j + 1)] * scale[i] * scale[j];
            }
            gradient[i] = products[(0, i + 1)] * scale[i];
            mirror[i] = products[(i + 1, MIRROR)] * scale[i] * step;
        }
        // A straight edge of deviation τ tells its place by C²/(2 √π τ) a pixel's length.
        let spread_px = (state.blur2 + 1.0 / 12.0).sqrt();
        let edge = state.step * state.step / (2.0 * std::f64::consts::PI.sqrt() * spread_px);
        let ratio = problem.kind.mean_ratio();
        let around = std::f64::consts::TAU * edge * radius_px;
        Self {
            edges: around * (1.0 + ratio),
            radius_px,
            information,
            scale,
            gradient,
            misfit: products[(0, 0)],
            mirror: (
                mirror,
                products[(0, MIRROR)] * step,
                products[(MIRROR, MIRROR)] * step * step,
            ),
            apart_px: 2.0 * radius_px * model.nearness[1].hypot(model.nearness[2]) as f64,
            pixels: products[(column::WHITE, column::WHITE)],
            together: 1.0,
            reused: false,
            elongation: around * radius_px * (1.0 + ratio * ratio),
            unit_m: state.place.position_m.z * problem.lens.spread,
        }
    }

    /// The same information, with the residual's products of another state near by.
    fn updated(&self, products: &Products) -> Self {
        let mut next = self.clone();
        for i in 0..UNKNOWNS {
            next.gradient[i] = products[(0, i + 1)] * self.scale[i];
        }
        next.misfit = products[(0, 0)];
        next.mirror.1 = products[(0, MIRROR)] * self.scale[SHIFT];
        next.reused = true;
        next
    }

    /// Whether the problem is as good as linear over a change, and its residual all noise already.
    fn holds_over(&self, state: &State, change: &[f64; MOST]) -> bool {
        let shape = SHIFT..UNKNOWNS;
        let moved: f64 = shape
            .clone()
            .map(|i| {
                change[i] * shape.clone().map(|j| self.information[i][j] * change[j]).sum::<f64>()
            })
            .sum();
        let turn2 = change[TILT].powi(2) + change[TILT + 1].powi(2);
        moved < (LAST_MOVE * self.noise2()).min(LAST_MOVE_PX * LAST_MOVE_PX * self.edges)
            && 0.5 * turn2 * self.radius_px < LAST_BEND_PX
            && change[BLUR].abs() < LAST_BLUR_PX * self.radius_px
            && self.is_even()
            && state.is_turned_little(change)
    }

    /// Whether noise explains the residual.
    pub fn is_even(&self) -> bool {
        self.together < 1.0 + EVEN / self.pixels.sqrt()
    }

    /// Carries what depends on the residual over a change that leaves this misfit.
    fn carry(&mut self, change: &[f64; MOST], misfit: f64) {
        for (gradient, row) in self.gradient.iter_mut().zip(&self.information) {
            *gradient -= row.iter().zip(change).map(|(a, b)| a * b).sum::<f64>();
        }
        self.mirror.1 -= self.mirror.0.iter().zip(change).map(|(a, b)| a * b).sum::<f64>();
        self.misfit = misfit;
    }

    /// Holds an unknown where it is.
    pub fn hold(&mut self, unknown: usize) {
        for other in 0..UNKNOWNS {
            self.information[unknown][other] = 0.0;
            self.information[other][unknown] = 0.0;
        }
        self.information[unknown][unknown] = 1.0;
        self.gradient[unknown] = 0.0;
        self.mirror.0[unknown] = 0.0;
    }

    /// Whether an unknown is held: the level of black hangs together with all others.
    pub fn holds(&self, unknown: usize) -> bool {
        self.information[unknown][STEP] == 0.0
    }

    pub fn noise2(&self) -> f64 {
        self.noise2_of(self.misfit)
    }

    /// Variance of a pixel for a sum of squares; never below that of rounding.
    fn noise2_of(&self, misfit: f64) -> f64 {
        (misfit / (self.pixels - UNKNOWNS as f64).max(1.0)).max(1.0 / 12.0)
    }

    /// Information and gradient with what is known beforehand.
    pub fn with_prior(&self, state: &State, noise2: f64) -> ([[f64; MOST]; MOST], [f64; MOST]) {
        let (mut information, mut gradient) = (self.information, self.gradient);
        let prior = noise2 / (LIGHT_PRIOR * LIGHT_PRIOR);
        for axis in 0..2 {
            information[LIGHT + axis][LIGHT + axis] += prior;
            gradient[LIGHT + axis] -= prior * state.light[axis];
        }
        (information, gradient)
    }

    /// The factor of the information for a step, and the gradient.
    pub fn factor(
        &self,
        state: &State,
        noise2: f64,
        damping: f64,
    ) -> Option<(Factor, [f64; MOST])> {
        let (mut information, gradient) = self.with_prior(state, noise2);
        let curvature = self.tilt_curvature(state, noise2);
        for axis in 0..2 {
            information[TILT + axis][TILT + axis] += curvature;
        }
        for (i, row) in information.iter_mut().enumerate().take(UNKNOWNS) {
            row[i] *= 1.0 + damping;
        }
        Some((Factor::new(&information, UNKNOWNS)?, gradient))
    }

    /// A step, damped or not.
    pub fn step(&self, state: &State, noise2: f64, damping: f64) -> Option<[f64; MOST]> {
        let (factor, gradient) = self.factor(state, noise2, damping)?;
        Some(factor.solve(&gradient))
    }

    /// Information, over that of one grey level, about the tilt about either axis.
    pub fn tilt_information(&self, state: &State) -> f64 {
        let place = &state.place;
        let cosine = place.axes.column(2).dot(&place.position_m.normalize());
        self.elongation * (1.0 - cosine * cosine) / 8.0
    }

    /// What the curvature of the elongation adds to the tilt's information.
    fn tilt_curvature(&self, state: &State, noise2: f64) -> f64 {
        let (least, elongation) = (self.tilt_information(state) / noise2, self.elongation / noise2);
        let variance = 2.0 / ((least * least + elongation).sqrt() + least);
        0.25 * variance * elongation * noise2
    }
}
