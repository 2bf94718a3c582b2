//! Posterior of the tilt of a roundel that nearly faces the camera.
//!
//! The image of a circle contains the lean w (the normal's component across the line of sight, here
//! a complex number) squared in its elongation, and linearly only in the distance between the
//! centres of its rims, by perspective, with the square of the roundel's angular size as a factor.
//! The rims measure
//!
//! ê = w² + N(0, σ²) in either component      ŵ = w + N(0, 1/Λ) in either component
//!
//! Face-on the derivative of w² vanishes, and with it the information of ê, and the maximum of the
//! likelihood is biased: |ê| is never zero, on average √(π/2) σ at zero tilt (Rayleigh). A circle
//! would always look tilted, its size would be taken for foreshortened, and its distance would come
//! out too small.
//!
//! Normals are uniform over the sphere, so the prior density of w is uniform (that of ê is then
//! 1/|ê|). With w = √σ e^{iφ/2} z, φ the angle of ê, s = |ê|/σ and λ = Λσ, the posterior is
//!
//! p(z) ∝ exp(-½ |z² - s|² - ½ λ |z - ẑ|²)
//!
//! For large s or λ it is one Gaussian or two, which a Gauss-Newton step finds ([`applies`] is
//! false). Otherwise its moments are sums over a grid, accurate to 1e-3. Its two halves are two
//! hypotheses where they are separate, and one broad normal where they are not.
//!
//! The size, and with it the depth, needs a mean of |w|². That of the posterior is biased: over
//! many images of one face-on roundel it averages 1.2 σ instead of zero. Used instead is the
//! function of the data whose mean over images is closest to |w|² at every tilt; it may be
//! negative: the posterior mean less a share that decays with s ([`BIAS_CORRECTION`]). The depth's
//! bias is then within a third of its rms everywhere (`tests::covariance_matches_the_errors`),
//! and the stated variance is about that value.

use nalgebra::{Matrix2, Matrix3, Matrix3x2, SMatrix, Vector2, Vector3};

use crate::simd::{Lane, Vec2};

/// Measurements of a lean; complex numbers as vectors.
#[derive(Clone, Copy, Debug)]
pub struct Evidence {
    /// ê, of w².
    pub squared: Vector2<f64>,
    /// σ of each component.
    pub squared_sigma: f64,
    /// ŵ, by perspective.
    pub linear: Vector2<f64>,
    /// Λ of each component.
    pub linear_information: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lean {
    pub mean: Vector2<f64>,
    pub covariance: Matrix2<f64>,
    /// |w|², unbiased over images.
    pub squared: f64,
    /// Variance of `squared`.
    pub squared_variance: f64,
    /// Covariance of `squared` with w.
    pub cross: Vector2<f64>,
}

impl Lean {
    /// Covariance of three numbers and the lean. `own` is that of the numbers with the lean held,
    /// `follow` their derivatives by it; the third one depends on -¼ |w|² as well.
    pub fn joint_covariance(
        &self,
        own: &Matrix3<f64>,
        follow: &Matrix3x2<f64>,
    ) -> SMatrix<f64, 5, 5> {
        let by_square = Vector3::new(0.0, 0.0, -0.25);
        let with_lean = follow * self.covariance + by_square * self.cross.transpose();
        let with_square = follow * self.cross * by_square.transpose();
        let numbers = own
            + follow * self.covariance * follow.transpose()
            + with_square
            + with_square.transpose()
            + by_square * by_square.transpose() * self.squared_variance;
        let mut covariance = SMatrix::<f64, 5, 5>::zeros();
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&numbers);
        covariance.fixed_view_mut::<3, 2>(0, 3).copy_from(&with_lean);
        covariance.fixed_view_mut::<2, 3>(3, 0).copy_from(&with_lean.transpose());
        covariance.fixed_view_mut::<2, 2>(3, 3).copy_from(&self.covariance);
        covariance
    }
}

/// One lean, or two hypotheses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leans {
    /// The more likely one.
    pub first: Lean,
    /// `None` where both form one broad normal.
    pub other: Option<Lean>,
    /// Likelihood of `first`, 0.5 to 1; 1 without another one.
    pub likelihood: f64,
}

