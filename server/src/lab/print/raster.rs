//! A page as PNG: grey levels by how much of a pixel is black.

use std::io::Write;

use thiserror::Error;

use super::page::Page;

/// Resolutions that are allowed, dots an inch.
pub const DPI_LIMITS: (f64, f64) = (36.0, 2400.0);
/// Most pixels of a page: four bytes each.
const MAX_PIXELS: usize = 100_000_000;

/// Why there is no picture.
#[derive(Debug, Error)]
pub enum RasterError {
    /// Not a resolution.
    #[error("expected {} to {} dots an inch, found {found}", DPI_LIMITS.0, DPI_LIMITS.1)]
    Dpi {
        /// As asked for.
        found: f64,
    },
    /// Too large a picture.
    #[error(
        "a page of {width} x {height} pixels is more than the {MAX_PIXELS} that a picture may have: use fewer dots \
         an inch, a smaller page, or PDF"
    )]
    TooLarge { width: usize, height: usize },
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
    let rgba = page.drawing().rgba(scale, width, height);
    let rgba = rgba.ok_or(RasterError::TooLarge { width, height })?;
    let grey: Vec<u8> = rgba.chunks_exact(4).map(|pixel| pixel[0]).collect();
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
