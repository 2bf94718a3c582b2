//! Candidates that were no roundels, drawn with what refused them.

use roundel_core::marker::{Reject, Rejected};

use super::{Canvas, DOT_PX, columns_of, glyph, nearest};
use crate::model::reason;

const ORANGE: [u8; 3] = [255, 150, 30];
const DIM: [u8; 3] = [150, 110, 70];

impl Canvas {
    /// Draws what was rejected: boxes, and the reasons beside them where there is room. Those that
    /// came furthest are drawn over the others, and get their reasons first.
    pub(crate) fn draw_rejected(&mut self, rejected: &[Rejected]) {
        let mut order: Vec<&Rejected> = rejected.iter().collect();
        order.sort_by_key(|rejected| rejected.reject);
        for rejected in &order {
            self.draw_box(rejected);
        }
        let mut taken: Vec<Area> = Vec::new();
        for rejected in order.iter().rev().filter(|it| was_measured(it.reject)) {
            let text = reason::reject_name(rejected.reject, ' ');
            let Some((left, top, _, _)) = corners(rejected) else { continue };
            let top = top.saturating_sub((glyph::ROWS + 2) * DOT_PX);
            let area = Area::of_text(&text, left, top);
            if !taken.iter().any(|other| other.meets(&area)) {
                self.draw_text(&text, left, top, ORANGE);
                taken.push(area);
            }
        }
    }

    fn draw_box(&mut self, rejected: &Rejected) {
        let Some((left, top, right, bottom)) = corners(rejected) else { return };
        let color = if was_measured(rejected.reject) { ORANGE } else { DIM };
        // Only what lies in the picture is walked along.
        let columns = left.max(0)..=right.min(self.width - 1);
        let rows = top.max(0)..=bottom.min(self.height - 1);
        for u in columns {
            self.set(u, top, color);
            self.set(u, bottom, color);
        }
        for v in rows {
            self.set(left, v, color);
            self.set(right, v, color);
        }
    }
}

/// A rejected candidate's box: left, top, right, bottom.
fn corners(rejected: &Rejected) -> Option<(i64, i64, i64, i64)> {
    let (at, half) = (rejected.center, rejected.half_box_px);
    let [left, top, right, bottom] =
        [at.u - half.0, at.v - half.1, at.u + half.0, at.v + half.1].map(nearest);
    let is_finite =
        at.u.is_finite() && at.v.is_finite() && half.0.is_finite() && half.1.is_finite();
    is_finite.then_some((left, top, right, bottom))
}

/// Whether it came past the search's own test: of the others there are thousands in a photograph.
fn was_measured(reject: Reject) -> bool {
    reject > Reject::Chord
}

#[derive(Clone, Copy)]
struct Area {
    left: i64,
    top: i64,
    right: i64,
    bottom: i64,
}

impl Area {
    fn of_text(text: &str, left: i64, top: i64) -> Self {
        let right = left.saturating_add((columns_of(text) + 1) * DOT_PX);
        let bottom = top.saturating_add((glyph::ROWS + 1) * DOT_PX);
        Self { left: left.saturating_sub(DOT_PX), top: top.saturating_sub(DOT_PX), right, bottom }
    }

    fn meets(&self, other: &Self) -> bool {
        self.left < other.right
            && other.left < self.right
            && self.top < other.bottom
            && other.top < self.bottom
    }
}

#[cfg(test)]
mod tests {
    use roundel_core::camera::PixelPoint;

    use super::*;

    fn color(canvas: &Canvas, u: usize, v: usize) -> [u8; 3] {
        let place = 3 * (v * 64 + u);
        [canvas.rgb()[place], canvas.rgb()[place + 1], canvas.rgb()[place + 2]]
    }

    #[test]
    fn what_was_rejected_has_a_box_and_one_reason_a_place() {
        let rejected = |u, reject| {
            let center = PixelPoint { u, v: 30.0 };
            Rejected { center, half_box_px: (6.0, 5.0), reject }
        };
        let mut canvas = Canvas::of(64, 48, &[90; 64 * 48]);
        let both = [rejected(20.0, Reject::Tilt), rejected(23.0, Reject::Similarity)];
        canvas.draw_rejected(&[both[0], both[1], rejected(50.0, Reject::Chord)]);
        assert_eq!(color(&canvas, 14, 30), ORANGE);
        assert_eq!(color(&canvas, 26, 35), ORANGE);
        assert_eq!(color(&canvas, 56, 30), DIM);
        assert_eq!(color(&canvas, 22, 30), [90; 3]);
        // The later reason is written from its own box on; the earlier has no room beside it.
        let columns: Vec<usize> =
            (0..64).filter(|&u| (8..23).any(|v| color(&canvas, u, v) == ORANGE)).collect();
        assert_eq!(columns.first(), Some(&17));
        let far = Rejected { half_box_px: (1e300, f64::NAN), ..rejected(1e300, Reject::Tilt) };
        canvas.draw_rejected(&[far, Rejected { half_box_px: (1e300, 1e300), ..far }]);
    }
}
