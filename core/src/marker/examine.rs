//! The chain of tests that a candidate passes, cheapest first (paper, sections 3.1 and 3.3,
//! algorithm 2): fill the black, compare its area with its box, fill the white inside, then the ratio
//! of areas, concentricity, and the ellipses of the moments.
//!
//! Eq. (1) counts the pixels of an elliptic ring from its box, s = π/4 b_u b_v (d_o² - d_i²)/d_o².
//! That holds while an axis of the ellipse is along u; turned by 45° a ring tilted to 60° has a box
//! of 5/4 times the size. With the correlation c of u and v over the segment,
//!
//!   s = π/4 b_u b_v √(1 - c²) (1 - d_i²/d_o²),   c² = C_uv² / (C_uu C_vv)
//!
//! holds for every angle (the box of the ellipse with the matrix M has the half sides √M_uu, √M_vv,
//! its area is π √det M). The tests below use this form.
//!
//! Eq. (5) compares the pixels counted with those of the moments' ellipse. It holds for filled
//! ellipses, so s and the moments are those of black and white together: the moments of the ring
//! alone would be those of an ellipse √(1 + d_i²/d_o²) times as large.

use crate::{
    ellipse::{Ellipse, Moments, Shape},
    frame::Frame,
    marker::reject::Reject,
    segment::{Class, Fill, FillScratch, Segment, Spill, Sums, Window, fill},
};

/// Relative tolerance ρ_tol of eq. (2); a pixel of each side of the box comes on top.
const BOX_TOLERANCE: f64 = 0.15;
/// Relative tolerance ρ_prec of eq. (5), and what a rim of r pixels adds to it as 1/r.
const ROUNDNESS_TOLERANCE: (f64, f64) = (0.02, 0.4);
/// Distance of the centres as a share of the outer mean radius, and in pixels on top.
const CENTER_TOLERANCE: (f64, f64) = (0.06, 0.4);
/// Difference of the two normalized shapes, and what a disc of r pixels adds to it as 1/r.
const SIMILARITY_TOLERANCE: (f64, f64) = (0.12, 0.6);
/// Pixels that a rim may be off by at any threshold, in the ratio of diameters.
const RATIO_RIM_PX: f64 = 0.8;

/// What a roundel must look like.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rules {
    /// Smallest and largest ratio of inner to outer diameter.
    pub ratios: (f64, f64),
    /// Smallest shorter semiaxis of the outer rim, pixels.
    pub min_semi_minor_px: f64,
    /// Smallest ratio of the semiaxes.
    pub min_axis_ratio: f64,
    /// Smallest difference of white and black.
    pub min_contrast: f64,
}

/// Where to fill, and with which threshold.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Probe {
    pub center: (usize, usize),
    pub black: (usize, usize),
    pub threshold: u8,
    pub bounds: Window,
}

/// A ring to the accuracy of counted pixels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Coarse {
    pub outer: Ellipse,
    pub inner: Ellipse,
    /// Mean grey levels of the segments, μ_outer and μ_inner of eq. (3).
    pub black: f64,
    pub white: f64,
}

impl Coarse {
    /// τ = (μ_outer + μ_inner) / 2, eq. (3).
    pub fn threshold(&self) -> u8 {
        (0.5 * (self.black + self.white)).round().clamp(1.0, 255.0) as u8
    }
}

/// All tests; the first that fails says why.
pub(crate) fn examine(
    frame: &Frame,
    probe: &Probe,
    rules: &Rules,
    scratch: &mut FillScratch,
) -> Result<Coarse, Reject> {
    let black = black_segment(frame, probe, rules, scratch)?;
    let white = white_segment(frame, probe, &black, scratch)?;
    check_areas(&black, &white, rules)?;
    let shape = |sums: &Sums| Moments::from(sums).shape(probe.center).ok_or(Reject::TooSmall);
    let inner = shape(&white.sums)?;
    let outer = shape(&black.sums.joined(&white.sums))?;
    check_shapes(&outer, &inner, rules)?;
    if white.mean - black.mean < rules.min_contrast {
        return Err(Reject::Contrast);
    }
    Ok(Coarse {
        outer: outer.ellipse(),
        inner: inner.ellipse(),
        black: black.mean,
        white: white.mean,
    })
}

