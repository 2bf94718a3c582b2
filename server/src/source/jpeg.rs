//! JPEG → 8-bit grey. Only the luma is decoded; chroma is skipped bit by bit, which is the least that its
//! Huffman codes allow.
//!
//! Strict: a picture that lost bytes on its way must not pass as one with a grey end.

use std::io::Cursor;

use roundel_core::frame::{Frame, MAX_SIDE_PX};
use zune_core::{colorspace::ColorSpace, options::DecoderOptions};
use zune_jpeg::JpegDecoder;

use super::bad_frame;
use crate::source::SourceError;

/// Why bytes give no picture.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum JpegFault {
    /// It is broken: the next one may be whole.
    Broken(String),
    /// It is of another size (columns, rows): so will be the next one.
    Size(usize, usize),
}

/// A decoder that keeps its buffer.
#[derive(Debug)]
pub(super) struct LumaDecoder {
    size: (usize, usize),
    pixels: Vec<u8>,
}

impl LumaDecoder {
    /// For pictures of so many columns and rows.
    pub(super) fn new(size: (usize, usize)) -> Self {
        Self { size, pixels: Vec::new() }
    }

    /// Decodes a picture; what was decoded before is gone.
    pub(super) fn decode(&mut self, bytes: &[u8]) -> Result<(), JpegFault> {
        let broken = |error: &dyn std::fmt::Display| JpegFault::Broken(error.to_string());
        let options = DecoderOptions::default()
            .set_max_width(MAX_SIDE_PX)
            .set_max_height(MAX_SIDE_PX)
            .set_strict_mode(true)
            .jpeg_set_out_colorspace(ColorSpace::Luma);
        let mut decoder = JpegDecoder::new_with_options(Cursor::new(bytes), options);
        decoder.decode_headers().map_err(|error| broken(&error))?;
        let info = decoder.info().ok_or_else(|| broken(&"no image header"))?;
        let found = (usize::from(info.width), usize::from(info.height));
        if found != self.size {
            return Err(JpegFault::Size(found.0, found.1));
        }
        let length = found.0 * found.1;
        if decoder.output_buffer_size() != Some(length) {
            return Err(broken(&"its colours are not YCbCr or grey"));
        }
        self.pixels.resize(length, 0);
        decoder.decode_into(&mut self.pixels).map_err(|error| broken(&error))
    }

    /// What was decoded last, row by row.
    pub(super) fn into_pixels(self) -> Vec<u8> {
        self.pixels
    }

    /// What was decoded last; before that, an error.
    pub(super) fn frame(&self) -> Result<Frame<'_>, SourceError> {
        let (width, height) = self.size;
        Frame::new(&self.pixels, width, height, width).map_err(bad_frame)
    }
}

#[cfg(test)]
mod tests {
    use jpeg_encoder::{ColorType, Encoder, SamplingFactor};

    use super::*;

    /// A slope of grey under a slope of colour.
    fn picture(size: (u16, u16), sampling: SamplingFactor) -> (Vec<u8>, Vec<u8>) {
        let (mut rgb, mut luma) = (Vec::new(), Vec::new());
        for v in 0..size.1 {
            for u in 0..size.0 {
                let colour = [u, v, (u + v) / 2].map(|level| (level * 3 % 200 + 20) as u8);
                rgb.extend(colour);
                let [r, g, b] = colour.map(f64::from);
                luma.push((0.299 * r + 0.587 * g + 0.114 * b).round() as u8);
            }
        }
        let mut jpeg = Vec::new();
        let mut encoder = Encoder::new(&mut jpeg, 95);
        encoder.set_sampling_factor(sampling);
        encoder.encode(&rgb, size.0, size.1, ColorType::Rgb).unwrap();
        (jpeg, luma)
    }

    #[test]
    fn luma_comes_out_of_every_sampling() {
        for sampling in [SamplingFactor::F_1_1, SamplingFactor::F_2_1, SamplingFactor::F_2_2] {
            let (jpeg, luma) = picture((50, 38), sampling);
            let mut decoder = LumaDecoder::new((50, 38));
            decoder.decode(&jpeg).unwrap();
            let frame = decoder.frame().unwrap();
            let found = (0..38).flat_map(|v| frame.row(v).to_vec());
            let worst = found.zip(&luma).map(|(a, b)| a.abs_diff(*b)).max();
            assert!(worst <= Some(12), "{sampling:?}: {worst:?}");
        }
    }

    #[test]
    fn what_was_cut_or_damaged_is_broken_and_another_size_is_told() {
        let (jpeg, _) = picture((64, 48), SamplingFactor::F_2_2);
        let mut decoder = LumaDecoder::new((64, 48));
        assert_eq!(decoder.decode(&jpeg), Ok(()));
        for cut in [3, jpeg.len() / 4, jpeg.len() - 40] {
            let found = decoder.decode(&jpeg[..cut]);
            assert!(matches!(found, Err(JpegFault::Broken(_))), "{cut}: {found:?}");
        }
        assert_eq!(LumaDecoder::new((64, 47)).decode(&jpeg), Err(JpegFault::Size(64, 48)));
        assert!(LumaDecoder::new((64, 48)).frame().is_err());
    }
}
