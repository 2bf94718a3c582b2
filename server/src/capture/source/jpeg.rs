//! JPEG → 8-bit grey. Only the luma is decoded; of the chroma only the Huffman codes are read.
//!
//! Decoding is strict: a truncated picture is an error, not one with a grey end.

use std::io::Cursor;

use roundel_core::frame::{Frame, MAX_SIDE_PX};
use zune_core::{colorspace::ColorSpace, options::DecoderOptions};
use zune_jpeg::JpegDecoder;

use super::{SourceError, bad_frame, wrong_size};

/// A source that gives this many broken pictures in a row fails.
const MAX_BROKEN: u64 = 50;

/// Why a picture cannot be used.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum JpegError {
    /// The next one may be whole.
    Broken(String),
    /// It has another size (columns, rows), as the next one will have.
    Size(usize, usize),
}

/// A decoder that reuses its buffer.
#[derive(Debug)]
pub(super) struct LumaDecoder {
    size: (usize, usize),
    pixels: Vec<u8>,
    broken_in_a_row: u64,
}

impl LumaDecoder {
    /// A decoder for pictures of `size` (columns, rows).
    pub(super) fn new(size: (usize, usize)) -> Self {
        Self { size, pixels: Vec::new(), broken_in_a_row: 0 }
    }

    /// Whether a picture is whole. A picture of another size is an error, and so are [`MAX_BROKEN`] broken ones in a
    /// row; `what` names the picture or its source.
    pub(super) fn accept(
        &mut self,
        picture: Result<(), JpegError>,
        what: impl FnOnce() -> String,
    ) -> Result<bool, SourceError> {
        match picture {
            Ok(()) => self.broken_in_a_row = 0,
            Err(JpegError::Size(width, height)) => {
                return Err(wrong_size(&what(), self.size, (width, height)));
            }
            Err(JpegError::Broken(reason)) => {
                self.broken_in_a_row += 1;
                if self.broken_in_a_row > MAX_BROKEN {
                    return Err(SourceError::Failed(format!(
                        "{}: {MAX_BROKEN} pictures in a row are broken: {reason}",
                        what()
                    )));
                }
            }
        }
        Ok(self.broken_in_a_row == 0)
    }

    /// Decodes a picture and replaces the one before.
    pub(super) fn decode(&mut self, bytes: &[u8]) -> Result<(), JpegError> {
        let broken = |error: &dyn std::fmt::Display| JpegError::Broken(error.to_string());
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
            return Err(JpegError::Size(found.0, found.1));
        }
        let length = found.0 * found.1;
        if decoder.output_buffer_size() != Some(length) {
            return Err(broken(&"its colours are not YCbCr or grey"));
        }
        self.pixels.resize(length, 0);
        decoder.decode_into(&mut self.pixels).map_err(|error| broken(&error))
    }

    /// The pixels of the last picture, row by row.
    pub(super) fn into_pixels(self) -> Vec<u8> {
        self.pixels
    }

    /// The last picture; an error if there is none.
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
            assert!(matches!(found, Err(JpegError::Broken(_))), "{cut}: {found:?}");
        }
        assert_eq!(LumaDecoder::new((64, 47)).decode(&jpeg), Err(JpegError::Size(64, 48)));
        assert!(LumaDecoder::new((64, 48)).frame().is_err());
    }
}
