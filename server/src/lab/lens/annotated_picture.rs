//! The newest picture of a lens calibration with the rings found in it; drawn only when a client asks for it.

use jpeg_encoder::EncodingError;
use roundel_core::{frame::Frame, marker::Ring};

use crate::lab::drawing::Overlay;

#[derive(Clone, Debug)]
pub struct AnnotatedPicture {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
    rings: Vec<Ring>,
}

impl AnnotatedPicture {
    pub(super) fn of(frame: &Frame<'_>, rings: &[Ring]) -> Self {
        let (width, height) = (frame.width(), frame.height());
        let mut pixels = Vec::with_capacity(width * height);
        (0..height).for_each(|row| pixels.extend_from_slice(frame.row(row)));
        Self { width, height, pixels, rings: rings.to_vec() }
    }

    pub fn pixel_count(&self) -> usize {
        self.pixels.len()
    }

    pub fn jpeg(&self) -> Result<Vec<u8>, EncodingError> {
        let mut overlay = Overlay::new(self.width, self.height, &self.pixels);
        for ring in &self.rings {
            overlay.draw_ring(ring, None);
        }
        overlay.jpeg()
    }
}
