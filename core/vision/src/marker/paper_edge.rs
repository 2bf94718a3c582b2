//! The outer rim where the paper ends close to it.
//!
//! A white margin that is hardly wider than the blur never reaches the level of white, and the paper's edge reaches into
//! the rim. So both edges are fitted together. Across the rim, in sectors of its ellipse, the level at the distance x is
//!
//! B + (W - B) Φ((x - δ)/σ) + D Φ((x - δ - m)/σ),
//!
//! with the rim off by δ, a margin of width m, and a step of D to what is behind the paper. In each sector δ, m, D and
//! deviations of B and W are unknown; the blur σ is common. Priors hold what a sector does not determine. Paper may have
//! any shape, since each sector has its own margin. The ellipse follows δ by its five harmonics, as in
//! [`super::coded::outer_rim`].
//!
//! Input: a frame, the outer rim to about a pixel, levels of black and white. Output: [`PaperEdge`].

use nalgebra::{SMatrix, SVector};

use crate::{
    camera::PixelPoint,
    ellipse::Ellipse,
    frame::Frame,
    marker::{Polarity, Ring},
    normal_distribution::{cumulative, normal_each},
};

const SECTORS: usize = 12;
/// Rays whose levels are averaged in a sector.
const RAYS: usize = 4;
/// Samples on a ray, their distance, and the first one's from the rim, pixels.
const SAMPLES: usize = 16;
const STEP_PX: f64 = 0.5;
const FIRST_PX: f64 = -2.5;
/// Samples of a margin's width at the start: this many steps from two steps on.
const WIDTHS: usize = 9;
/// Gauss-Newton steps.
const TURNS: usize = 5;
/// Deviation of a sector's levels from the model, as a share of the contrast.
const ERROR: f64 = 0.02;
/// Deviations of the priors: δ and m, pixels; D, B and W, as shares of the contrast.
const PRIORS: [f64; UNKNOWNS] = [1.0, 1.5, 0.5, 0.03, 0.03];
/// Variance that interpolation adds.
const INTERPOLATION_PX2: f64 = 1.0 / 6.0;
/// The fitted edge is subtracted up to this much before it, in blurs.
const CLEAR: f64 = 0.5;
/// Range of σ, with pixels and interpolation, and its start, pixels.
const BLURS_PX: (f64, f64) = (0.5, 3.0);
const FIRST_BLUR_PX: f64 = 0.9;
/// A rim that is farther off, pixels, is another one.
const MAX_MOVED_PX: f64 = 2.5;
/// A sector with a larger residual, as a share of the contrast, does not count; this many may be missing.
const MAX_RESIDUAL: f64 = 0.08;
const MAX_MISSING: usize = 4;
/// Error of each harmonic that remains, pixels.
const ERROR_PX: f64 = 0.01;

/// δ, m, D and the deviations of B and W.
const UNKNOWNS: usize = 5;
type Unknowns = SVector<f64, UNKNOWNS>;

/// The outer rim and the edge of the paper around it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PaperEdge {
    /// The outer rim.
    pub outer: Ellipse,
    /// Error of each harmonic of the outer rim, pixels.
    pub error_px: f64,
    /// Blur, with that of pixels and interpolation, pixels.
    pub blur_px: f64,
    /// Width of the margin, pixels, and step beyond it, grey levels, by sector.
    margins: [(f64, f64); SECTORS],
}

/// Mean levels across the rim in one sector, as shares of the contrast above black.
type Profile = [f64; SAMPLES];

/// A sector's unknowns.
#[derive(Clone, Copy, Debug)]
struct Sector {
    profile: Profile,
    unknowns: Unknowns,
    /// Where the prior holds them.
    expected: Unknowns,
    /// Half the rim's curvature.
    bend_per_px: f64,
    height_px: f64,
    /// Rms, as a share of the contrast.
    residual: f64,
}

