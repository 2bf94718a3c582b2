//! Image files → 8-bit grey: PNG, JPEG, PGM, BMP, grey or colour (colour by BT.601's luma).
//!
//! The first bytes determine the format, not the name. JPEG is decoded straight to luma. Deeper samples are scaled to
//! eight bits and rounded, samples of 16 bits from the depth in use ([`depth`]); alpha is ignored. The size in a file's header is checked before pixels are decoded, and PNG is
//! decoded row by row, since a small file may describe gigabytes of samples.

mod depth;
mod pnm;

use std::{
    io::{Cursor, Read},
    path::{Path, PathBuf},
};

pub use depth::SampleDepth;
use roundel_core::frame::{Frame, FrameError, MAX_SIDE_PX};
use thiserror::Error;
use zune_core::{colorspace::ColorSpace, options::DecoderOptions};
use zune_jpeg::JpegDecoder;

use crate::model::regular_file;

/// Larger files are rejected before they are read. 40 megapixels of uncompressed 16-bit RGB fit.
const MAX_BYTES: u64 = 1 << 28;
/// Bytes by which a video container is recognized.
const HEAD_BYTES: u64 = 16;
/// Images with more pixels are rejected: a crafted header must not take all memory.
const MAX_PIXELS: usize = 100_000_000;
/// Likewise for formats whose decoders take four to seven bytes per pixel.
const MAX_WIDE_PIXELS: usize = 40_000_000;

/// Message for users about [`SampleDepth::unscaled_bits`].
pub const UNSCALED_HINT: &str = "16-bit samples are read with fewer bits, since none is larger; a dark picture is \
     brightened by this: scale samples to 16 bits, or write an sBIT chunk, to prevent it";

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
    pub fn frame(&self) -> Result<Frame<'_>, FrameError> {
        Frame::new(&self.pixels, self.width, self.height, self.width)
    }
}

/// Why a file gives no image; each names the file.
#[derive(Debug, Error)]
pub enum ImageError {
    #[error("{}: expected a PNG, JPEG, PGM or BMP image, found {found} video", .path.display())]
    Video { path: PathBuf, found: &'static str },
    #[error("{}: {reason}", .path.display())]
    Unusable { path: PathBuf, reason: String },
    /// Columns and rows differ from those expected; not decoded.
    #[error("{}: expected another size, found {} x {} pixels", .path.display(), .found.0, .found.1)]
    Size { path: PathBuf, found: (usize, usize) },
}

/// An error of a decoder, which does not know the file's name.
enum DecodeError {
    TooLarge(String),
    Broken(String),
    Size((usize, usize)),
}

/// What callers expect of an image, and learn about it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Expectation {
    /// Columns and rows; `None`: any.
    pub size: Option<(usize, usize)>,
    /// Depth of 16-bit samples so far; updated by each image.
    pub depth: SampleDepth,
}

/// The sizes that are decoded.
#[derive(Clone, Copy)]
struct SizeCheck {
    /// Columns and rows; `None`: any.
    expected: Option<(usize, usize)>,
    max_pixels: usize,
}

impl<E: std::fmt::Display> From<E> for DecodeError {
    fn from(error: E) -> Self {
        Self::Broken(error.to_string())
    }
}

pub fn load(path: &Path) -> Result<GreyImage, ImageError> {
    load_expected(path, &mut Expectation::default())
}

/// Like [`load`]; an image of another size is an error.
pub fn load_expected(path: &Path, expected: &mut Expectation) -> Result<GreyImage, ImageError> {
    let unusable = |reason| ImageError::Unusable { path: path.to_owned(), reason };
    let read = |error| unusable(format!("cannot read the image: {error}"));
    let mut file = regular_file::open(path).map_err(read)?;
    let size = file.metadata().map_err(read)?.len();
    let mut bytes = Vec::new();
    file.by_ref().take(HEAD_BYTES).read_to_end(&mut bytes).map_err(read)?;
    // A video may have any size.
    if let Some(found) = video_container(&bytes) {
        return Err(ImageError::Video { path: path.to_owned(), found });
    }
    if size > MAX_BYTES {
        return Err(unusable(too_large(&format!("{size} bytes"))));
    }
    // A file that grows meanwhile is cut, and then found to be broken.
    file.take(MAX_BYTES).read_to_end(&mut bytes).map_err(read)?;
    decode_expected(&bytes, path, expected)
}

fn too_large(found: &str) -> String {
    format!(
        "image of {found} is too large: expected at most {MAX_SIDE_PX} pixels a side, {MAX_PIXELS} in all ({MAX_WIDE_PIXELS} \
         for BMP, progressive JPEG and PNG of 16 bits), and {MAX_BYTES} bytes"
    )
}

