//! The outer rim where the paper ends close to it.
//!
//! A white margin that is hardly wider than the blur never reaches the level of white, and the paper's edge reaches into
//! the rim. So both edges are fitted together. Across the rim, in sectors of its ellipse, the level at the distance x is
//!
//! B + (W - B) [Φ((x - δ)/σ) + s Φ(-(x + b)/σ)] + D Φ((x - δ - m)/σ),
//!
//! with the rim off by δ, a black ring of width b whose disc is white to a share s, a margin of width m, and a step of D
//! to what is behind the paper. In each sector δ, m, D and deviations of B and W are unknown; the blur σ is common. Priors
//! hold what a sector does not determine. Where B and W deviate much, as in uneven light, a sector does not count. Paper may have
//! any shape, since each sector has its own margin. The ellipse follows δ by its five harmonics, as in
//! [`super::coded::outer_rim`].
//!
//! | module | content |
//! | --- | --- |
//! | `sector` | levels across the rim in one sector, and the steps of the fit |
//! | `added_light` | what the paper's edge adds to the level of any pixel |
//!
//! Input: a frame, the outer rim to about a pixel, levels of black and white. Output: [`PaperEdge`].

mod added_light;
mod sector;

use fearless_simd::{Level, Simd, dispatch};
use fearless_simd_macros::simd;
use nalgebra::{SMatrix, SVector};

use crate::{
    ellipse::Ellipse,
    frame::Frame,
    marker::{Polarity, Ring},
};
use sector::{ERROR, FIRST_BLUR_PX, Sector, descend};

/// Sectors of the rim.
const SECTORS: usize = 12;
/// Largest number of Gauss-Newton steps, and the change that ends them, pixels.
const TURNS: usize = 6;
const SETTLED_PX: f32 = 0.01;
/// The stated error follows the residuals, down to this share of their expected square.
const MIN_SCALE: f64 = 0.2;
/// The fitted edge is subtracted up to this much before it, in blurs.
const CLEAR: f64 = 0.5;
/// A rim that is farther off, pixels, is another one.
const MAX_MOVED_PX: f32 = 2.5;
/// A sector with a larger residual, as a share of the contrast, does not count; this many may be missing.
const MAX_RESIDUAL: f32 = 0.08;
const MAX_MISSING: usize = 4;
/// A sector in which black or white deviates by more does not count either.
const MAX_DEVIATION: f32 = 0.08;
/// A margin up to this width is narrow, pixels, if the step to what is behind has this share of the contrast, and this
/// many sectors have one.
const NEAR_PX: f32 = 3.5;
const MIN_STEP: f32 = 0.08;
const MIN_NEAR: usize = 3;
/// Error of each harmonic that remains, pixels.
const ERROR_PX: f64 = 0.01;
/// Its increase per blur by which the margin is narrower than this many, pixels: both edges then look like one. From
/// rendered rings.
const NARROW: (f64, f64) = (0.06, 2.0);
/// Means of the first two harmonics over a sector's four rays.
const SINGLE: f64 = 0.989_3;
const DOUBLE: f64 = 0.957_7;

/// White share of the rim of a coded disc; the rest is teeth.
pub(crate) const CODED_SHARE: f64 = 0.5;

/// Error of each harmonic of the outer rim with a washed-out margin, or one whose paper's edge is not found, pixels; from
/// rendered rings.
pub(crate) const NO_MARGIN_PX: f64 = 0.15;

/// The outer rim and the edge of the paper around it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PaperEdge {
    pub outer: Ellipse,
    /// Error of each harmonic of the outer rim, pixels.
    pub error_px: f64,
    /// Blur, with that of pixels and interpolation, pixels.
    pub blur_px: f64,
    margins: [Margin; SECTORS],
}

/// The margin in one sector.
#[derive(Clone, Copy, Debug)]
struct Margin {
    width_px: f64,
    /// Step of the level beyond it, grey levels.
    step: f64,
}

impl Margin {
    /// In a sector that does not count: the paper has no edge there.
    const NONE: Self = Self { width_px: f64::INFINITY, step: 0.0 };
}

/// A ring as measured without the paper's edge.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RoughRing {
    pub outer: Ellipse,
    /// Levels, inverted if a white ring is measured as a black one.
    pub black: f64,
    pub white: f64,
    pub polarity: Polarity,
    /// Size of the disc over that of the outer rim.
    pub disc_ratio: f64,
    /// White share of the disc's rim: 1, or [`CODED_SHARE`].
    pub disc_share: f64,
}

/// Fits both edges; `None` if the levels do not look like them, or the paper ends far from the rim.
pub(crate) fn fit(level: Level, frame: &Frame, ring: &RoughRing) -> Option<PaperEdge> {
    dispatch!(level, simd => fit_with(simd, frame, ring))
}

