//! Draws what was found into a picture: outer rims green, inner rims cyan, centres of the outer rim
//! red; on black beside them codes white with a `#` before them, and tracks' numbers yellow. What was
//! rejected is an orange box with the reason, or a dim one without, if it had hardly begun to look like
//! a ring. The edges of masked regions are magenta.

pub(crate) mod glyph;
mod rejected;

use roundel_core::{camera::PixelPoint, ellipse::Ellipse, id::TrackNumber, marker::Ring};

const GREEN: [u8; 3] = [40, 230, 80];
const CYAN: [u8; 3] = [30, 200, 255];
const RED: [u8; 3] = [255, 50, 50];
const YELLOW: [u8; 3] = [255, 230, 60];
const WHITE: [u8; 3] = [255, 255, 255];
const MAGENTA: [u8; 3] = [255, 80, 230];
const BLACK: [u8; 3] = [0, 0, 0];
/// Half the length of the cross at a centre, pixels.
const CROSS_PX: i64 = 3;
/// Edge of one dot of a character, pixels.
const DOT_PX: i64 = 2;
/// A colour image to draw on; what lies outside is left out.
pub(crate) struct Canvas {
    width: i64,
    height: i64,
    rgb: Vec<u8>,
}

impl Canvas {
    /// A grey image, row by row without gaps, to draw on.
    pub(crate) fn of(width: usize, height: usize, grey: &[u8]) -> Self {
        let rgb = grey.iter().flat_map(|&grey| [grey; 3]).collect();
        Self { width: width as i64, height: height as i64, rgb }
    }

    /// Red, green and blue of each pixel, row by row without gaps.
    pub(crate) fn rgb(&self) -> &[u8] {
        &self.rgb
    }

    /// Draws a ring's rims, its centre, and beside it its code and its track's number.
    pub(crate) fn draw_ring(&mut self, ring: &Ring, track: Option<TrackNumber>) {
        let outer = &ring.outer;
        self.draw_ellipse(outer, GREEN);
        self.draw_ellipse(&ring.inner, CYAN);
        let (u, v) = (nearest(outer.center.u), nearest(outer.center.v));
        for step in -CROSS_PX..=CROSS_PX {
            self.set(u.saturating_add(step), v, RED);
            self.set(u, v.saturating_add(step), RED);
        }
        let code = ring.code.map(|reading| (format!("#{}", reading.code.number), WHITE));
        let track = track.map(|track| (track.0.to_string(), YELLOW));
        let left = u.saturating_add(nearest(outer.semi_major_px)).saturating_add(2 * DOT_PX);
        let line_px = (glyph::ROWS + 1) * DOT_PX;
        let lines = i64::from(code.is_some()) + i64::from(track.is_some());
        let top = v.saturating_sub((lines * line_px - DOT_PX) / 2);
        for (line, (text, color)) in (0..).zip(code.into_iter().chain(track)) {
            self.draw_text(&text, left, top.saturating_add(line * line_px), color);
        }
    }

    /// Draws a polygon's edges.
    pub(crate) fn draw_polygon(&mut self, corners: &[PixelPoint]) {
        let next = corners.iter().cycle().skip(1);
        for (from, to) in corners.iter().zip(next) {
            self.draw_line(from, to, MAGENTA);
        }
    }

    fn draw_line(&mut self, from: &PixelPoint, to: &PixelPoint, color: [u8; 3]) {
        let Some((first, last)) = self.part_inside(from, to) else { return };
        let (along_u, along_v) = (to.u - from.u, to.v - from.v);
        let steps = ((last - first) * along_u.abs().max(along_v.abs())).ceil().max(1.0);
        for step in 0..=steps as usize {
            let part = first + (last - first) * step as f64 / steps;
            self.set(nearest(from.u + part * along_u), nearest(from.v + part * along_v), color);
        }
    }

    /// Which part of a line, as shares of its length, can touch the picture (Liang, Barsky 1984).
    fn part_inside(&self, from: &PixelPoint, to: &PixelPoint) -> Option<(f64, f64)> {
        let (mut first, mut last) = (0.0_f64, 1.0_f64);
        for (start, end, size) in [(from.u, to.u, self.width), (from.v, to.v, self.height)] {
            let along = end - start;
            let bounds = [-1.0 - start, size as f64 - start];
            if along == 0.0 {
                if bounds[0] > 0.0 || bounds[1] < 0.0 {
                    return None;
                }
                continue;
            }
            let [one, other] = bounds.map(|bound| bound / along);
            first = first.max(one.min(other));
            last = last.min(one.max(other));
        }
        // Not finite: no comparison holds.
        (first <= last).then_some((first, last))
    }

    fn draw_ellipse(&mut self, ellipse: &Ellipse, color: [u8; 3]) {
        let (a, b) = (ellipse.semi_major_px, ellipse.semi_minor_px);
        // Rims that reach far beyond the picture are wrong, and would take long to draw.
        let is_drawable = a.is_finite() && b.is_finite() && a < (self.width + self.height) as f64;
        if !is_drawable {
            return;
        }
        let (sin, cos) = ellipse.angle_rad.sin_cos();
        // Steps of less than a pixel, for 2π a is at least the rim's length.
        let steps = (std::f64::consts::TAU * a * 1.2).ceil().max(8.0) as usize;
        for step in 0..steps {
            let (y, x) = (std::f64::consts::TAU * step as f64 / steps as f64).sin_cos();
            let u = ellipse.center.u + a * x * cos - b * y * sin;
            let v = ellipse.center.v + a * x * sin + b * y * cos;
            self.set(nearest(u), nearest(v), color);
        }
    }

