//! Pixel formats of cameras → 8-bit grey.
//!
//! | format | grey | cost |
//! | --- | --- | --- |
//! | 8-bit grey; YUV with the luma in a plane of its own (NV12, I420 …) | in place, by its stride | nothing |
//! | packed YUV (YUYV, UYVY …) | every second byte | a pass |
//! | 10 to 16 bits, in words or packed | the upper eight bits, rounded | a pass |
//! | Bayer mosaic | (1 2 1)ᵀ(1 2 1) / 16 around each pixel | a pass, or two if its samples are deep |
//!
//! The kernel for mosaics weights red, green and blue 1 : 2 : 1 at every pixel, whatever the order of the mosaic and
//! the position in it: it leaves no pattern and shifts nothing, and blurs with σ² = ½ px². At the border the picture is
//! mirrored, which continues the mosaic.
//!
//! A detector that read packed YUV with a step of two would save the pass and lose its wide loads everywhere.
//! Cost of 1280x720 pixels on one core of a virtual machine (`cargo bench -p roundel-server --bench pixels`): YUYV
//! 0.5 ms, 10 bits in words 0.4, packed by MIPI 3.5, 12 bits packed 6.3, a mosaic 0.2, of 12 bits 0.7.

use roundel_core::frame::{Frame, FrameError};
use thiserror::Error;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleFormat {
    /// One byte each.
    Eight,
    /// Little-endian words with this many significant bits, 10 to 16.
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

/// Meaning of a picture's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelFormat {
    /// Grey, or the luma plane that YUV begins with.
    Grey(SampleFormat),
    /// Luma in every second byte.
    Packed { chroma_first: bool },
    /// A Bayer mosaic of any order.
    Bayer(SampleFormat),
}

#[derive(Clone, Copy, Debug)]
pub struct RawImage<'a> {
    pub format: PixelFormat,
    pub bytes: &'a [u8],
    /// Columns, pixels.
    pub width: usize,
    /// Rows, pixels.
    pub height: usize,
    /// Bytes from one row to the next.
    pub stride: usize,
}

#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum PixelError {
    #[error(transparent)]
    Frame(#[from] FrameError),
    #[error("expected a mosaic of at least 2 x 2 pixels, found {width} x {height}")]
    Mosaic { width: usize, height: usize },
    #[error("expected rows of at least {expected} bytes, found {found}")]
    Stride { expected: usize, found: usize },
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

    /// The format of a four-character code of Video4Linux; `None` if it is compressed or unknown.
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

/// Converts pictures to grey and reuses its buffers.
#[derive(Clone, Debug, Default)]
pub struct GreyConverter {
    grey: Vec<u8>,
    /// A mosaic's samples, reduced to eight bits.
    mosaic: Vec<u8>,
    sums: Vec<u16>,
}

impl GreyConverter {
    /// The grey picture: a view of its own bytes if they are grey already, else of the converter's.
    pub fn grey<'a>(&'a mut self, raw: &RawImage<'a>) -> Result<Frame<'a>, PixelError> {
        let RawImage { format, bytes, width, height, stride } = *raw;
        check(raw)?;
        match format {
            PixelFormat::Grey(SampleFormat::Eight) => {
                return Ok(Frame::new(bytes, width, height, stride)?);
            }
            PixelFormat::Grey(samples) => {
                convert_rows(raw, &mut self.grey, |from, to| row_to_8_bits(samples, from, to));
            }
            PixelFormat::Packed { chroma_first } => {
                let at = usize::from(chroma_first);
                convert_rows(raw, &mut self.grey, |from, to| {
                    for (pair, grey) in from.chunks_exact(2).zip(to) {
                        *grey = pair[at];
                    }
                });
            }
            PixelFormat::Bayer(SampleFormat::Eight) => {
                let mosaic = Frame::new(bytes, width, height, stride)?;
                demosaic(&mosaic, &mut self.sums, &mut self.grey);
            }
            PixelFormat::Bayer(samples) => {
                convert_rows(raw, &mut self.mosaic, |from, to| row_to_8_bits(samples, from, to));
                let mosaic = Frame::new(&self.mosaic, width, height, width)?;
                demosaic(&mosaic, &mut self.sums, &mut self.grey);
            }
        }
        Ok(Frame::new(&self.grey, width, height, width)?)
    }
}

fn check(raw: &RawImage<'_>) -> Result<(), PixelError> {
    let RawImage { format, bytes, width, height, stride } = *raw;
    // Without bytes, only the size is checked.
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

/// Converts each row, without the bytes between rows.
fn convert_rows(raw: &RawImage<'_>, to: &mut Vec<u8>, convert: impl Fn(&[u8], &mut [u8])) {
    let row_bytes = raw.format.row_bytes(raw.width);
    to.resize(raw.width * raw.height, 0);
    for (from, to) in raw.bytes.chunks(raw.stride).zip(to.chunks_exact_mut(raw.width)) {
        convert(&from[..row_bytes], to);
    }
}

/// The upper eight of `bits` bits, rounded.
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
        SampleFormat::Mipi10 => groups::<5, 4>(from, to, 10, |b| {
            [0, 1, 2, 3].map(|i| u16::from(b[i]) << 2 | u16::from(b[4] >> (2 * i) & 3))
        }),
        SampleFormat::Bits10 => groups::<5, 4>(from, to, 10, |b| {
            [0, 1, 2, 3].map(|i| u16::from_le_bytes([b[i], b[i + 1]]) >> (2 * i) & 0x3FF)
        }),
        SampleFormat::Mipi12 => groups::<3, 2>(from, to, 12, |b| {
            let [first, second, low] = b.map(u16::from);
            [first << 4 | low & 15, second << 4 | low >> 4]
        }),
        SampleFormat::Bits12 => groups::<3, 2>(from, to, 12, |b| {
            let [low, middle, high] = b.map(u16::from);
            [low | (middle & 15) << 8, middle >> 4 | high << 4]
        }),
        SampleFormat::Gige12 => groups::<3, 2>(from, to, 12, |b| {
            let [first, low, second] = b.map(u16::from);
            [first << 4 | low & 15, second << 4 | low >> 4]
        }),
    }
}

/// Unpacks groups of `BYTES` that hold `PIXELS` samples; the last one may be incomplete.
fn groups<const BYTES: usize, const PIXELS: usize>(
    from: &[u8],
    to: &mut [u8],
    bits: u8,
    unpack: impl Fn([u8; BYTES]) -> [u16; PIXELS],
) {
    for (group, greys) in from.chunks(BYTES).zip(to.chunks_mut(PIXELS)) {
        let mut whole = [0; BYTES];
        whole[..group.len()].copy_from_slice(group);
        let samples = unpack(whole).map(|sample| to_upper_8_bits(sample, bits));
        greys.copy_from_slice(&samples[..greys.len()]);
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