#[simd]
fn fit_with<S: Simd>(_simd: S, frame: &Frame, ring: &RoughRing) -> Option<PaperEdge> {
    let RoughRing { outer, black, white, .. } = ring;
    let mut sectors = std::array::from_fn(|index| Sector::new(frame, ring, index));
    let mut step = descend(&mut sectors, FIRST_BLUR_PX)?;
    for _ in 1..TURNS {
        if step.change_px < SETTLED_PX {
            break;
        }
        step = descend(&mut sectors, step.blur_px)?;
    }
    if sectors.iter().filter(|sector| !counts(sector)).count() > MAX_MISSING {
        return None;
    }
    let counted = || sectors.iter().enumerate().filter(|(_, sector)| counts(sector));
    if counted().filter(|(_, sector)| sector.ends_near()).count() < MIN_NEAR {
        return None;
    }
    let blur_px = f64::from(step.blur_px);
    let (harmonics, rest_px) = harmonics(counted(), blur_px)?;
    let outer = outer.deformed(harmonics)?;
    let square = counted().map(|(_, sector)| f64::from(sector.residual).powi(2)).sum::<f64>();
    let expected = counted().count() as f64 * f64::from(ERROR).powi(2);
    let scale = (square / expected).max(MIN_SCALE);
    let [own_px2, common_px2] = [step.own_px2, step.common_px2].map(|it| scale * f64::from(it));
    let own_px2 = own_px2.max(rest_px * rest_px) * 2.0 / SECTORS as f64;
    let width_px = counted().map(|(_, sector)| f64::from(sector.margin_px())).sum::<f64>()
        / counted().count() as f64;
    let narrow_px = NARROW.0 * (NARROW.1 - width_px / blur_px).max(0.0);
    Some(PaperEdge {
        outer,
        error_px: (ERROR_PX * ERROR_PX + narrow_px * narrow_px + common_px2 + own_px2).sqrt(),
        blur_px,
        margins: sectors.each_ref().map(|sector| {
            if !counts(sector) {
                return Margin::NONE;
            }
            let step = f64::from(sector.step()) * (white - black);
            Margin { width_px: f64::from(sector.margin_px()), step }
        }),
    })
}

fn counts(sector: &Sector) -> bool {
    sector.residual <= MAX_RESIDUAL
        && sector.rim_px().abs() < MAX_MOVED_PX
        && sector.level_deviation() < MAX_DEVIATION
}

impl Sector {
    /// Whether the paper ends close to the rim.
    fn ends_near(&self) -> bool {
        self.margin_px() < NEAR_PX && self.step().abs() > MIN_STEP
    }
}

impl PaperEdge {
    /// Work of a fit: evaluated samples, which cost about as much as pixels of the fit of grey levels.
    pub const WORK: u64 = (TURNS * SECTORS * sector::SAMPLES) as u64;

    /// The edge of the paper around a measured ring, with the white share of its disc's rim.
    pub fn around(level: Level, frame: &Frame, ring: &Ring, disc_share: f64) -> Option<Self> {
        let Ring { outer, inner, black, white, polarity, .. } = *ring;
        let is_inverted = polarity == Polarity::WhiteRing;
        let (black, white) =
            if is_inverted { (255.0 - white, 255.0 - black) } else { (black, white) };
        let disc_ratio = inner.mean_radius_px() / outer.mean_radius_px();
        let rough = RoughRing { outer, black, white, polarity, disc_ratio, disc_share };
        let mut edge = fit(level, frame, &rough)?;
        if is_inverted {
            edge.margins.iter_mut().for_each(|margin| margin.step = -margin.step);
        }
        Some(edge)
    }

    /// Distance from the rim up to which the level is known despite the paper's edge, pixels.
    pub fn clear_px(&self) -> f64 {
        self.narrowest_px() - CLEAR * self.blur_px
    }

    fn narrowest_px(&self) -> f64 {
        self.margins.iter().map(|margin| margin.width_px).fold(f64::INFINITY, f64::min)
    }
}

