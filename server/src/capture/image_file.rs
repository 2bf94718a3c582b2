//! Image files → 8-bit grey: PNG, JPEG, PGM, BMP, grey or colour (colour by BT.601's luma).
//!
//! The kind is told by the first bytes, not by the name. JPEG is decoded straight to its luma,
//! without a detour over RGB. Deeper samples keep their upper eight bits' range, rounded; alpha is
//! ignored.

mod pnm;

use std::{
    fs::File,
    io::{self, Cursor, Read},
    path::{Path, PathBuf},
};

use roundel_core::frame::{Frame, FrameError, MAX_SIDE_PX};
use thiserror::Error;
use zune_core::{colorspace::ColorSpace, options::DecoderOptions};

/// Larger files are refused before they are read: the largest frame as an uncompressed 16-bit RGBA
/// image has half of this at 8 k.
const MAX_BYTES: u64 = 1 << 30;
/// By so many a video is told.
const HEAD_BYTES: u64 = 16;
/// More pixels than this are refused: a crafted header must not take all memory.
const MAX_PIXELS: usize = 1 << 27;

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct GreyImage {
    /// Columns, pixels.
    pub width: usize,
    /// Rows, pixels.
    pub height: usize,
    /// Row by row from the top, without gaps.
    pub pixels: Vec<u8>,
}

impl GreyImage {
    /// The image as the detector takes it.
    pub fn frame(&self) -> Result<Frame<'_>, FrameError> {
        Frame::new(&self.pixels, self.width, self.height, self.width)
    }
}

/// Why a file gives no image; each names the file.
#[derive(Debug, Error)]
pub enum ImageError {
    /// It cannot be read.
    #[error("{}: cannot read the image: {source}", .path.display())]
    Read { path: PathBuf, source: io::Error },
    /// It has no bytes.
    #[error("{}: expected an image, found an empty file", .path.display())]
    Empty { path: PathBuf },
    #[error("{}: expected a PNG, JPEG, PGM or BMP image, found {found}", .path.display())]
    FileFormat {
        path: PathBuf,
        /// What its first bytes look like.
        found: String,
    },
    #[error("{}: expected a PNG, JPEG, PGM or BMP image, found {found} video", .path.display())]
    Video {
        path: PathBuf,
        /// An MP4, an AVI, a Matroska.
        found: &'static str,
    },
    /// It is larger than a frame may be.
    #[error("{}: image of {found} is too large: expected at most {MAX_SIDE_PX} pixels a side and {MAX_PIXELS} in all", .path.display())]
    TooLarge {
        path: PathBuf,
        /// Its size.
        found: String,
    },
    /// It begins as an image and does not go on as one.
    #[error("{}: broken or truncated {kind} image: {reason}; save it again", .path.display())]
    Broken { path: PathBuf, kind: &'static str, reason: String },
}

/// An error before the file's name is known.
enum DecodeError {
    TooLarge(String),
    Broken(String),
}

impl<E: std::fmt::Display> From<E> for DecodeError {
    fn from(error: E) -> Self {
        Self::Broken(error.to_string())
    }
}

#[derive(Clone, Copy)]
enum FileFormat {
    Png,
    Jpeg,
    Pnm,
    Bmp,
}

impl FileFormat {
    fn name(self) -> &'static str {
        match self {
            Self::Png => "PNG",
            Self::Jpeg => "JPEG",
            Self::Pnm => "PGM",
            Self::Bmp => "BMP",
        }
    }
}

pub fn load(path: &Path) -> Result<GreyImage, ImageError> {
    let read = |source| ImageError::Read { path: path.to_owned(), source };
    let mut file = File::open(path).map_err(read)?;
    let size = file.metadata().map_err(read)?.len();
    let mut bytes = Vec::new();
    file.by_ref().take(HEAD_BYTES).read_to_end(&mut bytes).map_err(read)?;
    // A video may have any size.
    if let Some(found) = video_container(&bytes) {
        return Err(ImageError::Video { path: path.to_owned(), found });
    }
    if size > MAX_BYTES {
        let found = format!("{size} bytes");
        return Err(ImageError::TooLarge { path: path.to_owned(), found });
    }
    // A file that grows meanwhile is cut, and then found to be broken.
    file.take(MAX_BYTES).read_to_end(&mut bytes).map_err(read)?;
    decode(&bytes, path)
}