/// Fits both edges; `None` if the levels do not look like them.
pub(crate) fn fit(
    frame: &Frame,
    outer: &Ellipse,
    [black, white]: [f64; 2],
    polarity: Polarity,
) -> Option<PaperEdge> {
    let inverted = polarity == Polarity::WhiteRing;
    let mut sectors = sectors(frame, outer, [black, white], inverted);
    let mut blur_px = FIRST_BLUR_PX;
    for sector in &mut sectors {
        sector.start(blur_px);
    }
    for _ in 0..TURNS {
        blur_px = descend(&mut sectors, blur_px)?;
    }
    for sector in &mut sectors {
        sector.residual = sector.rms(blur_px);
    }
    let counts = |sector: &Sector| sector.residual <= MAX_RESIDUAL && sector.unknowns[0].abs() < MAX_MOVED_PX;
    let missing = sectors.iter().filter(|sector| !counts(sector)).count();
    if missing > MAX_MISSING {
        return None;
    }
    let (harmonics, rest_px) = harmonics(&sectors, &counts, blur_px)?;
    let outer = outer.deformed(harmonics)?;
    let margin = |sector: &Sector| (sector.unknowns[1], sector.unknowns[2] * (white - black));
    Some(PaperEdge {
        outer,
        error_px: ERROR_PX.hypot(rest_px * (2.0 / SECTORS as f64).sqrt()),
        blur_px,
        margins: sectors.each_ref().map(margin),
    })
}

impl PaperEdge {
    /// The edge of the paper around a measured ring.
    pub fn around(frame: &Frame, ring: &Ring) -> Option<Self> {
        let Ring { outer, black, white, polarity, .. } = ring;
        match polarity {
            Polarity::BlackRing => fit(frame, outer, [*black, *white], *polarity),
            Polarity::WhiteRing => {
                let mut edge = fit(frame, outer, [255.0 - white, 255.0 - black], *polarity)?;
                edge.margins.iter_mut().for_each(|margin| margin.1 = -margin.1);
                Some(edge)
            }
        }
    }

    /// What the paper's edge adds to the level of a pixel.
    pub fn step_at(&self, at: &PixelPoint) -> f64 {
        let blur_px = (self.blur_px * self.blur_px - INTERPOLATION_PX2).sqrt();
        let outer = &self.outer;
        let (sin, cos) = outer.angle_rad.sin_cos();
        let (du, dv) = (at.u - outer.center.u, at.v - outer.center.v);
        let (x, y) = (
            (du * cos + dv * sin) / outer.semi_major_px,
            (dv * cos - du * sin) / outer.semi_minor_px,
        );
        let radius = x.hypot(y);
        let (cos, sin) = (x / radius, y / radius);
        let height_px = 1.0 / (cos / outer.semi_major_px).hypot(sin / outer.semi_minor_px);
        let away_px = (radius - 1.0) * height_px;
        let turns = sin.atan2(cos) / std::f64::consts::TAU;
        let place = turns.rem_euclid(1.0) * SECTORS as f64 - 0.5;
        let first = place.floor();
        let share = place - first;
        let of = |sector: f64| {
            let (margin_px, step) = self.margins[sector.rem_euclid(SECTORS as f64) as usize % SECTORS];
            step * cumulative((away_px - margin_px) / blur_px)
        };
        of(first) * (1.0 - share) + of(first + 1.0) * share
    }

    /// Distance from the rim up to which the level is known despite the paper's edge, pixels.
    pub fn clear_px(&self) -> f64 {
        let narrowest_px = self.margins.iter().map(|margin| margin.0).fold(f64::INFINITY, f64::min);
        narrowest_px - CLEAR * self.blur_px
    }
}