/// Curvature 4 s + λ from which the posterior is Gaussian.
const GAUSSIAN_CURVATURE: f64 = 18.0;
/// Share subtracted from the mean of |z|² at s = λ = 0, squared decay length in s, and how λ
/// reduces the former and extends the latter.
const BIAS_CORRECTION: (f64, f64, f64) = (1.8, 2.2, 0.45);
/// Squared distance of two leans, in their joint standard deviations, from which they are separate
/// hypotheses.
const SEPARATION: f64 = 16.0;
/// A half with a smaller share of the weight is no hypothesis.
const NEGLIGIBLE: f64 = 1e-4;
/// Grid of z: columns, rows and their distance.
const COLUMNS: usize = 16;
const ROWS: usize = 12;
const STEP: f64 = 0.4;

/// Where the posterior is not Gaussian; `squared` is |ê|.
#[inline(always)]
pub fn applies<T: Lane>(squared: T, squared_sigma: T, linear_information: T) -> T::Mask {
    let curvature = squared * 4.0 + linear_information * squared_sigma * squared_sigma;
    curvature.below(squared_sigma * GAUSSIAN_CURVATURE)
}

/// Sums over one half of the grid.
#[derive(Clone, Copy, Debug, Default)]
struct Half {
    weight: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
    /// Sums of |z|² x, |z|² y and, below, |z|⁴.
    cubic: (f64, f64),
    quartic: f64,
}

/// Moments of the posterior.
#[inline(always)]
pub fn leans(evidence: &Evidence) -> Leans {
    let Evidence { squared, squared_sigma, linear, linear_information } = *evidence;
    let root = squared_sigma.sqrt();
    let length = squared.norm_squared().sqrt();
    let s = length / squared_sigma;
    let lambda = linear_information * squared_sigma;
    let along = half_angle(&squared, length);
    // Multiplication by e^{-iφ/2}.
    let turned =
        Vector2::new(along.dot(&linear), along.x * linear.y - along.y * linear.x) * (1.0 / root);
    let [left, right] = integrate(s, lambda, &turned);
    let bias = {
        let (share, decay, damping) = BIAS_CORRECTION;
        let width = 1.0 + damping * lambda;
        share / width * (-s * s / (decay * width)).exp()
    };
    let lean = |half: &Half| half.lean(bias, root, &along);
    let spread = |half: &Half| {
        let (mean, c) = half.moments();
        LeanSpread { mean: Vec2::new(mean.x, mean.y), covariance: [c.m11, c.m12, c.m22] }
    };
    let are_two = are_distinct(&spread(&left), &spread(&right));
    let smaller = left.weight.min(right.weight);
    if !are_two || smaller < NEGLIGIBLE * (left.weight + right.weight) {
        return Leans { first: lean(&left.plus(&right)), other: None, likelihood: 1.0 };
    }
    let (first, other) = if left.weight > right.weight { (left, right) } else { (right, left) };
    let likelihood = first.weight / (first.weight + other.weight);
    Leans { first: lean(&first), other: Some(lean(&other)), likelihood }
}

/// Mean of a lean, and 11, 12 and 22 of its covariance.
#[derive(Clone, Copy)]
pub struct LeanSpread<T> {
    pub mean: Vec2<T>,
    pub covariance: [T; 3],
}

/// Where two leans are two hypotheses and not a broad one.
#[inline(always)]
pub fn are_distinct<T: Lane>(one: &LeanSpread<T>, other: &LeanSpread<T>) -> T::Mask {
    let apart = one.mean - other.mean;
    let [a11, a12, a22] = one.covariance;
    let [b11, b12, b22] = other.covariance;
    let (s11, s12, s22) = (a11 + b11, a12 + b12, a22 + b22);
    let across = s22 * apart.x * apart.x - s12 * apart.x * apart.y * 2.0 + s11 * apart.y * apart.y;
    ((s11 * s22 - s12 * s12) * SEPARATION).below(across)
}

