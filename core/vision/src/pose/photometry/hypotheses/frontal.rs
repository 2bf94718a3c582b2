//! A roundel that nearly faces the camera, from grey levels: the posterior of
//! [`tilt_posterior`](crate::pose::circle) on photometric information.
//!
//! With the lean w (the normal's component across the line of sight, a complex number) and ρ = ln d + ¼
//! |w|², which the sizes of the rims give, the image depends on w through the elongation,
//! squared, and through perspective, linearly: its derivative by w at constant ρ is 2 w Jₑ + Jₗ.
//! The residual is projected at two leans, w₀ and -w₀; w₀ is that of the solution, or one standard
//! deviation from upright if that is larger. With all other unknowns θ eliminated (Schur's
//! complement) their gradients are
//!
//! g± = ±2 w̄₀ Iₑ (ê - w₀²) + Λ (ŵ ∓ w₀),
//!
//! so half their sum gives ŵ and half their difference ê. Both rims have the same information about
//! a shift across themselves: since ln d moves a rim by 1 where w² moves it by ¼ cos 2t, Iₑ is 1/32
//! of the information about ln d, and with the rims' ratio q and r = R/d
//!
//! Λ/Iₑ = 16 r² q (1 - q²)²/((1 + q)(1 + q³)).
//!
//! The solution for θ, which includes the range, is the step halfway between both, less its
//! dependence on w.

use nalgebra::{Matrix2, Matrix3, SMatrix, Vector2, Vector3};

use crate::pose::{
    circle::tilt_posterior::{self, Evidence, Lean},
    frame_along,
    photometry::{
        model::{ModelScratch, projection::PrintPose},
        solver::{
            cholesky::{Cholesky, UNKNOWNS, Unknowns},
            linearize,
            solution::{Covariance5, Solution},
            state::{BLUR, MOTION, Problem, RANGE, SHIFT, STEP, State, TILT, WHITE},
        },
    },
};

#[expect(clippy::large_enum_variant, reason = "it lives for a call, and a box would be allocated")]
pub enum FrontalResult {
    /// Tilted enough for Gauss-Newton.
    Tilted,
    /// The same, but the solution has not converged; it will from this state.
    Further(State),
    /// The more likely lean, the other one if there are two, and the likelihood of the first.
    Facing(FrontalPose, Option<FrontalPose>, f64),
}

/// A state that faces the camera, with covariance.
pub struct FrontalPose {
    pub state: State,
    /// Over shift, logarithm of the range, and rotations.
    pub covariance: Covariance5,
    /// Axes of the rotations.
    pub turns: [Vector3<f64>; 2],
}

/// Minimum of |w₀|², in standard deviations of the squared lean.
const PROBE: f64 = 2.0;
/// Information about the logarithm of the range over that about w².
const RANGE_OVER_SQUARED: f64 = 32.0;

/// Posterior of the lean where the solution nearly faces the camera.
pub fn estimate(
    problem: &Problem,
    solution: &Solution,
    scratch: &mut ModelScratch,
) -> FrontalResult {
    let state = &solution.state;
    let noise2 = solution.noise2;
    let frame = frame_along(&state.pose.position_m);
    let share = linear_over_squared(problem, state);
    let lean = lean_of(state, &frame);
    let squared_information = solution.equations.information[(RANGE, RANGE)] / RANGE_OVER_SQUARED;
    let linear_information = share * squared_information;
    let sigma = (noise2 / squared_information).sqrt();
    let applies =
        |squared: f64| tilt_posterior::applies(squared, sigma, linear_information / noise2);
    if !applies(lean.norm_squared()) {
        return FrontalResult::Tilted;
    }
    let probe = if lean.norm_squared() < PROBE * sigma {
        lean.try_normalize(1e-9).unwrap_or(Vector2::x()) * (PROBE * sigma).sqrt()
    } else {
        lean
    };
    let mut at = |lean: Vector2<f64>| Marginal::at(problem, solution, &frame, &lean, scratch);
    let (Some(plus), Some(minus)) = (at(probe), at(-probe)) else {
        return FrontalResult::Tilted;
    };
    let middle = Marginal::mean(&plus, &minus);
    let pull = (plus.gradient - minus.gradient) * 0.5 + probe * linear_information;
    // Division by the conjugate of w₀ is multiplication by w₀ over its square.
    let away = times(&probe) * pull / (2.0 * squared_information * probe.norm_squared());
    let evidence = Evidence {
        squared: times(&probe) * probe + away,
        squared_sigma: sigma,
        linear: middle.gradient / linear_information,
        linear_information: linear_information / noise2,
    };
    if !applies(evidence.squared.norm()) {
        let root = tilt_posterior::half_angle(&evidence.squared, evidence.squared.norm())
            * evidence.squared.norm().sqrt();
        let root = if root.dot(&evidence.linear) < 0.0 { -root } else { root };
        return match leaned(state, &frame, &root) {
            further if root.norm_squared() > 1.2 * lean.norm_squared() => {
                FrontalResult::Further(further)
            }
            _ => FrontalResult::Tilted,
        };
    }
    let leans = tilt_posterior::leans(&evidence);
    let make = |lean: &Lean| middle.at_lean(solution, &frame, lean);
    let other = leans.other.map(|lean| make(&lean));
    FrontalResult::Facing(make(&leans.first), other, leans.likelihood)
}