fn black_segment(
    frame: &Frame,
    probe: &Probe,
    rules: &Rules,
    scratch: &mut FillScratch,
) -> Result<Segment, Reject> {
    let what = Fill {
        seed: probe.black,
        class: Class::Black,
        threshold: probe.threshold,
        bounds: probe.bounds,
        origin: probe.center,
    };
    let black = fill(frame, &what, scratch).map_err(|spill| match spill {
        Spill::Seed => Reject::NoBlack,
        Spill::Bounds => Reject::BlackTooLarge,
    })?;
    if black.window.touches_edge(frame) {
        return Err(Reject::FrameEdge);
    }
    let smallest_side = 2.0 * rules.min_semi_minor_px - 1.0;
    let (width, height) = (black.window.width() as f64, black.window.height() as f64);
    if width.min(height) < smallest_side {
        return Err(Reject::TooSmall);
    }
    let filled = box_share(&black).ok_or(Reject::TooSmall)?;
    let tolerance = box_tolerance(&black);
    let (most, least) = (1.0 - rules.ratios.0.powi(2), 1.0 - rules.ratios.1.powi(2));
    if filled < least * (1.0 - tolerance) || filled > most * (1.0 + tolerance) {
        return Err(Reject::BlackBox);
    }
    Ok(black)
}

fn white_segment(
    frame: &Frame,
    probe: &Probe,
    black: &Segment,
    scratch: &mut FillScratch,
) -> Result<Segment, Reject> {
    // The centre of the black segment, algorithm 2; sums count from the probe's centre.
    let mean = |sum: i64| (sum as f64 / black.sums.n as f64).round();
    let u = probe.center.0 as f64 + mean(black.sums.u);
    let v = probe.center.1 as f64 + mean(black.sums.v);
    let what = Fill {
        seed: (u.max(0.0) as usize, v.max(0.0) as usize),
        class: Class::White,
        threshold: probe.threshold,
        bounds: black.window,
        origin: probe.center,
    };
    let white = fill(frame, &what, scratch).map_err(|spill| match spill {
        Spill::Seed => Reject::NoWhite,
        Spill::Bounds => Reject::WhiteTooLarge,
    })?;
    let filled = box_share(&white).ok_or(Reject::TooSmall)?;
    if (filled - 1.0).abs() > box_tolerance(&white) {
        return Err(Reject::WhiteBox);
    }
    Ok(white)
}

/// Pixels of a segment as a share of those of an ellipse in its box, eqs. (1) and (2) with the
/// correction for turned ellipses: 1 for a disc, 1 - d_i²/d_o² for a ring. `None` if it has no
/// extent in some direction.
fn box_share(segment: &Segment) -> Option<f64> {
    let c = Moments::from(&segment.sums).shape((0, 0))?.covariance;
    let upright = (c.determinant() / (c.uu * c.vv)).sqrt();
    let (width, height) = (segment.window.width() as f64, segment.window.height() as f64);
    Some(segment.sums.n as f64 / (std::f64::consts::FRAC_PI_4 * width * height * upright))
}

fn box_tolerance(segment: &Segment) -> f64 {
    BOX_TOLERANCE + 1.0 / segment.window.width() as f64 + 1.0 / segment.window.height() as f64
}

/// The ratio of the segments' areas, from which follows that of the diameters (algorithm 2).
fn check_areas(black: &Segment, white: &Segment, rules: &Rules) -> Result<(), Reject> {
    let (black, white) = (black.sums.n as f64, white.sums.n as f64);
    let ratio = (white / (white + black)).sqrt();
    let radius_px = ((white + black) / std::f64::consts::PI).sqrt();
    let slack = RATIO_RIM_PX / radius_px;
    let (least, most) = rules.ratios;
    if ratio < least - slack || ratio > most + slack { Err(Reject::AreaRatio) } else { Ok(()) }
}

fn check_shapes(outer: &Shape, inner: &Shape, rules: &Rules) -> Result<(), Reject> {
    let (outer_rim, inner_rim) = (outer.ellipse(), inner.ellipse());
    if outer_rim.semi_minor_px < rules.min_semi_minor_px {
        return Err(Reject::TooSmall);
    }
    if outer_rim.semi_minor_px < rules.min_axis_ratio * outer_rim.semi_major_px {
        return Err(Reject::Tilt);
    }
    let apart_px = (outer.center.u - inner.center.u).hypot(outer.center.v - inner.center.v);
    if apart_px > CENTER_TOLERANCE.0 * outer_rim.mean_radius_px() + CENTER_TOLERANCE.1 {
        return Err(Reject::Concentricity);
    }
    for (shape, rim) in [(outer, &outer_rim), (inner, &inner_rim)] {
        let tolerance = ROUNDNESS_TOLERANCE.0 + ROUNDNESS_TOLERANCE.1 / rim.semi_minor_px;
        if (shape.roundness() - 1.0).abs() > tolerance {
            return Err(Reject::Roundness);
        }
    }
    check_similarity(&outer_rim, &inner_rim, SIMILARITY_TOLERANCE)
}