fn sectors(
    frame: &Frame,
    outer: &Ellipse,
    [black, white]: [f64; 2],
    inverted: bool,
) -> [Sector; SECTORS] {
    let (sin, cos) = outer.angle_rad.sin_cos();
    let (a, b) = (outer.semi_major_px, outer.semi_minor_px);
    let to_share = 1.0 / (white - black);
    std::array::from_fn(|sector| {
        let mut profile = [0.0; SAMPLES];
        let (mut bend_per_px, mut height_px) = (0.0, 0.0);
        for ray in 0..RAYS {
            let turns = (ray as f64 + 0.5) / RAYS as f64;
            let t = std::f64::consts::TAU * (sector as f64 + turns) / SECTORS as f64;
            let (y, x) = t.sin_cos();
            let height = 1.0 / (x / a).hypot(y / b);
            let (n_along, n_across) = (x / a * height, y / b * height);
            for (sample, level) in profile.iter_mut().enumerate() {
                let out_px = FIRST_PX + STEP_PX * sample as f64;
                let (along, across) = (a * x + out_px * n_along, b * y + out_px * n_across);
                let u = outer.center.u + along * cos - across * sin;
                let v = outer.center.v + along * sin + across * cos;
                let grey = frame.level_at(u, v);
                let grey = if inverted { 255.0 - grey } else { grey };
                *level += (grey - black) * to_share / RAYS as f64;
            }
            bend_per_px += 0.5 * height.powi(3) / (a * b).powi(2) / RAYS as f64;
            height_px += height / RAYS as f64;
        }
        Sector {
            profile,
            unknowns: Unknowns::zeros(),
            expected: Unknowns::zeros(),
            bend_per_px,
            height_px,
            residual: 0.0,
        }
    })
}

fn out_px(sample: usize) -> f64 {
    FIRST_PX + STEP_PX * sample as f64
}

impl Sector {
    /// The margin that leaves the least residual, of [`WIDTHS`].
    fn start(&mut self, blur_px: f64) {
        let rest = std::array::from_fn::<f64, SAMPLES, _>(|sample| {
            self.profile[sample] - cumulative(out_px(sample) / blur_px)
        });
        let mut best = (f64::INFINITY, 0.0, 0.0);
        for width in 0..WIDTHS {
            let margin_px = STEP_PX * (2 + width) as f64;
            let (mut product, mut square, mut total) = (0.0, 0.0, 0.0);
            for (sample, rest) in rest.iter().enumerate() {
                let share = cumulative((out_px(sample) - margin_px) / blur_px);
                product += rest * share;
                square += share * share;
                total += rest * rest;
            }
            let step = product / (square + 1e-3);
            let left = total - step * product;
            if left < best.0 {
                best = (left, margin_px, step);
            }
        }
        self.expected = Unknowns::from([0.0, best.1, best.2, 0.0, 0.0]);
        self.unknowns = self.expected;
    }

    /// Residual at a sample, its derivatives by the unknowns, and by σ.
    fn linearized(&self, sample: usize, blur_px: f64) -> (f64, Unknowns, f64) {
        let [rim_px, margin_px, step, black, white] = self.unknowns.into();
        let away_px = out_px(sample) - rim_px;
        let per_blur = 1.0 / blur_px;
        let (z_rim, z_paper) = (away_px * per_blur, (away_px - margin_px) * per_blur);
        let normal = |z: f64| {
            let (density, share) = normal_each(z as f32);
            (f64::from(density), f64::from(share))
        };
        let ((d_rim, s_rim), (d_paper, s_paper)) = (normal(z_rim), normal(z_paper));
        let contrast = 1.0 + white - black;
        let level = black + contrast * s_rim + step * s_paper;
        let (rim_slope, paper_slope) = (contrast * d_rim * per_blur, step * d_paper * per_blur);
        let columns = [-rim_slope - paper_slope, -paper_slope, s_paper, 1.0 - s_rim, s_rim];
        let by_blur = -rim_slope * z_rim - paper_slope * z_paper;
        (self.profile[sample] - level, columns.into(), by_blur)
    }

    fn rms(&self, blur_px: f64) -> f64 {
        let square = |sample| self.linearized(sample, blur_px).0.powi(2);
        ((0..SAMPLES).map(square).sum::<f64>() / SAMPLES as f64).sqrt()
    }
}