/// The five harmonics of the rim's displacement as shares of its size, from the sectors that count, and the rms of the
/// rest, pixels.
fn harmonics<'a>(
    sectors: impl Iterator<Item = (usize, &'a Sector)> + Clone,
    blur_px: f64,
) -> Option<([f64; 5], f64)> {
    let mut square = SMatrix::<f64, 5, 5>::zeros();
    let mut product = SVector::<f64, 5>::zeros();
    let rows = sectors.map(|(index, sector)| {
        let t = std::f64::consts::TAU * (index as f64 + 0.5) / SECTORS as f64;
        // Blur moves the half level of a curved rim inwards.
        let moved_px = f64::from(sector.rim_px()) + sector.bend_per_px * blur_px * blur_px;
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
    let (mut rest_px2, mut count) = (0.0, 0.0);
    for (basis, share, height_px) in rows {
        rest_px2 += ((share - basis.dot(&solved)) * height_px).powi(2);
        count += 1.0;
    }
    Some((solved.into(), (rest_px2 / (count - 5.0_f64).max(1.0)).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{camera::PixelPoint, normal_distribution::cumulative};

    const SIDE: usize = 90;
    const CENTER: (f64, f64) = (44.6, 45.3);
    const SEMIAXES_PX: (f64, f64) = (16.3, 14.1);

    /// A ring on a round or square sheet with this margin, on a floor of this level.
    fn picture(margin_px: f64, floor: f64, blur_px: f64, is_square: bool) -> Vec<u8> {
        let sigma_px = f64::hypot(blur_px, (1.0_f64 / 12.0).sqrt());
        let step = |away_px: f64| cumulative(away_px / sigma_px);
        let (a, b) = SEMIAXES_PX;
        let level = |u: usize, v: usize| {
            let (du, dv) = (u as f64 - CENTER.0, v as f64 - CENTER.1);
            // Distance from an ellipse of nearly equal semiaxes, to first order.
            let radius = (du / a).hypot(dv / b);
            let slope = (du / (a * a)).hypot(dv / (b * b)) / radius;
            // Blur moves the half level of a curved rim inwards.
            let drawn_px = 0.5 * sigma_px * sigma_px / (a * b).sqrt();
            let away_px = |size: f64| (radius - size) / slope + drawn_px;
            let paper_px = if is_square {
                (du.abs() - a).max(dv.abs() - b) - margin_px
            } else {
                away_px(1.0) - margin_px
            };
            let ring = step(away_px(1.0)) + step(-away_px(0.4));
            40.0 + 160.0 * ring + (floor - 200.0) * step(paper_px)
        };
        (0..SIDE * SIDE).map(|i| level(i % SIDE, i / SIDE).round() as u8).collect()
    }

    fn truth() -> Ellipse {
        Ellipse {
            center: PixelPoint { u: CENTER.0, v: CENTER.1 },
            semi_major_px: SEMIAXES_PX.0,
            semi_minor_px: SEMIAXES_PX.1,
            angle_rad: 0.0,
        }
    }

    fn fitted(pixels: &[u8], outer: Ellipse) -> Option<PaperEdge> {
        let frame = Frame::new(pixels, SIDE, SIDE, SIDE).unwrap();
        let polarity = Polarity::BlackRing;
        let (black, white) = (40.0, 200.0);
        let rough = RoughRing { outer, black, white, polarity, disc_ratio: 0.4, disc_share: 1.0 };
        fit(Level::new(), &frame, &rough)
    }

    #[test]
    fn the_rim_is_right_next_to_the_papers_edge() {
        for (margin_px, blur_px, tolerance_px) in
            [(1.5, 0.6, 0.05), (2.0, 0.8, 0.03), (2.0, 1.4, 0.1), (3.0, 1.4, 0.06)]
        {
            for (floor, is_square) in [(110.0, false), (40.0, false), (120.0, true)] {
                let pixels = picture(margin_px, floor, blur_px, is_square);
                let mut start = truth().grown(-0.4);
                start.center.u += 0.3;
                let edge = fitted(&pixels, start).unwrap();
                let (found, truth) = (edge.outer, truth());
                let case = format!("{margin_px} {blur_px} {floor} {is_square}: {edge:?}");
                assert!((found.center.u - truth.center.u).abs() < tolerance_px, "{case}");
                assert!((found.center.v - truth.center.v).abs() < tolerance_px, "{case}");
                let off_px = found.mean_radius_px() - truth.mean_radius_px();
                assert!(off_px.abs() < tolerance_px, "{off_px}: {case}");
                assert!(off_px.abs() < 4.0 * edge.error_px, "{off_px}: {case}");
            }
        }
    }

    #[test]
    fn what_the_papers_edge_adds_to_the_rim_is_known() {
        let (margin_px, floor, blur_px) = (2.0, 100.0, 1.2);
        let pixels = picture(margin_px, floor, blur_px, false);
        let edge = fitted(&pixels, truth()).unwrap();
        let sigma_px = f64::hypot(blur_px, (1.0_f64 / 12.0).sqrt());
        for away_px in [-1.0, 0.0, 1.0] {
            let at = PixelPoint { u: CENTER.0 + SEMIAXES_PX.0 + away_px, v: CENTER.1 };
            let expected = (floor - 200.0) * cumulative((away_px - margin_px) / sigma_px);
            let found = edge.added_light().at(at.u, at.v);
            assert!((found - expected).abs() < 5.0, "{away_px}: {found}, expected {expected}");
        }
    }

    #[test]
    fn uneven_light_is_no_edge() {
        let mut pixels = picture(2.0, 110.0, 0.8, false);
        for row in pixels.chunks_mut(SIDE) {
            row[..45].iter_mut().for_each(|pixel| *pixel /= 2);
        }
        assert!(fitted(&pixels, truth()).is_none());
    }
}