/// Sums of the posterior over the left and the right half of the grid.
#[inline(always)]
fn integrate(s: f64, lambda: f64, at: &Vector2<f64>) -> [Half; 2] {
    let place = |k: usize, count: usize| (k as f64 - 0.5 * (count as f64 - 1.0)) * STEP;
    let mut exponents = [[0.0; COLUMNS]; ROWS];
    let mut max_exponent = f64::NEG_INFINITY;
    for (row, exponents) in exponents.iter_mut().enumerate() {
        let y = place(row, ROWS);
        for (column, exponent) in exponents.iter_mut().enumerate() {
            let x = place(column, COLUMNS);
            let (real, imaginary) = (x * x - y * y - s, 2.0 * x * y);
            let (dx, dy) = (x - at.x, y - at.y);
            *exponent = -0.5 * (real * real + imaginary * imaginary + lambda * (dx * dx + dy * dy));
            max_exponent = if *exponent > max_exponent { *exponent } else { max_exponent };
        }
    }
    let mut halves = [Half::default(); 2];
    for (row, exponents) in exponents.iter().enumerate() {
        let y = place(row, ROWS);
        for (side, half) in halves.iter_mut().enumerate() {
            for column in 0..COLUMNS / 2 {
                let column = side * (COLUMNS / 2) + column;
                let x = place(column, COLUMNS);
                let w = fast_exp(exponents[column] - max_exponent);
                let square = x * x + y * y;
                half.weight += w;
                half.x += w * x;
                half.y += w * y;
                half.xx += w * x * x;
                half.xy += w * x * y;
                half.yy += w * y * y;
                half.cubic.0 += w * square * x;
                half.cubic.1 += w * square * y;
                half.quartic += w * square * square;
            }
        }
    }
    halves
}

/// eˣ for x ≤ 0 as (1 + x/2¹⁰)^(2¹⁰), which compiles to vector multiplications; relative error
/// x²/2¹¹.
#[inline(always)]
fn fast_exp(x: f64) -> f64 {
    let mut value = (1.0 + x * (1.0 / 1024.0)).max(0.0);
    for _ in 0..10 {
        value *= value;
    }
    value
}

/// e^{iφ/2} of a complex number with angle φ; 1 for zero.
#[inline(always)]
pub fn half_angle(of: &Vector2<f64>, length: f64) -> Vector2<f64> {
    if length <= 0.0 {
        return Vector2::new(1.0, 0.0);
    }
    let cos = of.x / length;
    if cos >= 0.0 {
        let real = (0.5 * (1.0 + cos)).sqrt();
        Vector2::new(real, 0.5 * of.y / (length * real))
    } else {
        let imaginary = (0.5 * (1.0 - cos)).sqrt();
        Vector2::new(0.5 * of.y / (length * imaginary), imaginary)
    }
}

impl Half {
    fn plus(&self, other: &Half) -> Half {
        Half {
            weight: self.weight + other.weight,
            x: self.x + other.x,
            y: self.y + other.y,
            xx: self.xx + other.xx,
            xy: self.xy + other.xy,
            yy: self.yy + other.yy,
            cubic: (self.cubic.0 + other.cubic.0, self.cubic.1 + other.cubic.1),
            quartic: self.quartic + other.quartic,
        }
    }

    /// Mean and covariance of z.
    fn moments(&self) -> (Vector2<f64>, Matrix2<f64>) {
        let per_weight = 1.0 / self.weight.max(f64::MIN_POSITIVE);
        let mean = Vector2::new(self.x, self.y) * per_weight;
        let square = Matrix2::new(self.xx, self.xy, self.xy, self.yy) * per_weight;
        (mean, square - mean * mean.transpose())
    }

    fn lean(&self, bias: f64, root: f64, along: &Vector2<f64>) -> Lean {
        let (mean, covariance) = self.moments();
        let per_weight = 1.0 / self.weight.max(f64::MIN_POSITIVE);
        let square = (self.xx + self.yy) * per_weight;
        let cross = Vector2::new(self.cubic.0, self.cubic.1) * per_weight - mean * square;
        let variance = self.quartic * per_weight - square * square + bias * bias;
        let turn = Matrix2::new(along.x, -along.y, along.y, along.x) * root;
        Lean {
            mean: turn * mean,
            covariance: turn * covariance * turn.transpose(),
            squared: (square - bias) * root * root,
            squared_variance: variance * root.powi(4),
            cross: turn * cross * (root * root),
        }
    }
}
