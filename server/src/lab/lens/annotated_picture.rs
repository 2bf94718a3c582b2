//! The newest picture of a lens calibration, with the rings that were found in it.

use jpeg_encoder::{ColorType, Encoder, EncodingError};
use roundel_core::{frame::Frame, marker::Ring};

use crate::lab::drawing::Canvas;

const QUALITY: u8 = 80;

/// A picture that was looked at.
#[derive(Clone, Debug)]
pub struct AnnotatedPicture {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
    rings: Vec<Ring>,
}

impl AnnotatedPicture {
    /// A copy of a frame, and what was found in it.
    pub(super) fn of(frame: &Frame<'_>, rings: &[Ring]) -> Self {
        let (width, height) = (frame.width(), frame.height());
        let mut pixels = Vec::with_capacity(width * height);
        (0..height).for_each(|row| pixels.extend_from_slice(frame.row(row)));
        Self { width, height, pixels, rings: rings.to_vec() }
    }

    pub fn jpeg(&self) -> Result<Vec<u8>, EncodingError> {
        let mut canvas = Canvas::of(self.width, self.height, &self.pixels);
        for ring in &self.rings {
            canvas.draw_ring(ring, None);
        }
        let mut jpeg = Vec::with_capacity(self.pixels.len() / 4);
        // Sides of frames are far below.
        let side = |side: usize| u16::try_from(side).unwrap_or(u16::MAX);
        Encoder::new(&mut jpeg, QUALITY).encode(
            canvas.rgb(),
            side(self.width),
            side(self.height),
            ColorType::Rgb,
        )?;
        Ok(jpeg)
    }
}
