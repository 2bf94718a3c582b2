//! What cameras send → 8-bit grey: luma, mosaics, deep and packed samples.
//!
//! | format | grey | what it costs |
//! | --- | --- | --- |
//! | 8-bit grey; YUV with the luma in a plane of its own (NV12, I420 …) | in place, by its stride | nothing |
//! | packed YUV (YUYV, UYVY …) | every second byte | a pass |
//! | 10 to 16 bits, in words or packed | the upper eight bits, to the nearest level | a pass |
//! | Bayer mosaic | (1 2 1)ᵀ(1 2 1) / 16 round each pixel | a pass; of deep ones two |
//!
//! The kernel for mosaics weighs red, green and blue 1 : 2 : 1 at every pixel, whatever the mosaic's order and
//! wherever the pixel lies in it: no pattern stays, nothing moves, and the blur is one of σ² = ½ px² that fits to
//! the grey levels find like any other. At the border the picture is mirrored, which keeps the mosaic.
//!
//! A detector that walked packed YUV in steps of two would save its pass and lose its wide loads everywhere.
//! Of 1280x720 pixels, on one core of a busy virtual machine (`cargo bench -p roundel-server --bench pixels`): YUYV
//! 0.5 ms, ten bits in words 0.4, packed by MIPI 3.5, twelve bits packed 6.3, a mosaic 0.2, of twelve bits 0.7.

use roundel_core::frame::{Frame, FrameError};
use thiserror::Error;

/// How samples are laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleFormat {
    /// A byte each.
    Eight,
    /// Two bytes each, the lower one first, of which so many bits count: 10 to 16.
    Words(u8),
    /// Four in five bytes: the upper eight bits of each, then the lower two of all, the first lowest (MIPI RAW10).
    Mipi10,
    /// Two in three bytes, likewise (MIPI RAW12).
    Mipi12,
    /// Ten bits each without gaps, the lowest first (GenICam's Mono10p).
    Bits10,
    Bits12,
    /// Two in three bytes: upper eight, both lower four, upper eight (GigE Vision's Mono12Packed).
    Gige12,
}

/// What the bytes of a picture mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelFormat {
    /// Grey, or the luma plane that YUV begins with.
    Grey(SampleFormat),
    /// Luma in every second byte, from the first or the second one on.
    Packed {
        /// Whether chroma comes first.
        chroma_first: bool,
    },
    /// A Bayer mosaic of whatever order.
    Bayer(SampleFormat),
}

#[derive(Clone, Copy, Debug)]
pub struct RawImage<'a> {
    /// What the bytes mean.
    pub format: PixelFormat,
    pub bytes: &'a [u8],
    /// Columns, pixels.
    pub width: usize,
    /// Rows, pixels.
    pub height: usize,
    /// Bytes from one row to the next.
    pub stride: usize,
}

/// Why bytes are no picture.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum PixelError {
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// A mosaic without neighbours.
    #[error("expected a mosaic of at least 2 x 2 pixels, found {width} x {height}")]
    Mosaic { width: usize, height: usize },
    /// Rows overlap.
    #[error("expected rows of at least {expected} bytes, found {found}")]
    Stride { expected: usize, found: usize },
    /// Too few bytes.
    #[error("expected at least {expected} bytes for {width} x {height} pixels, found {found}")]
    Length { expected: usize, found: usize, width: usize, height: usize },
}

impl SampleFormat {
    /// Bytes of a row.
    fn row_bytes(self, width: usize) -> usize {
        match self {
            Self::Eight => width,
            Self::Words(_) => 2 * width,
            Self::Mipi10 => width.div_ceil(4) * 5,
            Self::Bits10 => (width * 10).div_ceil(8),
            Self::Mipi12 | Self::Gige12 => width.div_ceil(2) * 3,
            Self::Bits12 => (width * 12).div_ceil(8),
        }
    }
}

impl PixelFormat {
    pub const GREY8: Self = Self::Grey(SampleFormat::Eight);