    /// Writes a text with its top left corner there, on a black ground with a margin of one dot.
    fn draw_text(&mut self, text: &str, left: i64, top: i64, color: [u8; 3]) {
        let advance = glyph::COLUMNS + 1;
        let columns = columns_of(text);
        self.fill_dots(left, top, (-1..=columns, -1..=glyph::ROWS), BLACK);
        for (place, character) in (0..).zip(text.chars()) {
            for (row, dots) in (0..).zip(glyph::rows(character)) {
                for column in 0..glyph::COLUMNS {
                    if dots >> (glyph::COLUMNS - 1 - column) & 1 == 1 {
                        let column = place * advance + column;
                        self.fill_dots(left, top, (column..=column, row..=row), color);
                    }
                }
            }
        }
    }

    fn fill_dots(
        &mut self,
        left: i64,
        top: i64,
        (columns, rows): (std::ops::RangeInclusive<i64>, std::ops::RangeInclusive<i64>),
        color: [u8; 3],
    ) {
        for v in rows.start() * DOT_PX..(rows.end() + 1) * DOT_PX {
            for u in columns.start() * DOT_PX..(columns.end() + 1) * DOT_PX {
                self.set(left.saturating_add(u), top.saturating_add(v), color);
            }
        }
    }

    fn set(&mut self, u: i64, v: i64, color: [u8; 3]) {
        if (0..self.width).contains(&u) && (0..self.height).contains(&v) {
            let place = 3 * (v * self.width + u) as usize;
            self.rgb[place..place + 3].copy_from_slice(&color);
        }
    }
}

/// Dots that a text is wide.
fn columns_of(text: &str) -> i64 {
    text.chars().count() as i64 * (glyph::COLUMNS + 1) - 1
}

/// The pixel that a coordinate lies in; NaN counts as 0, and what is too far as very far.
fn nearest(coordinate_px: f64) -> i64 {
    coordinate_px.round() as i64
}

#[cfg(test)]
mod tests {
    use roundel_core::marker::{Code, CodeReading};

    use super::*;

    fn ring(u: f64, v: f64, size_px: f64) -> Ring {
        let center = PixelPoint { u, v };
        let outer = Ellipse {
            center,
            semi_major_px: size_px,
            semi_minor_px: size_px / 2.0,
            angle_rad: 0.0,
        };
        let inner = Ellipse { semi_major_px: size_px / 2.0, semi_minor_px: size_px / 4.0, ..outer };
        Ring::of_rims(outer, inner)
    }

    fn color(canvas: &Canvas, u: usize, v: usize) -> [u8; 3] {
        let place = 3 * (v * 64 + u);
        [canvas.rgb()[place], canvas.rgb()[place + 1], canvas.rgb()[place + 2]]
    }

    #[test]
    fn rims_and_centre_stand_where_they_are() {
        let mut canvas = Canvas::of(64, 48, &[90; 64 * 48]);
        canvas.draw_ring(&ring(20.0, 24.0, 10.0), None);
        assert_eq!(color(&canvas, 30, 24), GREEN);
        assert_eq!(color(&canvas, 20, 29), GREEN);
        assert_eq!(color(&canvas, 15, 24), CYAN);
        assert_eq!(color(&canvas, 20, 24), RED);
        assert_eq!(color(&canvas, 40, 24), [90; 3]);
    }

    #[test]
    fn the_code_stands_above_the_tracks_number() {
        let ring = Ring { code: Some(reading(7)), ..ring(10.0, 24.0, 8.0) };
        let mut canvas = Canvas::of(64, 48, &[90; 64 * 48]);
        canvas.draw_ring(&ring, Some(TrackNumber(3)));
        let rows_with = |wanted| -> Vec<usize> {
            (0..48).filter(|&v| (22..40).any(|u| color(&canvas, u, v) == wanted)).collect()
        };
        let (code, track) = (rows_with(WHITE), rows_with(YELLOW));
        assert_eq!((code.len(), track.len()), (10, 10));
        assert!(code[9] < track[0], "{code:?} {track:?}");
    }

    fn reading(number: u16) -> CodeReading {
        let zero = PixelPoint { u: 0.0, v: 0.0 };
        CodeReading::certain(Code { bits: 8, number }, zero)
    }

    #[test]
    fn polygons_are_closed_and_cut_at_the_edges() {
        let mut canvas = Canvas::of(64, 48, &[90; 64 * 48]);
        let corners = [(10.0, 10.0), (1e9, 10.0), (10.0, 40.0)].map(|(u, v)| PixelPoint { u, v });
        canvas.draw_polygon(&corners);
        for (u, v) in [(10, 10), (63, 10), (10, 40), (10, 25), (63, 40)] {
            assert_eq!(color(&canvas, u, v), MAGENTA, "{u} {v}");
        }
        assert_eq!(color(&canvas, 30, 25), [90; 3]);
        canvas.draw_polygon(&[]);
        canvas.draw_polygon(&[PixelPoint { u: f64::NAN, v: 1.0 }, corners[0], corners[1]]);
    }

    #[test]
    fn what_lies_outside_is_left_out() {
        let mut canvas = Canvas::of(64, 48, &[90; 64 * 48]);
        for (u, v, size_px) in
            [(-5.0, 60.0, 12.0), (1e300, 0.0, 5.0), (3.0, 3.0, f64::NAN), (0.0, 0.0, 1e9)]
        {
            canvas.draw_ring(&ring(u, v, size_px), Some(TrackNumber(u64::MAX)));
        }
        assert_eq!(canvas.rgb().len(), 3 * 64 * 48);
    }
}
