//! The black of one roundel, by its kind: what [`roundel_core::marker`] looks for.

use std::f64::consts::TAU;

use roundel_core::marker::{CodeLayout, Kind, Pattern, Polarity, Tooth};

use super::path::{Area, Path, Place};

/// Side of the square that a roundel is cut out as, over its outer diameter: what is left beside the
/// ring is the margin that the detector takes its level from.
pub const SIDE_SHARE: f64 = 1.35;

/// The least of that, where a page has no more room: the margin's level is taken within three pixels of the rim.
pub const MIN_SIDE_SHARE: f64 = 1.15;

/// The black of a roundel round `center`: the print's right is the page's right, its up the page's up.
/// `teeth` are the code's, of coded kinds; `side_mm` is that of the square that it is cut out as.
pub fn outline(kind: &Kind, teeth: &[Tooth], center: Place, side_mm: f64) -> Path {
    let (outer_mm, inner_mm) = (kind.outer_diameter_m * 500.0, kind.inner_diameter_m * 500.0);
    let mut path = Path::default();
    if kind.polarity == Polarity::WhiteRing {
        path.add_rectangle(&Area::square(center, side_mm));
    }
    path.add_ellipse(center, outer_mm, outer_mm);
    match kind.pattern {
        Pattern::Plain => path.add_ellipse(center, inner_mm, inner_mm),
        Pattern::Elliptical { minor_diameter_m } => {
            path.add_ellipse(center, inner_mm, minor_diameter_m * 500.0);
        }
        Pattern::Coded(_) => {
            add_toothed_disc(&mut path, center, inner_mm, teeth);
        }
    }
    path
}

/// The disc between the teeth, as one outline: each tooth reaches from its rim down to its core. Drawn as
/// a hole of the ring rather than as black on white, so that no seam shows between ring and teeth.
fn add_toothed_disc(path: &mut Path, center: Place, rim_mm: f64, teeth: &[Tooth]) {
    let core_mm = rim_mm * CodeLayout::CORE_SHARE;
    let Some(first) = teeth.first() else {
        path.add_ellipse(center, rim_mm, rim_mm);
        return;
    };
    path.begin_on_circle(center, core_mm, first.from_rad);
    for (index, tooth) in teeth.iter().enumerate() {
        path.arc_on_circle(center, core_mm, tooth.from_rad, tooth.to_rad);
        let next_rad = teeth.get(index + 1).map_or(first.from_rad + TAU, |next| next.from_rad);
        // A code's last tooth may reach the first one over the print's right.
        if next_rad - tooth.to_rad > 1e-9 {
            path.line_to_circle(center, rim_mm, tooth.to_rad);
            path.arc_on_circle(center, rim_mm, tooth.to_rad, next_rad);
            path.line_to_circle(center, core_mm, next_rad);
        }
    }
    path.close();
}