/// Decodes an image file's bytes; `path` is for messages.
pub fn decode(bytes: &[u8], path: &Path) -> Result<GreyImage, ImageError> {
    let path = || path.to_owned();
    let kind = match bytes {
        [] => return Err(ImageError::Empty { path: path() }),
        [0x89, b'P', b'N', b'G', ..] => FileFormat::Png,
        [0xFF, 0xD8, 0xFF, ..] => FileFormat::Jpeg,
        [b'P', b'2' | b'5' | b'3' | b'6', b' ' | b'\t' | b'\r' | b'\n', ..] => FileFormat::Pnm,
        [b'B', b'M', _, _, _, _, _, _, _, _, ..] => FileFormat::Bmp,
        _ => {
            return Err(match video_container(bytes) {
                Some(found) => ImageError::Video { path: path(), found },
                None => ImageError::FileFormat { path: path(), found: describe_content(bytes) },
            });
        }
    };
    let decoded = match kind {
        FileFormat::Png => png(bytes),
        FileFormat::Jpeg => jpeg(bytes),
        FileFormat::Pnm => pnm::decode(bytes),
        FileFormat::Bmp => bmp(bytes),
    };
    decoded.map_err(|fault| match fault {
        DecodeError::TooLarge(found) => ImageError::TooLarge { path: path(), found },
        DecodeError::Broken(reason) => {
            ImageError::Broken { path: path(), kind: kind.name(), reason }
        }
    })
}

/// What kind of video begins so.
fn video_container(bytes: &[u8]) -> Option<&'static str> {
    let at = |place: std::ops::Range<usize>| bytes.get(place).unwrap_or_default();
    match (at(4..8), at(8..12)) {
        // Pictures are kept in the same boxes.
        (
            b"ftyp",
            b"heic" | b"heix" | b"hevc" | b"heim" | b"heis" | b"mif1" | b"msf1" | b"avif",
        ) => None,
        (b"ftyp", b"qt  ") => Some("a QuickTime"),
        (b"ftyp", _) => Some("an MP4"),
        (_, b"AVI ") if at(0..4) == b"RIFF" => Some("an AVI"),
        _ => (at(0..4) == [0x1A, 0x45, 0xDF, 0xA3]).then_some("a Matroska"),
    }
}

fn describe_content(bytes: &[u8]) -> String {
    let known: [(&[u8], &str); 9] = [
        (b"GIF8", "a GIF image"),
        (b"II*\0", "a TIFF image"),
        (b"MM\0*", "a TIFF image"),
        (b"%PDF", "a PDF document"),
        (b"PK\x03\x04", "a ZIP archive"),
        (b"\x1F\x8B", "a gzip archive"),
        (b"<svg", "an SVG drawing"),
        (b"P4", "a PBM image"),
        (b"version https://git-lfs", "a Git LFS pointer: fetch the file itself"),
    ];
    if let Some((_, name)) = known.iter().find(|(start, _)| bytes.starts_with(start)) {
        return (*name).to_owned();
    }
    if bytes.get(4..8) == Some(b"ftyp") {
        return "a HEIF or AVIF image".to_owned();
    }
    if bytes.starts_with(b"RIFF") {
        return "a RIFF file, such as a WebP image".to_owned();
    }
    let start = &bytes[..bytes.len().min(16)];
    if start.iter().all(|byte| byte.is_ascii_graphic() || byte.is_ascii_whitespace()) {
        format!("text that begins with {:?}", String::from_utf8_lossy(start))
    } else {
        let hex: Vec<String> = start.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
        format!("bytes that begin with {}", hex.join(" "))
    }
}

fn check_size(width: usize, height: usize) -> Result<(), DecodeError> {
    if width == 0 || height == 0 {
        return Err(DecodeError::Broken(format!("its size is {width} x {height}")));
    }
    if width > MAX_SIDE_PX || height > MAX_SIDE_PX || width * height > MAX_PIXELS {
        return Err(DecodeError::TooLarge(format!("{width} x {height} pixels")));
    }
    Ok(())
}

