//! Video4Linux's requests and what they carry, as bytes: `linux/videodev2.h` on 64-bit machines, little endian.
//!
//! The structures are read and written by their offsets, so that all of this is safe code and a recorded exchange is a
//! list of byte strings. The offsets and numbers are those that a C compiler prints for that header.

/// A request, as the kernel numbers it: its argument's direction and size are part of the number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Request(pub(super) u32);

impl Request {
    pub(super) const QUERY_CAPABILITY: Self = Self(0x8068_5600);
    pub(super) const ENUM_FORMAT: Self = Self(0xC040_5602);
    pub(super) const SET_FORMAT: Self = Self(0xC0D0_5605);
    pub(super) const REQUEST_BUFFERS: Self = Self(0xC014_5608);
    pub(super) const QUERY_BUFFER: Self = Self(0xC058_5609);
    pub(super) const QUEUE: Self = Self(0xC058_560F);
    pub(super) const DEQUEUE: Self = Self(0xC058_5611);
    pub(super) const STREAM_ON: Self = Self(0x4004_5612);
    pub(super) const STREAM_OFF: Self = Self(0x4004_5613);
    pub(super) const SET_PARAMETERS: Self = Self(0xC0CC_5616);
    pub(super) const GET_CONTROL: Self = Self(0xC008_561B);
    pub(super) const SET_CONTROL: Self = Self(0xC008_561C);
    pub(super) const QUERY_CONTROL: Self = Self(0xC044_5624);
    pub(super) const ENUM_SIZES: Self = Self(0xC02C_564A);
    pub(super) const ENUM_INTERVALS: Self = Self(0xC034_564B);

    /// Bytes of its argument.
    pub(super) fn size(self) -> usize {
        (self.0 >> 16 & 0x3FFF) as usize
    }
}

/// `V4L2_BUF_TYPE_VIDEO_CAPTURE`.
pub(super) const CAPTURE: u32 = 1;
/// `V4L2_MEMORY_MMAP`.
pub(super) const MAPPED: u32 = 1;
pub(super) const CAN_CAPTURE: u32 = 0x1;
pub(super) const CAN_STREAM: u32 = 0x0400_0000;
/// The device's own capabilities are told beside those of its driver.
pub(super) const HAS_OWN: u32 = 0x8000_0000;
pub(super) const FORMAT_EMULATED: u32 = 0x2;
pub(super) const BUFFER_ERROR: u32 = 0x40;
pub(super) const TIME_MASK: u32 = 0xE000;
pub(super) const TIME_MONOTONIC: u32 = 0x2000;
pub(super) const NEXT_CONTROL: u32 = 0x8000_0000;
pub(super) const CONTROL_DISABLED: u32 = 0x1;
pub(super) const CONTROL_READ_ONLY: u32 = 0x4;
/// Another control decides, such as automatic exposure.
pub(super) const CONTROL_INACTIVE: u32 = 0x10;

/// Offsets.
pub(super) mod at {
    pub(in super::super) const CAPABILITY_CARD: usize = 16;
    pub(in super::super) const CAPABILITY_BUS: usize = 48;
    pub(in super::super) const CAPABILITY_ALL: usize = 84;
    pub(in super::super) const CAPABILITY_OWN: usize = 88;
    pub(in super::super) const DESCRIPTION_FLAGS: usize = 8;
    pub(in super::super) const DESCRIPTION_TEXT: usize = 12;
    pub(in super::super) const DESCRIPTION_FORMAT: usize = 44;
    pub(in super::super) const SIZE_TYPE: usize = 8;
    pub(in super::super) const SIZE_WIDTH: usize = 12;
    pub(in super::super) const SIZE_HEIGHT: usize = 16;
    pub(in super::super) const INTERVAL_FORMAT: usize = 4;
    pub(in super::super) const INTERVAL_WIDTH: usize = 8;
    pub(in super::super) const INTERVAL_HEIGHT: usize = 12;
    pub(in super::super) const INTERVAL_TYPE: usize = 16;
    pub(in super::super) const INTERVAL_NUMERATOR: usize = 20;
    pub(in super::super) const INTERVAL_DENOMINATOR: usize = 24;
    pub(in super::super) const FORMAT_WIDTH: usize = 8;
    pub(in super::super) const FORMAT_HEIGHT: usize = 12;
    pub(in super::super) const FORMAT_CODE: usize = 16;
    pub(in super::super) const FORMAT_STRIDE: usize = 24;
    pub(in super::super) const PARAMETERS_NUMERATOR: usize = 12;
    pub(in super::super) const PARAMETERS_DENOMINATOR: usize = 16;
    pub(in super::super) const REQUESTED_TYPE: usize = 4;
    pub(in super::super) const REQUESTED_MEMORY: usize = 8;
    pub(in super::super) const BUFFER_TYPE: usize = 4;
    pub(in super::super) const BUFFER_USED: usize = 8;
    pub(in super::super) const BUFFER_FLAGS: usize = 12;
    pub(in super::super) const BUFFER_SECONDS: usize = 24;
    pub(in super::super) const BUFFER_MICROSECONDS: usize = 32;
    pub(in super::super) const BUFFER_SEQUENCE: usize = 56;
    pub(in super::super) const BUFFER_MEMORY: usize = 60;
    pub(in super::super) const BUFFER_OFFSET: usize = 64;
    pub(in super::super) const BUFFER_LENGTH: usize = 72;
    pub(in super::super) const CONTROL_KIND: usize = 4;
    pub(in super::super) const CONTROL_NAME: usize = 8;
    pub(in super::super) const CONTROL_LEAST: usize = 40;
    pub(in super::super) const CONTROL_MOST: usize = 44;
    pub(in super::super) const CONTROL_STEP: usize = 48;
    pub(in super::super) const CONTROL_DEFAULT: usize = 52;
    pub(in super::super) const CONTROL_FLAGS: usize = 56;
    pub(in super::super) const VALUE: usize = 4;
}

/// A request's argument.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Argument(pub(super) Vec<u8>);

impl Argument {
    /// All zero, as most requests want what they do not use.
    pub(super) fn of(request: Request) -> Self {
        Self(vec![0; request.size()])
    }

    pub(super) fn with(mut self, at: usize, value: u32) -> Self {
        self.0[at..at + 4].copy_from_slice(&value.to_ne_bytes());
        self
    }

    pub(super) fn u32(&self, at: usize) -> u32 {
        u32::from_ne_bytes(self.0[at..at + 4].try_into().unwrap_or_default())
    }

    pub(super) fn i32(&self, at: usize) -> i32 {
        self.u32(at) as i32
    }

    pub(super) fn i64(&self, at: usize) -> i64 {
        i64::from_ne_bytes(self.0[at..at + 8].try_into().unwrap_or_default())
    }

    /// Text of at most so many bytes, ended by a zero.
    pub(super) fn text(&self, at: usize, most: usize) -> String {
        let bytes = &self.0[at..at + most];
        let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(most);
        String::from_utf8_lossy(&bytes[..end]).trim().to_owned()
    }
}