/// Decodes an image file's bytes; `path` is for messages.
pub fn decode(bytes: &[u8], path: &Path) -> Result<GreyImage, ImageError> {
    decode_expected(bytes, path, &mut Expectation::default())
}

fn decode_expected(
    bytes: &[u8],
    path: &Path,
    expected: &mut Expectation,
) -> Result<GreyImage, ImageError> {
    let check = SizeCheck { expected: expected.size, max_pixels: MAX_PIXELS };
    let unusable = |reason| ImageError::Unusable { path: path.to_owned(), reason };
    let (format, decoded) = match bytes {
        [] => return Err(unusable("expected an image, found an empty file".to_owned())),
        [0x89, b'P', b'N', b'G', ..] => ("PNG", png(bytes, check, &mut expected.depth)),
        [0xFF, 0xD8, 0xFF, ..] => ("JPEG", jpeg(bytes, check)),
        [b'P', b'2' | b'5' | b'3' | b'6', b' ' | b'\t' | b'\r' | b'\n', ..] => {
            ("PGM", pnm::decode(bytes, check, &mut expected.depth))
        }
        [b'B', b'M', _, _, _, _, _, _, _, _, ..] => ("BMP", bmp(bytes, check)),
        _ => {
            return Err(match video_container(bytes) {
                Some(found) => ImageError::Video { path: path.to_owned(), found },
                None => unusable(format!(
                    "expected a PNG, JPEG, PGM or BMP image, found {}",
                    describe_content(bytes)
                )),
            });
        }
    };
    decoded.map_err(|error| match error {
        DecodeError::TooLarge(found) => unusable(too_large(&found)),
        DecodeError::Broken(reason) => {
            unusable(format!("broken or truncated {format} image: {reason}; save it again"))
        }
        DecodeError::Size(found) => ImageError::Size { path: path.to_owned(), found },
    })
}

fn video_container(bytes: &[u8]) -> Option<&'static str> {
    let at = |place: std::ops::Range<usize>| bytes.get(place).unwrap_or_default();
    match (at(4..8), at(8..12)) {
        // Still images use the same container.
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

/// The type of a file, without its content, since clients can name the file.
fn describe_content(bytes: &[u8]) -> &'static str {
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
        return name;
    }
    if bytes.get(4..8) == Some(b"ftyp") {
        return "a HEIF or AVIF image";
    }
    if bytes.starts_with(b"RIFF") {
        return "a RIFF file, such as a WebP image";
    }
    let start = &bytes[..bytes.len().min(16)];
    if start.iter().all(|byte| byte.is_ascii_graphic() || byte.is_ascii_whitespace()) {
        "text"
    } else {
        "data of an unknown type"
    }
}

impl SizeCheck {
    /// For a decoder that takes several bytes per pixel.
    fn wide(self) -> Self {
        Self { max_pixels: MAX_WIDE_PIXELS, ..self }
    }

    fn check(self, width: usize, height: usize) -> Result<(), DecodeError> {
        if width == 0 || height == 0 {
            return Err(format!("its size is {width} x {height}").into());
        }
        if self.expected.is_some_and(|expected| expected != (width, height)) {
            return Err(DecodeError::Size((width, height)));
        }
        let is_side = |side| side <= MAX_SIDE_PX;
        if !is_side(width) || !is_side(height) || width * height > self.max_pixels {
            return Err(DecodeError::TooLarge(format!("{width} x {height} pixels")));
        }
        Ok(())
    }
}

fn png(bytes: &[u8], check: SizeCheck, depth: &mut SampleDepth) -> Result<GreyImage, DecodeError> {
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    // Expands palettes and grey of 1, 2 or 4 bits to 8 bits.
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info()?;
    let (width, height) = (reader.info().width as usize, reader.info().height as usize);
    let (color, bits) = reader.output_color_type();
    let channels = color.samples();
    if bits != png::BitDepth::Sixteen {
        check.check(width, height)?;
        let row = |row: &[u8]| grey(row.to_vec(), channels);
        let pixels = png_rows(&mut reader, (width, height), 8, row)?;
        return Ok(GreyImage { width, height, pixels });
    }
    check.wide().check(width, height)?;
    let row = |row: &[u8]| {
        let pairs = row.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]]));
        let samples = grey(pairs.collect(), channels);
        samples.into_iter().flat_map(u16::to_be_bytes).collect()
    };
    let bytes = png_rows(&mut reader, (2 * width, height), 16, row)?;
    let samples: Vec<u16> =
        bytes.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect();
    let declared = reader.info().sbit.as_ref().and_then(|bits| bits.iter().max().copied());
    let most = depth.update(&samples, declared);
    let pixels = samples.into_iter().map(|sample| scale_to_u8(sample, most)).collect();
    Ok(GreyImage { width, height, pixels })
}

