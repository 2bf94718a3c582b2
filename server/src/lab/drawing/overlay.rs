//! Draws detections onto a camera picture: outer rims green, inner rims cyan, centres of the outer rim red. Codes
//! (white, after a `#`) and track numbers (yellow) stand on black beside them. Rejected candidates are orange boxes
//! with the reason, or dim boxes without one if they failed the first test of the search. The edges of masked
//! regions are magenta.

use jpeg_encoder::{ColorType, Encoder, EncodingError};
use kurbo::{Ellipse, Point, Rect, Shape as _};
use roundel_core::{
    camera::PixelPoint,
    ellipse::Ellipse as Rim,
    id::TrackNumber,
    marker::{Reject, Rejected, Ring},
};
use tiny_skia::{PixmapMut, Transform};

use super::{Anchor, BLACK, Color, Shape, WHITE, glyph, raster};
use crate::model::reason;

const GREEN: Color = [40, 230, 80];
const CYAN: Color = [30, 200, 255];
const RED: Color = [255, 50, 50];
const YELLOW: Color = [255, 230, 60];
const MAGENTA: Color = [255, 80, 230];
const ORANGE: Color = [255, 150, 30];
const DIM: Color = [150, 110, 70];
/// Half the length of the cross at a centre, pixels.
const CROSS_PX: f64 = 3.0;
/// Height of capitals, pixels.
const TEXT_PX: f64 = 10.0;
/// Width of one dot of a character, pixels.
const DOT_PX: f64 = 2.0;
/// Largest distance between a rim and its curve, pixels.
const RIM_PX: f64 = 0.05;
const JPEG_QUALITY: u8 = 80;

pub(crate) struct Overlay {
    width: usize,
    height: usize,
    rgba: Vec<u8>,
}

impl Overlay {
    /// From a grey image, row by row without gaps.
    pub(crate) fn new(width: usize, height: usize, grey: &[u8]) -> Self {
        let rgba = grey.iter().flat_map(|&grey| [grey, grey, grey, 255]).collect();
        Self { width, height, rgba }
    }

    /// Red, green and blue of each pixel, row by row without gaps.
    pub(crate) fn rgb(&self) -> Vec<u8> {
        self.rgba.chunks_exact(4).flat_map(|pixel| &pixel[..3]).copied().collect()
    }

    /// The image as a JPEG file; its sides are at most 65535 pixels.
    pub(crate) fn jpeg(&self) -> Result<Vec<u8>, EncodingError> {
        let mut jpeg = Vec::with_capacity(self.rgba.len() / 16);
        let [width, height] =
            [self.width, self.height].map(|side| side.try_into().unwrap_or(u16::MAX));
        Encoder::new(&mut jpeg, JPEG_QUALITY).encode(&self.rgba, width, height, ColorType::Rgba)?;
        Ok(jpeg)
    }

    /// Draws a ring's rims and centre, and its code and track number beside it.
    pub(crate) fn draw_ring(&mut self, ring: &Ring, track: Option<TrackNumber>) {
        self.draw_rim(&ring.outer, GREEN);
        self.draw_rim(&ring.inner, CYAN);
        let (u, v) = (ring.outer.center.u.round(), ring.outer.center.v.round());
        let center = Point::new(u + 0.5, v + 0.5);
        for arm in [(CROSS_PX, 0.0), (0.0, CROSS_PX)] {
            self.draw_line([center - arm, center + arm], false, RED);
        }
        let code = ring.code.map(|reading| (format!("#{}", reading.code.number), WHITE));
        let track = track.map(|track| (track.0.to_string(), YELLOW));
        let left = u + ring.outer.semi_major_px.round() + 2.0 * DOT_PX;
        let line_px = TEXT_PX + DOT_PX;
        let lines: Vec<_> = code.into_iter().chain(track).collect();
        let mut top = (v - 0.5 * (lines.len() as f64 * line_px - DOT_PX)).round();
        for (text, color) in lines {
            self.draw_text(&text, Point::new(left, top), color);
            top += line_px;
        }
    }

    pub(crate) fn draw_polygon(&mut self, corners: &[PixelPoint]) {
        self.draw_line(corners.iter().map(|corner| pixel_center(*corner)), true, MAGENTA);
    }

