//! The axes of maps and charts.

use std::ops::Range;

use kurbo::{Point, Rect};

use super::{Anchor, BLACK, Color, Shape};

/// Height of capitals, pixels.
pub(crate) const LETTER_PX: f64 = 10.0;
/// Least distance between marks along an axis, pixels.
const MARKS_PX: f64 = 80.0;
const GRID: Color = [225; 3];

/// An area of a picture in pixels, and the values at its edges. y grows upwards.
pub(crate) struct Axes {
    pub(crate) area: Rect,
    pub(crate) x: Range<f64>,
    pub(crate) y: Range<f64>,
}

impl Axes {
    /// The pixel at a pair of values.
    pub(crate) fn point(&self, x: f64, y: f64) -> Point {
        let share =
            |value: f64, range: &Range<f64>| (value - range.start) / (range.end - range.start);
        Point::new(
            self.area.x0 + share(x, &self.x) * self.area.width(),
            self.area.y1 - share(y, &self.y) * self.area.height(),
        )
    }

    /// Lines through the area at each mark.
    pub(crate) fn grid(&self) -> Vec<Shape> {
        let Rect { x0, y0, x1, y1 } = self.area;
        let line =
            |from: (f64, f64), to: (f64, f64)| Shape::polyline([from.into(), to.into()], 1.0, GRID);
        let columns = marks(&self.x, x1 - x0).map(|x| self.point(x, self.y.start).x);
        let rows = marks(&self.y, y1 - y0).map(|y| self.point(self.x.start, y).y);
        let columns = columns.map(|x| line((x, y0), (x, y1)));
        columns.chain(rows.map(|y| line((x0, y), (x1, y)))).collect()
    }

    /// A frame around the area with marks, values and the names of both axes.
    pub(crate) fn frame(&self, names: [&str; 2]) -> Vec<Shape> {
        let Rect { x0, y0, x1, y1 } = self.area;
        let text = |x: f64, y: f64, anchor, text: String| {
            Shape::text(Point::new(x, y), anchor, LETTER_PX, text)
        };
        let corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)].map(Point::from);
        let mut shapes = vec![Shape::polyline(corners, 1.0, BLACK)];
        for x in marks(&self.x, x1 - x0) {
            let at = self.point(x, self.y.start);
            shapes.push(Shape::line(at, at + (0.0, 6.0), 1.0));
            shapes.push(text(at.x, at.y + 22.0, Anchor::Middle, format!("{x}")));
        }
        for y in marks(&self.y, y1 - y0) {
            let at = self.point(self.x.start, y);
            shapes.push(Shape::line(at, at - (6.0, 0.0), 1.0));
            shapes.push(text(at.x - 10.0, at.y + 5.0, Anchor::End, format!("{y}")));
        }
        shapes.push(text(x1, y1 + 40.0, Anchor::End, names[0].to_owned()));
        shapes.push(text(x0 - 10.0, y0 - 18.0, Anchor::End, names[1].to_owned()));
        shapes
    }
}

/// Round values in a range that covers `length_px` pixels.
fn marks(range: &Range<f64>, length_px: f64) -> impl Iterator<Item = f64> {
    let step = round_step((range.end - range.start) / length_px * MARKS_PX);
    let indices = (range.start / step).ceil() as i64..=(range.end / step + 1e-9).floor() as i64;
    // Division by a whole number rounds decimals correctly.
    indices.map(
        move |index| {
            if step < 1.0 { index as f64 / (1.0 / step).round() } else { index as f64 * step }
        },
    )
}

/// 1, 2 or 5 times a power of ten, not below `least`.
fn round_step(least: f64) -> f64 {
    let power = 10f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0]
        .into_iter()
        .map(|digit| digit * power)
        .find(|step| *step >= least)
        .unwrap_or(10.0 * power)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_round() {
        assert!((round_step(0.13) - 0.2).abs() < 1e-12);
        assert!((round_step(7.0) - 10.0).abs() < 1e-12);
        let values = |range: Range<f64>| marks(&range, 400.0).collect::<Vec<_>>();
        assert_eq!(values(-0.3..0.61), [-0.2, 0.0, 0.2, 0.4, 0.6]);
        assert_eq!(values(80.0..1580.0), [500.0, 1000.0, 1500.0]);
    }
}