/// All rows, each converted to grey samples of this many bits.
fn png_rows(
    reader: &mut png::Reader<Cursor<&[u8]>>,
    (stride, height): (usize, usize),
    bits: u8,
    convert: impl Fn(&[u8]) -> Vec<u8>,
) -> Result<Vec<u8>, DecodeError> {
    let mut pixels = vec![0; stride * height];
    let mut rows = pixels.chunks_exact_mut(stride);
    if !reader.info().interlaced {
        while let Some(row) = reader.next_row()? {
            let target = rows.next().ok_or("too many rows")?;
            target.copy_from_slice(&convert(row.data()));
        }
        return Ok(pixels);
    }
    while let Some(row) = reader.next_interlaced_row()? {
        let samples = convert(row.data());
        if let png::InterlaceInfo::Adam7(place) = row.interlace() {
            png::expand_interlaced_row(&mut pixels, stride, &samples, place, bits);
        }
    }
    Ok(pixels)
}

/// A decoder of the luma. It is strict: a truncated picture is an error, not one with a grey end.
pub(super) fn jpeg_decoder(bytes: &[u8]) -> JpegDecoder<Cursor<&[u8]>> {
    let options = DecoderOptions::default()
        .set_max_width(MAX_SIDE_PX)
        .set_max_height(MAX_SIDE_PX)
        .set_strict_mode(true)
        .jpeg_set_out_colorspace(ColorSpace::Luma);
    JpegDecoder::new_with_options(Cursor::new(bytes), options)
}

fn jpeg(bytes: &[u8], check: SizeCheck) -> Result<GreyImage, DecodeError> {
    let mut decoder = jpeg_decoder(bytes);
    decoder.decode_headers()?;
    let info = decoder.info().ok_or("no image header")?;
    let (width, height) = (usize::from(info.width), usize::from(info.height));
    // The decoder keeps the coefficients of a progressive picture.
    let check = if info.sof.is_progressive() { check.wide() } else { check };
    check.check(width, height)?;
    let samples = decoder.decode()?;
    let channels = decoder.output_colorspace().map_or(1, |space| space.num_components());
    Ok(GreyImage { width, height, pixels: grey(samples, channels) })
}

fn bmp(bytes: &[u8], check: SizeCheck) -> Result<GreyImage, DecodeError> {
    let options = DecoderOptions::default().set_max_width(MAX_SIDE_PX).set_max_height(MAX_SIDE_PX);
    let mut decoder = zune_bmp::BmpDecoder::new_with_options(Cursor::new(bytes), options);
    decoder.decode_headers().map_err(bmp_reason)?;
    let (width, height) = decoder.dimensions().ok_or("no image header")?;
    check.wide().check(width, height)?;
    let samples = decoder.decode().map_err(bmp_reason)?;
    let channels = decoder.colorspace().map_or(3, |space| space.num_components());
    let (expected, found) = (width * height * channels, samples.len());
    if found != expected {
        return Err(format!("expected {expected} samples, found {found}").into());
    }
    Ok(GreyImage { width, height, pixels: grey(samples, channels) })
}

fn bmp_reason(error: impl std::fmt::Debug) -> String {
    format!("{error:?}").trim().to_owned()
}

/// Samples of 1 (grey), 2 (grey, alpha), 3 (RGB) or 4 (RGB, alpha) channels → grey.
fn grey<T: Copy + Into<u32> + TryFrom<u32> + Default>(samples: Vec<T>, channels: usize) -> Vec<T> {
    match channels {
        1 => samples,
        2 => samples.chunks_exact(2).map(|pixel| pixel[0]).collect(),
        _ => samples.chunks_exact(channels).map(luma).collect(),
    }
}

/// Luma of BT.601, as in JPEG, rounded.
fn luma<T: Copy + Into<u32> + TryFrom<u32> + Default>(rgb: &[T]) -> T {
    let [red, green, blue] = [rgb[0], rgb[1], rgb[2]].map(Into::into);
    // At most (299 + 587 + 114) times the largest sample plus 500, over 1000: fits.
    T::try_from((299 * red + 587 * green + 114 * blue + 500) / 1000).unwrap_or_default()
}

/// Scales a sample from 0 to `most` to 0 to 255, rounded; larger samples count as `most`.
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
    fn other_files_are_rejected_by_name() {
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
            (b"name = \"lab\"", "image, found text"),
            (&[0, 1, 2, 3], "found data of an unknown type"),
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