    /// Draws rejected candidates as boxes, and the reasons beside them where they do not overlap. Candidates rejected at
    /// later stages cover the others and are labelled first.
    pub(crate) fn draw_rejected(&mut self, rejected: &[Rejected]) {
        let mut order: Vec<&Rejected> = rejected.iter().collect();
        order.sort_by_key(|rejected| rejected.reject);
        for rejected in &order {
            let color = if was_measured(rejected.reject) { ORANGE } else { DIM };
            let Rect { x0, y0, x1, y1 } = bounds(rejected) + kurbo::Vec2::new(0.5, 0.5);
            let corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)].map(Point::from);
            self.draw_line(corners, true, color);
        }
        let mut taken: Vec<Rect> = Vec::new();
        for rejected in order.iter().rev().filter(|it| was_measured(it.reject)) {
            let text = reason::reject_name(rejected.reject, ' ');
            let Rect { x0: left, y0: top, .. } = bounds(rejected);
            let corner = Point::new(left, top - TEXT_PX - 2.0 * DOT_PX);
            let area = text_area(&text, corner);
            if area.is_finite() && !taken.iter().any(|other| other.overlaps(area)) {
                self.draw_text(&text, corner, ORANGE);
                taken.push(area);
            }
        }
    }

    fn draw_rim(&mut self, rim: &Rim, color: Color) {
        let axes = (rim.semi_major_px, rim.semi_minor_px);
        // Rims far beyond the picture are wrong and slow to draw.
        let drawn = 0.0..(self.width + self.height) as f64;
        if drawn.contains(&axes.0) && drawn.contains(&axes.1) {
            let ellipse = Ellipse::new(pixel_center(rim.center), axes, rim.angle_rad);
            self.paint(&Shape::Line { path: ellipse.to_path(RIM_PX), width: 0.0, color });
        }
    }

    fn draw_line(
        &mut self,
        points: impl IntoIterator<Item = Point>,
        is_closed: bool,
        color: Color,
    ) {
        let mut line = Shape::polyline(points, 0.0, color);
        if let Shape::Line { path, .. } = &mut line
            && is_closed
            && !path.elements().is_empty()
        {
            path.close_path();
        }
        self.paint(&line);
    }

    /// Draws a text below and right of a corner, on black with a margin of one dot.
    fn draw_text(&mut self, text: &str, corner: Point, color: Color) {
        self.paint(&Shape::fill(text_area(text, corner), BLACK));
        let (at, text) = (corner + (0.0, TEXT_PX), text.to_owned());
        self.paint(&Shape::Text { at, anchor: Anchor::Start, height: TEXT_PX, text, color });
    }

    fn paint(&mut self, shape: &Shape) {
        let size = (self.width as u32, self.height as u32);
        if let Some(mut pixmap) = PixmapMut::from_bytes(&mut self.rgba, size.0, size.1) {
            raster::paint(&mut pixmap, shape, Transform::identity(), false);
        }
    }
}

/// In a drawing, pixel centres are half a pixel from the pixel's corner.
fn pixel_center(at: PixelPoint) -> Point {
    Point::new(at.u + 0.5, at.v + 0.5)
}

fn text_area(text: &str, corner: Point) -> Rect {
    let size = (glyph::width(text, TEXT_PX) - DOT_PX, TEXT_PX);
    Rect::from_origin_size(corner, size).inflate(DOT_PX, DOT_PX)
}

/// A rejected candidate's box, in whole pixels.
fn bounds(rejected: &Rejected) -> Rect {
    let (at, half) = (rejected.center, rejected.half_box_px);
    Rect::new(at.u - half.0, at.v - half.1, at.u + half.0, at.v + half.1).round()
}

/// Whether the candidate passed the first test of the search; thousands in a photograph do not.
fn was_measured(reject: Reject) -> bool {
    reject > Reject::Chord
}

#[cfg(test)]
mod tests {
    use roundel_core::marker::{Code, CodeReading};

    use super::*;

    fn ring(u: f64, v: f64, size_px: f64) -> Ring {
        let center = PixelPoint { u, v };
        let outer =
            Rim { center, semi_major_px: size_px, semi_minor_px: size_px / 2.0, angle_rad: 0.0 };
        let inner = Rim { semi_major_px: size_px / 2.0, semi_minor_px: size_px / 4.0, ..outer };
        Ring::of_rims(outer, inner)
    }