/// Λ/Iₑ of the module page.
fn linear_over_squared(problem: &Problem, state: &State) -> f64 {
    let (q, r) = (problem.disc_ratio(), problem.radius_m / state.pose.position_m.norm());
    16.0 * r * r * q * (1.0 - q * q).powi(2) / ((1.0 + q) * (1.0 + q * q * q))
}

/// Multiplication by a complex number, as a matrix.
fn times(by: &Vector2<f64>) -> Matrix2<f64> {
    Matrix2::new(by.x, -by.y, by.y, by.x)
}

fn lean_of(state: &State, frame: &Matrix3<f64>) -> Vector2<f64> {
    (frame * state.pose.axes.column(2)).xy()
}

fn normal_of(lean: &Vector2<f64>, frame: &Matrix3<f64>) -> Vector3<f64> {
    let facing = (1.0 - lean.norm_squared()).max(0.0).sqrt();
    frame.transpose() * lean.push(-facing)
}

/// The state with another lean, and with the range that keeps its size.
fn leaned(state: &State, frame: &Matrix3<f64>, lean: &Vector2<f64>) -> State {
    let before = lean_of(state, frame).norm_squared();
    let further = 0.25 * (before - lean.norm_squared());
    let pose = PrintPose {
        position_m: state.pose.position_m * further.exp(),
        axes: state.pose.axes_with_normal(&normal_of(lean, frame)),
    };
    State { pose, ..state.clone() }
}

const OTHERS: usize = TILT;

/// The linear problem at one lean with all other unknowns eliminated.
struct Marginal {
    /// g, over the information of one grey level.
    gradient: Vector2<f64>,
    /// Step of the other unknowns with the lean held …
    step: Unknowns,
    /// … and their derivatives by the components of w.
    follow: SMatrix<f64, UNKNOWNS, 2>,
    /// Inverse information about shift and range with the lean held.
    shift_and_range: Matrix3<f64>,
}

impl Marginal {
    fn at(
        problem: &Problem,
        solution: &Solution,
        frame: &Matrix3<f64>,
        lean: &Vector2<f64>,
        scratch: &mut ModelScratch,
    ) -> Option<Self> {
        let state = leaned(&solution.state, frame, lean);
        let mut equations = linearize::linearize(problem, &state, None, scratch).ok()?;
        if state.blur_at_limit(equations.gradient[BLUR]) {
            equations.hold(BLUR);
        }
        let (information, gradient) = equations.with_prior(&state, solution.noise2);
        // A rotation τ about the axes a and b changes the lean by M τ.
        let [a, b] = [0, 1].map(|axis| (frame * state.pose.axes.column(axis)).xy());
        let turns = Matrix2::from_columns(&[-b, a]).try_inverse()?;
        let by_lean = |row: &Unknowns| {
            let t = Vector2::new(row[TILT], row[TILT + 1]);
            turns.transpose() * t - lean * (0.5 * row[RANGE])
        };
        let mut tilts = SMatrix::<f64, UNKNOWNS, 2>::zeros();
        for other in 0..OTHERS {
            let of_tilts = by_lean(&information.column(other).into_owned());
            tilts.set_row(other, &of_tilts.transpose());
        }
        let others = Cholesky::new(&information, equations.free_unknowns().start..OTHERS)?;
        let step = others.solve(&gradient);
        let follow = [0, 1].map(|component| others.solve(&tilts.column(component).into_owned()));
        Some(Self {
            gradient: by_lean(&gradient) - tilts.transpose() * step,
            step,
            follow: SMatrix::from_columns(&follow),
            // Shift and range are the last of the others.
            shift_and_range: others.inverse_of_last(),
        })
    }

    /// Mean of both probes.
    fn mean(one: &Self, other: &Self) -> Self {
        Self {
            gradient: (one.gradient + other.gradient) * 0.5,
            step: (one.step + other.step) * 0.5,
            follow: (one.follow + other.follow) * 0.5,
            shift_and_range: (one.shift_and_range + other.shift_and_range) * 0.5,
        }
    }

    /// The solution moved to one lean of the posterior.
    fn at_lean(&self, solution: &Solution, frame: &Matrix3<f64>, lean: &Lean) -> FrontalPose {
        let change = self.step - self.follow * lean.mean;
        let mut state = solution.state.clone();
        state.white += change[WHITE];
        state.step += change[STEP];
        state.change_blur(change[BLUR], Vector2::new(change[MOTION], change[MOTION + 1]));
        let before = lean_of(&state, frame).norm_squared();
        let normal = normal_of(&lean.mean, frame);
        let pose = &mut state.pose;
        pose.position_m *= (change[RANGE] + 0.25 * (before - lean.squared)).exp();
        pose.position_m +=
            Vector3::new(change[SHIFT], change[SHIFT + 1], 0.0) * solution.equations.ring.unit_m;
        pose.axes = pose.axes_with_normal(&normal);
        let facing = (1.0 - lean.mean.norm_squared()).max(0.0).sqrt();
        let turns = [Vector2::x(), Vector2::y()].map(|along| {
            let change = along.push(lean.mean.dot(&along) / facing);
            normal.cross(&(frame.transpose() * change))
        });
        let follow = -self.follow.fixed_rows::<3>(SHIFT);
        let covariance = lean.joint_covariance(&(self.shift_and_range * solution.noise2), &follow);
        FrontalPose { state, covariance, turns }
    }
}
