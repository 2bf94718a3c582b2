//! The black area of one roundel, as [`roundel_core::marker`] detects it.

use std::f64::consts::TAU;

use kurbo::{Arc, BezPath, Ellipse, Point, Rect, Shape as _, Vec2};
use roundel_core::marker::{CodeLayout, Kind, Pattern, Polarity, Tooth};

use crate::lab::drawing::TOLERANCE;

/// Side of the square that a roundel is cut out as, over its outer diameter. The detector measures the background level
/// in the margin beside the ring.
pub const SIDE_SHARE: f64 = 1.35;

/// Least side where the page is too small: the detector needs a margin of three pixels.
pub const MIN_SIDE_SHARE: f64 = 1.15;

/// The black area of a roundel at `center`, in the page's orientation. `teeth` are those of the code; `side_mm` is the
/// side of the square that it is cut out as.
pub fn outline(kind: &Kind, teeth: &[Tooth], center: Point, side_mm: f64) -> BezPath {
    let (outer_mm, inner_mm) = (kind.outer_diameter_m * 500.0, kind.inner_diameter_m * 500.0);
    let mut path = BezPath::new();
    if kind.polarity == Polarity::WhiteRing {
        path.extend(square(center, side_mm).path_elements(TOLERANCE));
    }
    let mut add_ellipse = |across_mm, down_mm| {
        let ellipse = Ellipse::new(center, (across_mm, down_mm), 0.0);
        path.extend(ellipse.path_elements(TOLERANCE));
    };
    add_ellipse(outer_mm, outer_mm);
    match kind.pattern {
        Pattern::Elliptical { minor_diameter_m } => add_ellipse(inner_mm, minor_diameter_m * 500.0),
        Pattern::Coded(_) if !teeth.is_empty() => {
            add_toothed_disc(&mut path, center, inner_mm, teeth);
        }
        Pattern::Plain | Pattern::Coded(_) => add_ellipse(inner_mm, inner_mm),
    }
    path
}

pub(super) fn square(center: Point, side_mm: f64) -> Rect {
    Rect::from_center_size(center, (side_mm, side_mm))
}

/// The disc between the teeth as one outline; each tooth reaches from the rim down to the core. It is a hole in the
/// ring rather than black on white, so that no seam shows between ring and teeth.
fn add_toothed_disc(path: &mut BezPath, center: Point, rim_mm: f64, teeth: &[Tooth]) {
    let core_mm = rim_mm * CodeLayout::CORE_SHARE;
    // Angles of teeth are counter-clockwise, and y grows downwards.
    let at = |radius_mm: f64, angle_rad: f64| center + radius_mm * Vec2::from_angle(-angle_rad);
    let add_arc = |path: &mut BezPath, radius_mm: f64, from_rad: f64, to_rad: f64| {
        let arc = Arc::new(center, (radius_mm, radius_mm), -from_rad, from_rad - to_rad, 0.0);
        path.extend(arc.append_iter(TOLERANCE));
    };
    let first_rad = teeth[0].from_rad;
    path.move_to(at(core_mm, first_rad));
    for (index, tooth) in teeth.iter().enumerate() {
        add_arc(path, core_mm, tooth.from_rad, tooth.to_rad);
        let next_rad = teeth.get(index + 1).map_or(first_rad + TAU, |next| next.from_rad);
        // The last tooth of a code may touch the first one.
        if next_rad - tooth.to_rad > 1e-9 {
            path.line_to(at(rim_mm, tooth.to_rad));
            add_arc(path, rim_mm, tooth.to_rad, next_rad);
            path.line_to(at(core_mm, next_rad));
        }
    }
    path.close_path();
}

#[cfg(test)]
mod tests {
    use kurbo::ParamCurve as _;

    use super::*;

    #[test]
    fn a_circle_of_curves_is_a_circle() {
        let center = Point::new(30.0, 40.0);
        let print = outline(&Kind::plain("", 0.05, 0.02), &[], center, 60.0);
        let radii_mm = print.segments().flat_map(|curve| {
            [0.0, 0.2, 0.5, 0.8, 1.0].map(|share| curve.eval(share).distance(center))
        });
        let mut count = 0;
        for radius_mm in radii_mm {
            let wanted_mm = if radius_mm > 20.0 { 25.0 } else { 10.0 };
            assert!((radius_mm - wanted_mm).abs() < 2e-6, "{radius_mm}");
            count += 1;
        }
        assert!(count >= 2 * 4 * 5, "{count}");
    }
}