/// One step of all sectors and of the blur, which is returned.
fn descend(sectors: &mut [Sector; SECTORS], blur_px: f64) -> Option<f64> {
    type Square = SMatrix<f64, UNKNOWNS, UNKNOWNS>;
    let weight = 1.0 / (ERROR * ERROR);
    let mut blocks = [(Unknowns::zeros(), Unknowns::zeros()); SECTORS];
    let (mut blur_square, mut blur_product) = (0.0, 0.0);
    for (sector, block) in sectors.iter().zip(&mut blocks) {
        let (mut square, mut product, mut cross) =
            (Square::zeros(), Unknowns::zeros(), Unknowns::zeros());
        let (mut own_square, mut own_product) = (0.0, 0.0);
        for sample in 0..SAMPLES {
            let (rest, columns, by_blur) = sector.linearized(sample, blur_px);
            square += weight * columns * columns.transpose();
            product += weight * rest * columns;
            cross += weight * by_blur * columns;
            own_square += weight * by_blur * by_blur;
            own_product += weight * by_blur * rest;
        }
        for (index, deviation) in PRIORS.iter().enumerate() {
            let per_variance = 1.0 / (deviation * deviation);
            square[(index, index)] += per_variance;
            product[index] += per_variance * (sector.expected[index] - sector.unknowns[index]);
        }
        let solver = square.cholesky()?;
        let (solved, crossed) = (solver.solve(&product), solver.solve(&cross));
        blur_square += own_square - cross.dot(&crossed);
        blur_product += own_product - cross.dot(&solved);
        *block = (solved, crossed);
    }
    let step_px = (blur_product / blur_square).clamp(-0.3, 0.3);
    let next_px = (blur_px + step_px).clamp(BLURS_PX.0, BLURS_PX.1);
    let step_px = next_px - blur_px;
    for (sector, (solved, crossed)) in sectors.iter_mut().zip(blocks) {
        let limit_px = 0.7;
        let change = solved - crossed * step_px;
        let scale = (limit_px / change[0].abs().max(change[1].abs())).min(1.0);
        sector.unknowns += change * scale;
        sector.unknowns[1] = sector.unknowns[1].max(0.3);
    }
    next_px.is_finite().then_some(next_px)
}

/// The five harmonics of the rim's displacement as shares of its size, and the rms of the rest, pixels.
fn harmonics(
    sectors: &[Sector; SECTORS],
    counts: &dyn Fn(&Sector) -> bool,
    blur_px: f64,
) -> Option<([f64; 5], f64)> {
    let mut square = SMatrix::<f64, 5, 5>::zeros();
    let mut product = SVector::<f64, 5>::zeros();
    let rows = sectors.iter().enumerate().filter(|(_, sector)| counts(sector)).map(|(index, sector)| {
        let t = std::f64::consts::TAU * (index as f64 + 0.5) / SECTORS as f64;
        // Blur moves the half level of a curved rim inwards.
        let moved_px = sector.unknowns[0] + sector.bend_per_px * blur_px * blur_px;
        let ((sin, cos), (sin2, cos2)) = (t.sin_cos(), (2.0 * t).sin_cos());
        let basis = SVector::from([1.0, SINGLE * cos, SINGLE * sin, DOUBLE * cos2, DOUBLE * sin2]);
        (basis, moved_px / sector.height_px, sector.height_px)
    });
    for (basis, share, height_px) in rows.clone() {
        let weight = height_px * height_px;
        square += weight * basis * basis.transpose();
        product += weight * share * basis;
    }
    let solved = square.cholesky()?.solve(&product);
    let mut rest = (0.0, 0.0);
    for (basis, share, height_px) in rows {
        rest.0 += ((share - basis.dot(&solved)) * height_px).powi(2);
        rest.1 += 1.0;
    }
    Some((solved.into(), (rest.0 / (rest.1 - 5.0_f64).max(1.0)).sqrt()))
}

/// Means of the first two harmonics over a sector's four rays.
const SINGLE: f64 = 0.989_3;
const DOUBLE: f64 = 0.957_7;
