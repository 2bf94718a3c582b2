//! From light to the picture that a camera delivers: noise, saturation, sharpening, JPEG.
//!
//! Noise has variance a + b · level: a of the electronics, b of the light's photons. The sensor saturates at 255. Then
//! an unsharp mask adds the difference from a blurred copy, as webcams do, and the picture is compressed.

use jpeg_encoder::{ColorType, Encoder};
use zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};
use zune_jpeg::JpegDecoder;

use crate::random::Random;

/// None of it by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Processing {
    /// Variance of the noise for each grey level, besides that of [`crate::render::Imaging::noise`].
    pub photon_noise: f64,
    /// Strength of the unsharp mask; 1 doubles the contrast of details.
    pub sharpening: f64,
    /// JPEG quality, 1 to 100.
    pub jpeg_quality: Option<u8>,
}

impl Processing {
    /// The picture of this width for grey levels with noise of this deviation.
    pub fn apply(&self, grey: &[f32], width: usize, noise: f64, random: &mut Random) -> Vec<u8> {
        let measured = |grey: &f32| {
            let variance = noise * noise + self.photon_noise * f64::from(*grey).max(0.0);
            (grey + variance.sqrt() as f32 * random.normal()).clamp(0.0, 255.0)
        };
        let mut levels: Vec<f32> = grey.iter().map(measured).collect();
        if self.sharpening != 0.0 {
            let blurred = blurred(&levels, width);
            for (level, blurred) in levels.iter_mut().zip(blurred) {
                *level += self.sharpening as f32 * (*level - blurred);
            }
        }
        let pixels: Vec<u8> =
            levels.iter().map(|level| level.round().clamp(0.0, 255.0) as u8).collect();
        match self.jpeg_quality {
            Some(quality) => compressed(&pixels, width, quality),
            None => pixels,
        }
    }
}

/// Convolved with [1 4 6 4 1]/16 along rows and columns, of deviation 1 px. Pixels beyond the border repeat it.
fn blurred(levels: &[f32], width: usize) -> Vec<f32> {
    const WEIGHTS: [f32; 5] = [0.0625, 0.25, 0.375, 0.25, 0.0625];
    let height = levels.len() / width;
    let near = |at: usize, tap: usize, count: usize| (at + tap).saturating_sub(2).min(count - 1);
    let sum =
        |value: &dyn Fn(usize) -> f32| (0..5).map(|tap| WEIGHTS[tap] * value(tap)).sum::<f32>();
    let places = || (0..height).flat_map(move |row| (0..width).map(move |column| (row, column)));
    let along_rows: Vec<f32> = places()
        .map(|(row, column)| sum(&|tap| levels[row * width + near(column, tap, width)]))
        .collect();
    places()
        .map(|(row, column)| sum(&|tap| along_rows[near(row, tap, height) * width + column]))
        .collect()
}

fn compressed(pixels: &[u8], width: usize, quality: u8) -> Vec<u8> {
    let height = pixels.len() / width;
    let mut bytes = Vec::new();
    Encoder::new(&mut bytes, quality)
        .encode(pixels, width as u16, height as u16, ColorType::Luma)
        .expect("a picture of less than 65,536 columns and rows");
    let options = DecoderOptions::default().jpeg_set_out_colorspace(ColorSpace::Luma);
    JpegDecoder::new_with_options(ZCursor::new(bytes), options)
        .decode()
        .expect("the picture that was encoded")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_grows_with_the_level() {
        let processing = Processing { photon_noise: 0.2, ..Processing::default() };
        for (level, expected) in [(40.0, 9.0 + 8.0), (200.0, 9.0 + 40.0)] {
            let grey = vec![level; 100_000];
            let pixels = processing.apply(&grey, 100, 3.0, &mut Random::new(1, 1));
            let squares = pixels.iter().map(|&pixel| (f64::from(pixel) - f64::from(level)).powi(2));
            let variance = squares.sum::<f64>() / grey.len() as f64;
            // Rounding adds 1/12.
            assert!((variance / (expected + 1.0 / 12.0) - 1.0).abs() < 0.03, "{level} {variance}");
        }
    }

    #[test]
    fn sharpening_overshoots_at_edges_only() {
        let row: Vec<f32> = [[50.0; 10], [150.0; 10]].concat();
        let grey = row.repeat(20);
        let processing = Processing { sharpening: 1.0, ..Processing::default() };
        let pixels = processing.apply(&grey, 20, 0.0, &mut Random::new(1, 1));
        let middle = &pixels[200..220];
        // The blurred edge is 100/16 · (5, 1) away on its dark side, and the same on the other.
        assert_eq!(&middle[7..13], [50, 44, 19, 181, 156, 150]);
        assert_eq!((middle[0], middle[19]), (50, 150));
    }

    #[test]
    fn compression_changes_little_and_not_nothing() {
        let grey: Vec<f32> = (0..64 * 48).map(|i| 60.0 + 120.0 * ((i / 9) % 2) as f32).collect();
        let pixels = |jpeg_quality| {
            let processing = Processing { jpeg_quality, ..Processing::default() };
            processing.apply(&grey, 64, 0.0, &mut Random::new(1, 1))
        };
        let (plain, fine, coarse) = (pixels(None), pixels(Some(95)), pixels(Some(30)));
        let rms = |other: &[u8]| {
            let square = |(a, b): (&u8, &u8)| (f64::from(*a) - f64::from(*b)).powi(2);
            (plain.iter().zip(other).map(square).sum::<f64>() / plain.len() as f64).sqrt()
        };
        assert!(rms(&fine) > 0.1 && rms(&fine) < 6.0, "{}", rms(&fine));
        assert!(rms(&coarse) > 1.5 * rms(&fine), "{}", rms(&coarse));
    }
}
