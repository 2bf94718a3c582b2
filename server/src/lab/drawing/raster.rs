//! Paints drawings as pixels.

use std::ops::Range;

use kurbo::{BezPath, PathEl, Shape as _};
use tiny_skia::{FillRule, LineCap, Mask, Paint, Path, PathBuilder, PixmapMut, Stroke, Transform};

use super::{Color, Drawing, Shape, TOLERANCE, glyph};

impl Drawing {
    /// Red, green, blue and opacity of each pixel of these rows, at `scale` pixels per unit; `None` if there are none or too
    /// many.
    pub(crate) fn rgba(&self, scale: f64, width: usize, rows: Range<usize>) -> Option<Vec<u8>> {
        let mut data = vec![255; 4 * width * rows.len()];
        let mut pixmap = PixmapMut::from_bytes(&mut data, width as u32, rows.len() as u32)?;
        let scaled = Transform::from_scale(scale as f32, scale as f32);
        let transform = scaled.post_translate(0.0, -(rows.start as f32));
        for shape in &self.shapes {
            paint(&mut pixmap, shape, transform, true);
        }
        Some(data)
    }
}

/// Paints a shape; parts that are outside or not finite are skipped.
pub(super) fn paint(
    pixmap: &mut PixmapMut<'_>,
    shape: &Shape,
    transform: Transform,
    anti_alias: bool,
) {
    let ink = |[red, green, blue]: Color| {
        let mut paint = Paint { anti_alias, ..Paint::default() };
        paint.set_color_rgba8(red, green, blue, 255);
        paint
    };
    let size = (pixmap.width(), pixmap.height());
    let mut fill = |area: &BezPath, color: Color, mask: Option<&Mask>| {
        if let Some(area) = path(area) {
            pixmap.fill_path(&area, &ink(color), FillRule::EvenOdd, transform, mask);
        }
    };
    match shape {
        Shape::Fill { path, color } => fill(path, *color, None),
        Shape::Text { at, anchor, height, text, color } => {
            fill(&glyph::outline(text, *at, *anchor, *height), *color, None);
        }
        Shape::Clipped { window, paths } => {
            let mask = Mask::new(size.0, size.1);
            let window = path(&window.to_path(TOLERANCE));
            let (Some(mut mask), Some(window)) = (mask, window) else { return };
            mask.fill_path(&window, FillRule::EvenOdd, true, transform);
            for area in paths {
                fill(area, super::BLACK, Some(&mask));
            }
        }
        Shape::Line { path: line, width, color } => {
            // Without this cap a hairline lacks its last pixel.
            let line_cap = if *width == 0.0 { LineCap::Square } else { LineCap::Butt };
            let stroke = Stroke { width: *width as f32, line_cap, ..Stroke::default() };
            if let Some(line) = path(line) {
                pixmap.stroke_path(&line, &ink(*color), &stroke, transform, None);
            }
        }
    }
}

fn path(path: &BezPath) -> Option<Path> {
    let mut builder = PathBuilder::new();
    for element in path {
        match element {
            PathEl::MoveTo(to) => builder.move_to(to.x as f32, to.y as f32),
            PathEl::LineTo(to) => builder.line_to(to.x as f32, to.y as f32),
            PathEl::QuadTo(..) => unreachable!("paths consist of lines and cubic curves"),
            PathEl::CurveTo(p, q, to) => {
                let [px, py, qx, qy] = [p.x, p.y, q.x, q.y].map(|it| it as f32);
                builder.cubic_to(px, py, qx, qy, to.x as f32, to.y as f32)
            }
            PathEl::ClosePath => builder.close(),
        }
    }
    builder.finish()
}
