//! A page → PNG: grey levels by how much of a pixel is black.

use std::io::Write;

use thiserror::Error;
use tiny_skia::{FillRule, Mask, Paint, PathBuilder, PixmapMut, Rect, Stroke, Transform};

use super::{
    page::{LINE_MM, Page, Shape, TextAnchor},
    path::{Path, Step},
};
use crate::lab::drawing::glyph;

/// Resolutions that are allowed, dots an inch.
pub const DPI_LIMITS: (f64, f64) = (36.0, 2400.0);
/// Most pixels of a page: four bytes each.
const MAX_PIXELS: usize = 100_000_000;

/// Why there is no picture.
#[derive(Debug, Error)]
pub enum RasterError {
    /// Not a resolution.
    #[error("expected {} to {} dots an inch, found {found}", DPI_LIMITS.0, DPI_LIMITS.1)]
    Dpi { found: f64 },
    #[error(
        "a page of {width} x {height} pixels is more than the {MAX_PIXELS} that a picture may have: use fewer dots \
         an inch, a smaller page, or PDF"
    )]
    TooLarge {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// It could not be written.
    #[error("cannot write the picture")]
    Png(#[from] png::EncodingError),
}

/// Writes a page as an 8-bit grey PNG that knows its size.
pub fn png(page: &Page, dpi: f64, out: impl Write) -> Result<(), RasterError> {
    if !(DPI_LIMITS.0..=DPI_LIMITS.1).contains(&dpi) {
        return Err(RasterError::Dpi { found: dpi });
    }
    let scale = dpi / 25.4;
    let pixels = |side_mm: f64| (side_mm * scale).round() as usize;
    let (width, height) = (pixels(page.size.width_mm), pixels(page.size.height_mm));
    if width * height > MAX_PIXELS {
        return Err(RasterError::TooLarge { width, height });
    }
    let grey = greys(page, scale, width, height).ok_or(RasterError::TooLarge { width, height })?;
    let mut encoder = png::Encoder::new(out, width as u32, height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    let per_metre = (dpi / 0.0254).round() as u32;
    encoder.set_pixel_dims(Some(png::PixelDimensions {
        xppu: per_metre,
        yppu: per_metre,
        unit: png::Unit::Meter,
    }));
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&grey)?;
    writer.finish()?;
    Ok(())
}

/// `None` if there is no such picture; its size was checked, so it is not empty.
fn greys(page: &Page, scale: f64, width: usize, height: usize) -> Option<Vec<u8>> {
    let mut data = vec![255; 4 * width * height];
    let mut pixmap = PixmapMut::from_bytes(&mut data, width as u32, height as u32)?;
    let transform = Transform::from_scale(scale as f32, scale as f32);
    let mut window = Path::default();
    window.add_rectangle(&page.window);
    let mut mask = Mask::new(width as u32, height as u32)?;
    mask.fill_path(&outline(&window)?, FillRule::Winding, true, transform);
    let paint = Paint { anti_alias: true, ..Paint::default() };
    for print in &page.prints {
        pixmap.fill_path(&outline(print)?, &paint, FillRule::EvenOdd, transform, Some(&mask));
    }
    let stroke = Stroke { width: LINE_MM as f32, ..Stroke::default() };
    for mark in &page.marks {
        match mark {
            Shape::Line { from, to } => {
                let mut line = PathBuilder::new();
                line.move_to(from.x as f32, from.y as f32);
                line.line_to(to.x as f32, to.y as f32);
                pixmap.stroke_path(&line.finish()?, &paint, &stroke, transform, None);
            }
            Shape::Text { .. } => {
                for dot in dots(mark) {
                    pixmap.fill_rect(dot, &paint, transform, None);
                }
            }
        }
    }
    Some(data.chunks_exact(4).map(|rgba| rgba[0]).collect())
}

fn dots(mark: &Shape) -> Vec<Rect> {
    let Shape::Text { at, anchor, height_mm, text } = mark else { return Vec::new() };
    let dot = height_mm / glyph::ROWS as f64;
    let advance = (glyph::COLUMNS + 1) as f64 * dot;
    let width = text.chars().count() as f64 * advance;
    let left = at.x
        - match anchor {
            TextAnchor::Begin => 0.0,
            TextAnchor::Middle => width / 2.0,
            TextAnchor::End => width,
        };
    let mut dots = Vec::new();
    for (index, character) in text.chars().enumerate() {
        for (row, bits) in glyph::rows(character).into_iter().enumerate() {
            for column in 0..glyph::COLUMNS {
                if bits >> (glyph::COLUMNS - 1 - column) & 1 == 1 {
                    let x = left + index as f64 * advance + column as f64 * dot;
                    let y = at.y - height_mm + row as f64 * dot;
                    let (x, y, side) = (x as f32, y as f32, dot as f32);
                    dots.extend(Rect::from_xywh(x, y, side, side));
                }
            }
        }
    }
    dots
}

fn outline(path: &Path) -> Option<tiny_skia::Path> {
    let mut builder = PathBuilder::new();
    for step in &path.steps {
        match *step {
            Step::Move(to) => builder.move_to(to.x as f32, to.y as f32),
            Step::Line(to) => builder.line_to(to.x as f32, to.y as f32),
            Step::Cubic(one, other, to) => builder.cubic_to(
                one.x as f32,
                one.y as f32,
                other.x as f32,
                other.y as f32,
                to.x as f32,
                to.y as f32,
            ),
            Step::Close => builder.close(),
        }
    }
    builder.finish()
}
