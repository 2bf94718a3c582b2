//! A page as a PNG with antialiased grey levels. It is painted and written in bands of rows, so that a large page takes
//! little memory.

use std::io::{self, Write};

use thiserror::Error;

use super::page::Page;
use crate::model::stop::StopSignal;

/// Minimum and maximum resolution, dots per inch.
pub const DPI_LIMITS: (f64, f64) = (36.0, 2400.0);
/// Maximum number of pixels of a page.
const MAX_PIXELS: usize = 100_000_000;
/// Pixels of a band, each of which takes six bytes.
const BAND_PIXELS: usize = 2_000_000;

#[derive(Debug, Error)]
pub enum RasterError {
    #[error("expected {} to {} dots per inch, found {found}", DPI_LIMITS.0, DPI_LIMITS.1)]
    Dpi { found: f64 },
    #[error(
        "a page of {width} x {height} pixels exceeds the limit of {MAX_PIXELS} pixels: use fewer dots per inch, a \
         smaller page, or PDF"
    )]
    TooLarge { width: usize, height: usize },
    #[error("cannot write the picture")]
    Png(#[from] png::EncodingError),
    #[error("cannot write the picture")]
    Write(#[from] io::Error),
    /// The signal came.
    #[error("stopped")]
    Stopped,
}

/// Writes a page as an 8-bit grey PNG with its resolution.
pub fn png(page: &Page, dpi: f64, out: impl Write) -> Result<(), RasterError> {
    png_until(page, dpi, out, &StopSignal::default())
}

/// Like [`png`], and ends early when the signal comes.
pub fn png_until(
    page: &Page,
    dpi: f64,
    out: impl Write,
    stop: &StopSignal,
) -> Result<(), RasterError> {
    if !(DPI_LIMITS.0..=DPI_LIMITS.1).contains(&dpi) {
        return Err(RasterError::Dpi { found: dpi });
    }
    let scale = dpi / 25.4;
    let pixels = |side_mm: f64| (side_mm * scale).round() as usize;
    let (width, height) = (pixels(page.size.width_mm), pixels(page.size.height_mm));
    if width * height > MAX_PIXELS {
        return Err(RasterError::TooLarge { width, height });
    }
    let mut encoder = png::Encoder::new(out, width as u32, height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    let per_metre = (dpi / 0.0254).round() as u32;
    encoder.set_pixel_dims(Some(png::PixelDimensions {
        xppu: per_metre,
        yppu: per_metre,
        unit: png::Unit::Meter,
    }));
    let mut file = encoder.write_header()?;
    let mut writer = file.stream_writer()?;
    let (drawing, band) = (page.drawing(), (BAND_PIXELS / width).max(1));
    for top in (0..height).step_by(band) {
        if stop.is_stopped() {
            return Err(RasterError::Stopped);
        }
        let rows = top..height.min(top + band);
        let too_large = RasterError::TooLarge { width, height };
        let rgba = drawing.rgba(scale, width, rows).ok_or(too_large)?;
        let grey: Vec<u8> = rgba.chunks_exact(4).map(|pixel| pixel[0]).collect();
        writer.write_all(&grey)?;
    }
    writer.finish()?;
    file.finish()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use kurbo::{Circle, Rect, Shape as _};

    use super::*;
    use crate::lab::print::PageSize;

    fn page(width_mm: f64, height_mm: f64) -> Page {
        let size = PageSize { width_mm, height_mm };
        let window = Rect::new(5.0, 5.0, width_mm - 5.0, height_mm - 5.0);
        let prints = vec![Circle::new(window.center(), height_mm / 3.0).to_path(1e-6)];
        Page { size, window, prints, marks: Vec::new() }
    }

    fn levels(file: &[u8]) -> Vec<u8> {
        let mut reader = png::Decoder::new(io::Cursor::new(file)).read_info().unwrap();
        let mut levels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut levels).unwrap();
        levels
    }

    #[test]
    fn bands_join_without_a_seam() {
        // 2362 x 1181 pixels: two bands.
        let (page, dpi) = (page(200.0, 100.0), 300.0);
        let mut file = Vec::new();
        png(&page, dpi, &mut file).unwrap();
        let whole = page.drawing().rgba(dpi / 25.4, 2362, 0..1181).unwrap();
        let levels = levels(&file);
        assert_eq!(levels.len(), 2362 * 1181);
        let differences = levels.iter().zip(whole.chunks_exact(4));
        let differences = differences.map(|(level, pixel)| level.abs_diff(pixel[0]));
        let (worst, count) = differences.fold((0, 0), |(worst, count), difference| {
            (difference.max(worst), count + usize::from(difference > 0))
        });
        // Some of the 16 samples of a pixel on an edge are rounded differently within a band.
        assert!(worst <= 64 && count < 1000, "{count} pixels by up to {worst}");
    }

    #[test]
    fn too_many_pixels_are_rejected_and_a_signal_stops() {
        let mut file = Vec::new();
        let error = png(&page(2000.0, 2000.0), 300.0, &mut file).unwrap_err().to_string();
        assert!(error.contains("exceeds the limit of 100000000 pixels"), "{error}");
        let stop = StopSignal::default();
        stop.stop();
        let stopped = png_until(&page(50.0, 50.0), 300.0, &mut file, &stop);
        assert!(matches!(stopped, Err(RasterError::Stopped)));
    }
}
