//! A picture that a remote program sends.

use crate::capture::source::jpeg::{JpegError, LumaDecoder};

#[derive(Debug)]
pub enum SentPicture {
    Jpeg(Vec<u8>),
    /// 8-bit grey without gaps; columns and rows.
    Grey(Vec<u8>, (usize, usize)),
}

impl SentPicture {
    /// Decodes it, or moves its pixels, into the decoder.
    pub(super) fn decode(self, decoder: &mut LumaDecoder) -> Result<(), JpegError> {
        match self {
            Self::Jpeg(file) => decoder.decode(&file),
            Self::Grey(pixels, size) => decoder.replace(pixels, size),
        }
    }

    /// Its grey levels, row by row, or why there are none. It must have the size of the camera's calibration, because
    /// detections are drawn into it.
    pub fn pixels(self, size: (usize, usize)) -> Result<Vec<u8>, String> {
        let mut decoder = LumaDecoder::new(size);
        match self.decode(&mut decoder) {
            Ok(()) => Ok(decoder.into_pixels()),
            Err(JpegError::Size((width, height))) => Err(format!(
                "its picture has {width} x {height} pixels, and the camera file says {} x {}",
                size.0, size.1
            )),
            Err(JpegError::Broken(reason)) => Err(format!("its picture is broken: {reason}")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_whole_picture_of_the_right_size_has_pixels() {
        let grey = |pixels: usize, size| SentPicture::Grey(vec![7; pixels], size);
        let mut file = Vec::new();
        let encoder = jpeg_encoder::Encoder::new(&mut file, 90);
        encoder.encode(&[99; 8], 4, 2, jpeg_encoder::ColorType::Luma).unwrap();
        let jpeg = |length: usize| SentPicture::Jpeg(file[..length].to_vec());

        assert_eq!(grey(8, (4, 2)).pixels((4, 2)), Ok(vec![7; 8]));
        let pixels = jpeg(file.len()).pixels((4, 2)).unwrap();
        assert!(pixels.len() == 8 && pixels.iter().all(|level| level.abs_diff(99) < 4));
        for (picture, size, expected) in [
            (grey(8, (2, 4)), (4, 2), "has 2 x 4 pixels, and the camera file says 4 x 2"),
            (grey(7, (4, 2)), (4, 2), "broken: expected 8 pixels for 4 x 2, found 7"),
            (jpeg(file.len()), (8, 2), "has 4 x 2 pixels"),
            (jpeg(20), (4, 2), "is broken"),
        ] {
            let error = picture.pixels(size).unwrap_err();
            assert!(error.contains(expected), "{error} lacks {expected}");
        }
    }
}
