//! A picture that a sender of detections gives for people to look at.

use crate::capture::source::jpeg::{JpegError, LumaDecoder};

#[derive(Debug)]
pub enum StillImage {
    Jpeg(Vec<u8>),
    /// 8-bit grey without gaps; columns and rows.
    Grey(Vec<u8>, (usize, usize)),
}

impl StillImage {
    /// Its grey levels, row by row; or why there are none. It has to be of the size of the camera's calibration, since
    /// what was seen in it is drawn in.
    pub fn pixels(self, size: (usize, usize)) -> Result<Vec<u8>, String> {
        let other = |width: usize, height: usize| {
            format!(
                "its picture has {width} x {height} pixels, and the camera file says {} x {}",
                size.0, size.1
            )
        };
        match self {
            Self::Jpeg(file) => {
                let mut decoder = LumaDecoder::new(size);
                match decoder.decode(&file) {
                    Ok(()) => Ok(decoder.into_pixels()),
                    Err(JpegError::Size(width, height)) => Err(other(width, height)),
                    Err(JpegError::Broken(reason)) => {
                        Err(format!("its picture is broken: {reason}"))
                    }
                }
            }
            Self::Grey(_, found) if found != size => Err(other(found.0, found.1)),
            Self::Grey(pixels, _) if pixels.len() == size.0 * size.1 => Ok(pixels),
            Self::Grey(pixels, (width, height)) => {
                let found = pixels.len();
                Err(format!("its picture is broken: {found} pixels for {width} x {height}"))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_whole_picture_of_the_right_size_is_one() {
        let grey = |pixels: usize, size| StillImage::Grey(vec![7; pixels], size).pixels((4, 2));
        assert_eq!(grey(8, (4, 2)), Ok(vec![7; 8]));
        assert!(
            grey(8, (2, 4))
                .unwrap_err()
                .contains("has 2 x 4 pixels, and the camera file says 4 x 2")
        );
        assert!(grey(7, (4, 2)).unwrap_err().contains("broken: 7 pixels for 4 x 2"));
        let mut file = Vec::new();
        jpeg_encoder::Encoder::new(&mut file, 90)
            .encode(&[99; 8], 4, 2, jpeg_encoder::ColorType::Luma)
            .unwrap();
        let pixels = StillImage::Jpeg(file.clone()).pixels((4, 2)).unwrap();
        assert!(
            pixels.len() == 8 && pixels.iter().all(|level| level.abs_diff(99) < 4),
            "{pixels:?}"
        );
        assert!(
            StillImage::Jpeg(file.clone()).pixels((8, 2)).unwrap_err().contains("has 4 x 2 pixels")
        );
        file.truncate(20);
        assert!(StillImage::Jpeg(file).pixels((4, 2)).unwrap_err().contains("is broken"));
    }
}