/// Both rims are images of circles in one plane, so their shapes are the same but for perspective.
/// The tolerance of the normalized shapes is `share`, and `rim_px` pixels of the smaller rim.
pub(crate) fn check_similarity(
    outer: &Ellipse,
    inner: &Ellipse,
    (share, rim_px): (f64, f64),
) -> Result<(), Reject> {
    let (o, i) = (outer.matrix(), inner.matrix());
    let (of, inf) = (1.0 / o.determinant().sqrt(), 1.0 / i.determinant().sqrt());
    let difference =
        (0.5 * (o.uu * of - i.uu * inf - o.vv * of + i.vv * inf)).hypot(o.uv * of - i.uv * inf);
    // Of a flat ellipse the same error of a pixel changes the normalized matrix more.
    let flat = outer.semi_major_px / outer.semi_minor_px;
    let tolerance = (share + rim_px / inner.semi_minor_px) * flat;
    if difference > tolerance { Err(Reject::Similarity) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{camera::PixelPoint, ellipse::Chords};

    /// A black segment and its hole, as sets of pixel centres inside ellipses.
    fn ring(angle_rad: f64, tilt: f64, ratio: f64) -> (Segment, Segment) {
        let rim = |scale: f64| {
            Chords::new(&Ellipse {
                center: PixelPoint { u: 60.3, v: 59.8 },
                semi_major_px: 50.0 * scale,
                semi_minor_px: 50.0 * scale * tilt,
                angle_rad,
            })
        };
        let (outer, inner) = (rim(1.0), rim(ratio));
        let (mut black, mut white) = (Sums::default(), Sums::default());
        let empty = Window { left: 999, top: 999, right: 0, bottom: 0 };
        let mut boxes = [empty; 2];
        for v in 0..120 {
            let columns = |(from, to): (f64, f64)| (from.ceil() as i64, to.ceil() as i64);
            let o = columns(outer.span(f64::from(v)));
            let i = columns(inner.span(f64::from(v)));
            black.add_run(v.into(), o.0, i.0.clamp(o.0, o.1));
            black.add_run(v.into(), i.1.clamp(o.0, o.1), o.1);
            white.add_run(v.into(), i.0, i.1);
            for (window, (first, end)) in boxes.iter_mut().zip([o, i]) {
                if first < end {
                    window.left = window.left.min(first as usize);
                    window.right = window.right.max(end as usize);
                    window.top = window.top.min(v as usize);
                    window.bottom = v as usize + 1;
                }
            }
        }
        (
            Segment { window: boxes[0], sums: black, mean: 20.0 },
            Segment { window: boxes[1], sums: white, mean: 200.0 },
        )
    }

    #[test]
    fn equation_1_holds_at_every_angle() {
        for step in 0..12 {
            let angle = f64::from(step) * 0.26;
            let (black, white) = ring(angle, 0.5, 0.4);
            let found = box_share(&black).unwrap();
            assert!((found - (1.0 - 0.16)).abs() < 0.05, "{angle} {found}");
            let found = box_share(&white).unwrap();
            assert!((found - 1.0).abs() < 0.09, "{angle} {found}");
        }
        // The form in print is off by a quarter where the ellipse stands askew.
        let (black, _) = ring(std::f64::consts::FRAC_PI_4, 0.5, 0.4);
        let (width, height) = (black.window.width() as f64, black.window.height() as f64);
        let printed = std::f64::consts::FRAC_PI_4 * width * height * (1.0 - 0.16);
        assert!(printed / black.sums.n as f64 > 1.2);
    }

    #[test]
    fn equation_5_needs_black_and_white_together() {
        let (black, white) = ring(0.4, 0.7, 0.5);
        let shape = |sums: &Sums| Moments::from(sums).shape((0, 0)).unwrap();
        assert!((shape(&black.sums.joined(&white.sums)).roundness() - 1.0).abs() < 0.01);
        // Of the ring alone: (1 + r²) / (1 - r²) with r² = 1/4.
        assert!((shape(&black.sums).roundness() - 1.25 / 0.75).abs() < 0.02);
    }
}
