//! Reads PNG and JPEG files as grey pixels.

use std::path::Path;

use roundel_core::frame::Frame;
use zune_core::{colorspace::ColorSpace, options::DecoderOptions};

/// Grey pixels, row by row.
pub struct Picture {
    pixels: Vec<u8>,
    width: usize,
    height: usize,
}

impl Picture {
    /// Reads a file by its extension. Panics with its name if that fails.
    pub fn read(path: &Path) -> Self {
        let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let png = path.extension().is_some_and(|extension| extension == "png");
        if png { Self::from_png(&bytes) } else { Self::from_jpeg(bytes) }
    }

    /// The pixels as a frame.
    pub fn frame(&self) -> Frame<'_> {
        Frame::new(&self.pixels, self.width, self.height, self.width).unwrap()
    }

    fn from_png(bytes: &[u8]) -> Self {
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut data = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut data).unwrap();
        let samples = info.color_type.samples();
        // Luma of ITU-R BT.601, as JPEG has it.
        let luma = |p: &[u8]| match p {
            [r, g, b, ..] => {
                let sum = 299 * u32::from(*r) + 587 * u32::from(*g) + 114 * u32::from(*b);
                ((sum + 500) / 1000) as u8
            }
            _ => p[0],
        };
        let pixels = data[..info.buffer_size()].chunks_exact(samples).map(luma).collect();
        Self { pixels, width: info.width as usize, height: info.height as usize }
    }

    fn from_jpeg(bytes: Vec<u8>) -> Self {
        let options = DecoderOptions::default().jpeg_set_out_colorspace(ColorSpace::Luma);
        let cursor = zune_core::bytestream::ZCursor::new(bytes);
        let mut decoder = zune_jpeg::JpegDecoder::new_with_options(cursor, options);
        let pixels = decoder.decode().unwrap();
        let (width, height) = decoder.dimensions().unwrap();
        Self { pixels, width, height }
    }
}