    /// The format of a four-character code, as Video4Linux has them; `None`: it is compressed, or not known.
    pub fn from_fourcc(code: [u8; 4]) -> Option<Self> {
        let bayer = |samples| Some(Self::Bayer(samples));
        match &code {
            b"GREY" | b"Y800" | b"Y8  " => Some(Self::GREY8),
            b"YU12" | b"YV12" | b"NV12" | b"NV21" | b"NV16" | b"NV61" | b"NV24" | b"NV42"
            | b"422P" | b"411P" | b"YUV9" | b"YVU9" => Some(Self::GREY8),
            b"YUYV" | b"YVYU" => Some(Self::Packed { chroma_first: false }),
            b"UYVY" | b"VYUY" => Some(Self::Packed { chroma_first: true }),
            b"Y10 " => Some(Self::Grey(SampleFormat::Words(10))),
            b"Y12 " => Some(Self::Grey(SampleFormat::Words(12))),
            b"Y14 " => Some(Self::Grey(SampleFormat::Words(14))),
            b"Y16 " => Some(Self::Grey(SampleFormat::Words(16))),
            b"Y10P" => Some(Self::Grey(SampleFormat::Mipi10)),
            b"Y12P" => Some(Self::Grey(SampleFormat::Mipi12)),
            b"BA81" | b"GBRG" | b"GRBG" | b"RGGB" => bayer(SampleFormat::Eight),
            b"BG10" | b"GB10" | b"BA10" | b"RG10" => bayer(SampleFormat::Words(10)),
            b"BG12" | b"GB12" | b"BA12" | b"RG12" => bayer(SampleFormat::Words(12)),
            b"BG14" | b"GB14" | b"GR14" | b"RG14" => bayer(SampleFormat::Words(14)),
            b"BYR2" | b"GB16" | b"GR16" | b"RG16" => bayer(SampleFormat::Words(16)),
            b"pBAA" | b"pGAA" | b"pgAA" | b"pRAA" => bayer(SampleFormat::Mipi10),
            b"pBCC" | b"pGCC" | b"pgCC" | b"pRCC" => bayer(SampleFormat::Mipi12),
            _ => None,
        }
    }

    /// Bytes of a row without gaps.
    pub fn row_bytes(self, width: usize) -> usize {
        match self {
            Self::Grey(samples) | Self::Bayer(samples) => samples.row_bytes(width),
            Self::Packed { .. } => 2 * width,
        }
    }
}

/// Makes grey of pictures; its buffers are used again.
#[derive(Clone, Debug, Default)]
pub struct GreyConverter {
    grey: Vec<u8>,
    /// A mosaic's samples, brought to eight bits.
    mosaic: Vec<u8>,
    sums: Vec<u16>,
}

impl GreyConverter {
    /// The grey picture: a view of its own bytes where they are grey already, else of the converter's.
    pub fn grey<'a>(&'a mut self, raw: &RawImage<'a>) -> Result<Frame<'a>, PixelError> {
        let RawImage { format, bytes, width, height, stride } = *raw;
        check(raw)?;
        let samples = match format {
            PixelFormat::Grey(SampleFormat::Eight) => {
                return Ok(Frame::new(bytes, width, height, stride)?);
            }
            PixelFormat::Packed { chroma_first } => {
                self.grey.resize(width * height, 0);
                for (from, to) in rows(raw).zip(self.grey.chunks_exact_mut(width)) {
                    extract_luma(from, chroma_first, to);
                }
                return Ok(Frame::new(&self.grey, width, height, width)?);
            }
            PixelFormat::Grey(samples) | PixelFormat::Bayer(samples) => samples,
        };
        let narrowed = match format {
            PixelFormat::Bayer(_) => &mut self.mosaic,
            _ => &mut self.grey,
        };
        if samples != SampleFormat::Eight {
            narrowed.resize(width * height, 0);
            for (from, to) in rows(raw).zip(narrowed.chunks_exact_mut(width)) {
                row_to_8_bits(samples, from, to);
            }
        }
        if matches!(format, PixelFormat::Bayer(_)) {
            let mosaic = match samples {
                SampleFormat::Eight => Frame::new(bytes, width, height, stride)?,
                _ => Frame::new(&self.mosaic, width, height, width)?,
            };
            demosaic(&mosaic, &mut self.sums, &mut self.grey);
        }
        Ok(Frame::new(&self.grey, width, height, width)?)
    }
}

fn check(raw: &RawImage<'_>) -> Result<(), PixelError> {
    let RawImage { format, bytes, width, height, stride } = *raw;
    // A picture of no bytes is checked for its sides alone.
    if let Err(error @ FrameError::Size { .. }) = Frame::new(&[], width, height, width) {
        return Err(error.into());
    }
    if matches!(format, PixelFormat::Bayer(_)) && (width < 2 || height < 2) {
        return Err(PixelError::Mosaic { width, height });
    }
    let row_bytes = format.row_bytes(width);
    if stride < row_bytes {
        return Err(PixelError::Stride { expected: row_bytes, found: stride });
    }
    let expected = stride.saturating_mul(height - 1).saturating_add(row_bytes);
    if bytes.len() < expected {
        return Err(PixelError::Length { expected, found: bytes.len(), width, height });
    }
    Ok(())
}