fn png(bytes: &[u8]) -> Result<GreyImage, DecodeError> {
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    // Palettes and 1, 2, 4 bit greys become 8 bit samples; 16 bit ones stay, to be rounded here.
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info()?;
    let (width, height) = (reader.info().width as usize, reader.info().height as usize);
    check_size(width, height)?;
    let size = reader
        .output_buffer_size()
        .ok_or_else(|| DecodeError::TooLarge(format!("{width} x {height} pixels")))?;
    let mut samples = vec![0; size];
    let info = reader.next_frame(&mut samples)?;
    samples.truncate(info.buffer_size());
    if info.bit_depth == png::BitDepth::Sixteen {
        samples = samples
            .chunks_exact(2)
            .map(|pair| scale_to_u8(u16::from_be_bytes([pair[0], pair[1]]), u16::MAX))
            .collect();
    }
    let pixels = grey(samples, info.color_type.samples());
    Ok(GreyImage { width, height, pixels })
}

fn jpeg(bytes: &[u8]) -> Result<GreyImage, DecodeError> {
    let options = DecoderOptions::default()
        .set_max_width(MAX_SIDE_PX)
        .set_max_height(MAX_SIDE_PX)
        // A file that was cut must not pass as one with a grey end.
        .set_strict_mode(true)
        .jpeg_set_out_colorspace(ColorSpace::Luma);
    let mut decoder = zune_jpeg::JpegDecoder::new_with_options(Cursor::new(bytes), options);
    decoder.decode_headers()?;
    let info = decoder.info().ok_or_else(|| DecodeError::Broken("no image header".to_owned()))?;
    let (width, height) = (usize::from(info.width), usize::from(info.height));
    check_size(width, height)?;
    let samples = decoder.decode()?;
    let channels = decoder.output_colorspace().map_or(1, |space| space.num_components());
    Ok(GreyImage { width, height, pixels: grey(samples, channels) })
}

fn bmp(bytes: &[u8]) -> Result<GreyImage, DecodeError> {
    let options = DecoderOptions::default().set_max_width(MAX_SIDE_PX).set_max_height(MAX_SIDE_PX);
    let mut decoder = zune_bmp::BmpDecoder::new_with_options(Cursor::new(bytes), options);
    decoder.decode_headers().map_err(bmp_reason)?;
    let (width, height) =
        decoder.dimensions().ok_or_else(|| DecodeError::Broken("no image header".to_owned()))?;
    check_size(width, height)?;
    let samples = decoder.decode().map_err(bmp_reason)?;
    let channels = decoder.colorspace().map_or(3, |space| space.num_components());
    if samples.len() != width * height * channels {
        return Err(DecodeError::Broken(format!(
            "expected {} samples, found {}",
            width * height * channels,
            samples.len()
        )));
    }
    Ok(GreyImage { width, height, pixels: grey(samples, channels) })
}

fn bmp_reason(error: impl std::fmt::Debug) -> DecodeError {
    DecodeError::Broken(format!("{error:?}").trim().to_owned())
}

/// Samples of 1 (grey), 2 (grey, alpha), 3 (RGB) or 4 (RGB, alpha) channels → grey.
fn grey(samples: Vec<u8>, channels: usize) -> Vec<u8> {
    match channels {
        1 => samples,
        2 => samples.chunks_exact(2).map(|pixel| pixel[0]).collect(),
        _ => samples.chunks_exact(channels).map(luma).collect(),
    }
}

/// BT.601's luma, as JPEG has it, to the nearest level.
fn luma(rgb: &[u8]) -> u8 {
    let [red, green, blue] = [rgb[0], rgb[1], rgb[2]].map(u32::from);
    // At most (299 + 587 + 114) · 255 + 500 over 1000: fits.
    ((299 * red + 587 * green + 114 * blue + 500) / 1000) as u8
}

