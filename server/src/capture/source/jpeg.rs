//! JPEG → 8-bit grey. Only the luma is decoded; of the chroma only the Huffman codes are read.

use roundel_core::frame::Frame;

use super::{SourceError, bad_frame, wrong_size};
use crate::capture::image_file::jpeg_decoder;

/// A source that gives this many broken pictures in a row fails.
const MAX_BROKEN: u64 = 50;

#[derive(Debug, PartialEq, Eq)]
pub(super) enum JpegError {
    /// Damaged; later pictures may be intact.
    Broken(String),
    /// Has this size (columns, rows) instead of the expected one; later pictures will have it too.
    Size((usize, usize)),
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

    /// Whether a picture is intact. A picture of another size is an error, and so are more than [`MAX_BROKEN`] broken ones in
    /// a row; `what` names the picture or its source.
    pub(super) fn accept(
        &mut self,
        picture: Result<(), JpegError>,
        what: impl FnOnce() -> String,
    ) -> Result<bool, SourceError> {
        match picture {
            Ok(()) => self.broken_in_a_row = 0,
            Err(JpegError::Size(found)) => return Err(wrong_size(&what(), self.size, found)),
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
        let mut decoder = jpeg_decoder(bytes);
        decoder.decode_headers().map_err(|error| broken(&error))?;
        let info = decoder.info().ok_or_else(|| broken(&"no image header"))?;
        let found @ (width, height) = (usize::from(info.width), usize::from(info.height));
        if found != self.size {
            return Err(JpegError::Size(found));
        }
        if decoder.output_buffer_size() != Some(width * height) {
            return Err(broken(&"its colours are not YCbCr or grey"));
        }
        self.pixels.resize(width * height, 0);
        decoder.decode_into(&mut self.pixels).map_err(|error| broken(&error))
    }

    /// Replaces the picture by one of `size` that is grey already.
    pub(super) fn replace(
        &mut self,
        pixels: Vec<u8>,
        size @ (width, height): (usize, usize),
    ) -> Result<(), JpegError> {
        if size != self.size {
            return Err(JpegError::Size(size));
        }
        let (expected, found) = (width * height, pixels.len());
        if found != expected {
            return Err(JpegError::Broken(format!(
                "expected {expected} pixels for {width} x {height}, found {found}"
            )));
        }
        self.pixels = pixels;
        Ok(())
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
    fn truncated_pictures_are_broken_and_another_size_is_reported() {
        let (jpeg, _) = picture((64, 48), SamplingFactor::F_2_2);
        let mut decoder = LumaDecoder::new((64, 48));
        assert_eq!(decoder.decode(&jpeg), Ok(()));
        for cut in [3, jpeg.len() / 4, jpeg.len() - 40] {
            let found = decoder.decode(&jpeg[..cut]);
            assert!(matches!(found, Err(JpegError::Broken(_))), "{cut}: {found:?}");
        }
        assert_eq!(LumaDecoder::new((64, 47)).decode(&jpeg), Err(JpegError::Size((64, 48))));
        assert!(LumaDecoder::new((64, 48)).frame().is_err());
    }
}