/// The rows' bytes, without what lies between them.
fn rows<'a>(raw: &RawImage<'a>) -> impl Iterator<Item = &'a [u8]> {
    let row_bytes = raw.format.row_bytes(raw.width);
    raw.bytes.chunks(raw.stride).take(raw.height).map(move |row| &row[..row_bytes])
}

fn extract_luma(from: &[u8], chroma_first: bool, to: &mut [u8]) {
    let at = usize::from(chroma_first);
    for (pair, grey) in from.chunks_exact(2).zip(to) {
        *grey = pair[at];
    }
}

/// The upper eight of so many bits, to the nearest level.
fn to_upper_8_bits(sample: u16, bits: u8) -> u8 {
    let shift = u32::from(bits.clamp(9, 16)) - 8;
    let rounded = (u32::from(sample) + (1 << (shift - 1))) >> shift;
    rounded.min(255) as u8
}

fn row_to_8_bits(samples: SampleFormat, from: &[u8], to: &mut [u8]) {
    match samples {
        SampleFormat::Eight => to.copy_from_slice(&from[..to.len()]),
        SampleFormat::Words(bits) => {
            for (pair, grey) in from.chunks_exact(2).zip(to) {
                *grey = to_upper_8_bits(u16::from_le_bytes([pair[0], pair[1]]), bits);
            }
        }
        SampleFormat::Mipi10 => groups::<5, 4>(from, to, |b| {
            [0, 1, 2, 3]
                .map(|i| to_upper_8_bits(u16::from(b[i]) << 2 | u16::from(b[4] >> (2 * i) & 3), 10))
        }),
        SampleFormat::Bits10 => groups::<5, 4>(from, to, |b| {
            let word = |i: usize| u16::from_le_bytes([b[i], b[i + 1]]);
            [0, 1, 2, 3].map(|i| to_upper_8_bits(word(i) >> (2 * i) & 0x3FF, 10))
        }),
        SampleFormat::Mipi12 => groups::<3, 2>(from, to, |b| {
            let [first, second, low] = b.map(u16::from);
            [
                to_upper_8_bits(first << 4 | low & 15, 12),
                to_upper_8_bits(second << 4 | low >> 4, 12),
            ]
        }),
        SampleFormat::Bits12 => groups::<3, 2>(from, to, |b| {
            let [low, middle, high] = b.map(u16::from);
            [
                to_upper_8_bits(low | (middle & 15) << 8, 12),
                to_upper_8_bits(middle >> 4 | high << 4, 12),
            ]
        }),
        SampleFormat::Gige12 => groups::<3, 2>(from, to, |b| {
            let [first, low, second] = b.map(u16::from);
            [
                to_upper_8_bits(first << 4 | low & 15, 12),
                to_upper_8_bits(second << 4 | low >> 4, 12),
            ]
        }),
    }
}

/// Walks groups of `BYTES` that hold `PIXELS`; the last one may be cut.
fn groups<const BYTES: usize, const PIXELS: usize>(
    from: &[u8],
    to: &mut [u8],
    unpack: impl Fn([u8; BYTES]) -> [u8; PIXELS],
) {
    for (group, greys) in from.chunks(BYTES).zip(to.chunks_mut(PIXELS)) {
        let mut whole = [0; BYTES];
        whole[..group.len()].copy_from_slice(group);
        greys.copy_from_slice(&unpack(whole)[..greys.len()]);
    }
}

/// (1 2 1)ᵀ(1 2 1) / 16; needs two rows and columns.
fn demosaic(mosaic: &Frame<'_>, sums: &mut Vec<u16>, grey: &mut Vec<u8>) {
    let (width, height) = (mosaic.width(), mosaic.height());
    grey.resize(width * height, 0);
    // A mirrored column on each side.
    sums.resize(width + 2, 0);
    for (v, to) in grey.chunks_exact_mut(width).enumerate() {
        let above = mosaic.row(if v == 0 { 1 } else { v - 1 });
        let below = mosaic.row(if v + 1 == height { height - 2 } else { v + 1 });
        let levels = above.iter().zip(mosaic.row(v)).zip(below);
        for (sum, ((&above, &here), &below)) in sums[1..=width].iter_mut().zip(levels) {
            *sum = u16::from(above) + 2 * u16::from(here) + u16::from(below);
        }
        (sums[0], sums[width + 1]) = (sums[2], sums[width - 1]);
        let (left, middle, right) = (&sums[..width], &sums[1..=width], &sums[2..]);
        for (to, ((&left, &middle), &right)) in
            to.iter_mut().zip(left.iter().zip(middle).zip(right))
        {
            // At most 16 · 255 + 8: fits.
            *to = ((left + 2 * middle + right + 8) >> 4) as u8;
        }
    }
}

#[cfg(test)]
mod tests;