/// A sample of 0 to `most` as 0 to 255, to the nearest level; larger ones count as `most`.
fn scale_to_u8(sample: u16, most: u16) -> u8 {
    let (sample, most) = (u32::from(sample.min(most)), u32::from(most));
    ((sample * 255 + most / 2) / most) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load_bytes(bytes: &[u8]) -> Result<GreyImage, String> {
        decode(bytes, Path::new("frame")).map_err(|error| error.to_string())
    }

    fn png_file(
        size: (u32, u32),
        color: png::ColorType,
        depth: png::BitDepth,
        data: &[u8],
    ) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, size.0, size.1);
        encoder.set_color(color);
        encoder.set_depth(depth);
        if color == png::ColorType::Indexed {
            encoder.set_palette(vec![0, 0, 0, 255, 0, 0, 255, 255, 255]);
        }
        encoder.write_header().unwrap().write_image_data(data).unwrap();
        bytes
    }

    #[test]
    fn every_kind_of_png_becomes_grey() {
        use png::{BitDepth, ColorType};
        for (color, depth, data, expected) in [
            (ColorType::Grayscale, BitDepth::Eight, vec![0, 200], [0, 200]),
            (ColorType::Grayscale, BitDepth::One, vec![0b0100_0000], [0, 255]),
            (ColorType::Grayscale, BitDepth::Sixteen, vec![0x80, 0x7F, 0xFF, 0xFF], [128, 255]),
            (ColorType::GrayscaleAlpha, BitDepth::Eight, vec![9, 0, 8, 255], [9, 8]),
            (ColorType::Rgb, BitDepth::Eight, vec![255, 0, 0, 0, 255, 0], [76, 150]),
            (ColorType::Rgba, BitDepth::Eight, vec![0, 0, 255, 0, 9, 9, 9, 255], [29, 9]),
            (ColorType::Indexed, BitDepth::Eight, vec![1, 2], [76, 255]),
        ] {
            let image = load_bytes(&png_file((2, 1), color, depth, &data)).unwrap();
            assert_eq!((image.width, image.height), (2, 1));
            assert_eq!(image.pixels, expected, "{color:?} {depth:?}");
        }
    }

    /// A 2x2 BMP of 24 bits: bottom row first, blue green red, rows padded to four bytes.
    fn bmp_file() -> Vec<u8> {
        let mut bytes = b"BM".to_vec();
        for word in [70u32, 0, 54, 40, 2, 2] {
            bytes.extend(word.to_le_bytes());
        }
        bytes.extend([1, 0, 24, 0]);
        for word in [0u32, 16, 2835, 2835, 0, 0] {
            bytes.extend(word.to_le_bytes());
        }
        bytes.extend([255, 0, 0, 0, 0, 255, 0, 0]);
        bytes.extend([10, 10, 10, 0, 255, 0, 0, 0]);
        bytes
    }

    #[test]
    fn bmp_is_turned_the_right_way_up() {
        assert_eq!(load_bytes(&bmp_file()).unwrap().pixels, [10, 150, 29, 76]);
    }

    #[test]
    fn deep_samples_are_rounded_not_cut() {
        assert_eq!(scale_to_u8(0x00FF, u16::MAX), 1);
        assert_eq!(scale_to_u8(512, 1023), 128);
        assert_eq!(scale_to_u8(9, 3), 255);
    }

    #[test]
    fn what_is_no_image_is_named() {
        let good = png_file(
            (64, 64),
            png::ColorType::Grayscale,
            png::BitDepth::Eight,
            &(0..64 * 64u32)
                .map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8)
                .collect::<Vec<_>>(),
        );
        let huge =
            png_file((20_000, 1), png::ColorType::Grayscale, png::BitDepth::Eight, &[0; 20_000]);
        for (bytes, expected) in [
            (&b""[..], "frame: expected an image, found an empty file"),
            (b"GIF89a.....", "found a GIF image"),
            (b"RIFF\x01\0\0\0WEBPVP8 ", "found a RIFF file, such as a WebP image"),
            (b"RIFF\x01\0\0\0AVI LIST", "image, found an AVI video"),
            (b"\0\0\0\x20ftypisom", "image, found an MP4 video"),
            (b"\0\0\0\x20ftypheic", "found a HEIF or AVIF image"),
            (b"\0\0\0\x14ftypqt  ", "found a QuickTime video"),
            (b"\x1A\x45\xDF\xA3\x01", "found a Matroska video"),
            (b"name = \"lab\"", "found text that begins with \"name = "),
            (&[0, 1, 2, 3], "found bytes that begin with 00 01 02 03"),
            (&good[..good.len() / 2], "broken or truncated PNG"),
            (&good[..20], "broken or truncated PNG"),
            (&bmp_file()[..60], "broken or truncated BMP"),
            (&[0xFF, 0xD8, 0xFF, 0xE0, 0, 16], "broken or truncated JPEG"),
            (b"P5 4 4 255\nabc", "broken or truncated PGM"),
            (&huge, "image of 20000 x 1 pixels is too large"),
        ] {
            let error = load_bytes(bytes).expect_err(expected);
            assert!(error.contains(expected), "{error} lacks {expected}");
        }
        let missing = load(Path::new("no/such.png")).unwrap_err().to_string();
        assert!(missing.contains("no/such.png: cannot read the image"), "{missing}");
    }
}