    fn color(overlay: &Overlay, u: usize, v: usize) -> [u8; 3] {
        let place = 4 * (v * 64 + u);
        [overlay.rgba[place], overlay.rgba[place + 1], overlay.rgba[place + 2]]
    }

    #[test]
    fn rims_and_centre_stand_where_they_are() {
        let mut overlay = Overlay::new(64, 48, &[90; 64 * 48]);
        overlay.draw_ring(&ring(20.0, 24.0, 10.0), None);
        assert_eq!(color(&overlay, 30, 24), GREEN);
        assert_eq!(color(&overlay, 20, 29), GREEN);
        assert_eq!(color(&overlay, 15, 24), CYAN);
        assert_eq!(color(&overlay, 20, 24), RED);
        assert_eq!(color(&overlay, 40, 24), [90; 3]);
    }

    #[test]
    fn the_code_is_above_the_track_number() {
        let ring = Ring { code: Some(reading(7)), ..ring(10.0, 24.0, 8.0) };
        let mut overlay = Overlay::new(64, 48, &[90; 64 * 48]);
        overlay.draw_ring(&ring, Some(TrackNumber(3)));
        let rows_with = |wanted| -> Vec<usize> {
            (0..48).filter(|&v| (22..40).any(|u| color(&overlay, u, v) == wanted)).collect()
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
    fn polygons_are_closed_and_clipped() {
        let mut overlay = Overlay::new(64, 48, &[90; 64 * 48]);
        let corners = [(10.0, 10.0), (1e9, 10.0), (10.0, 40.0)].map(|(u, v)| PixelPoint { u, v });
        overlay.draw_polygon(&corners);
        for (u, v) in [(10, 10), (63, 10), (10, 40), (10, 25), (63, 40)] {
            assert_eq!(color(&overlay, u, v), MAGENTA, "{u} {v}");
        }
        assert_eq!(color(&overlay, 30, 25), [90; 3]);
        overlay.draw_polygon(&[]);
        overlay.draw_polygon(&[PixelPoint { u: f64::NAN, v: 1.0 }, corners[0], corners[1]]);
    }

    #[test]
    fn shapes_outside_the_picture_are_skipped() {
        let mut overlay = Overlay::new(64, 48, &[90; 64 * 48]);
        for (u, v, size_px) in
            [(-5.0, 60.0, 12.0), (1e300, 0.0, 5.0), (3.0, 3.0, f64::NAN), (0.0, 0.0, 1e9)]
        {
            overlay.draw_ring(&ring(u, v, size_px), Some(TrackNumber(u64::MAX)));
        }
        assert_eq!(overlay.rgb().len(), 3 * 64 * 48);
    }

    #[test]
    fn rejected_candidates_have_boxes_and_reasons_that_do_not_overlap() {
        let rejected = |u, reject| {
            let center = PixelPoint { u, v: 30.0 };
            Rejected { center, half_box_px: (6.0, 5.0), reject }
        };
        let mut overlay = Overlay::new(64, 48, &[90; 64 * 48]);
        let both = [rejected(20.0, Reject::Tilt), rejected(23.0, Reject::Similarity)];
        overlay.draw_rejected(&[both[0], both[1], rejected(50.0, Reject::Chord)]);
        assert_eq!(color(&overlay, 14, 30), ORANGE);
        assert_eq!(color(&overlay, 26, 35), ORANGE);
        assert_eq!(color(&overlay, 56, 30), DIM);
        assert_eq!(color(&overlay, 22, 30), [90; 3]);
        // Only the later reason is drawn, beginning at its box; the earlier one would overlap.
        let columns: Vec<usize> =
            (0..64).filter(|&u| (8..23).any(|v| color(&overlay, u, v) == ORANGE)).collect();
        assert_eq!(columns.first(), Some(&17));
        let far = Rejected { half_box_px: (1e300, f64::NAN), ..rejected(1e300, Reject::Tilt) };
        overlay.draw_rejected(&[far, Rejected { half_box_px: (1e300, 1e300), ..far }]);
    }
}
