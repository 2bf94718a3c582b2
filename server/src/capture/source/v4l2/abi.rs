//! The part of `linux/videodev2.h` that the server uses, as it is laid out on 64-bit Linux.
//!
//! Fields that the server does not use are kept only for the layout and have names that begin with an underscore.

use std::{ffi::c_void, ptr::from_mut};

use rustix::ioctl::{Opcode, opcode};

/// `V4L2_BUF_TYPE_VIDEO_CAPTURE`.
pub(super) const CAPTURE: u32 = 1;
/// `V4L2_MEMORY_MMAP`.
pub(super) const MAPPED: u32 = 1;
/// `V4L2_FRMSIZE_TYPE_DISCRETE` and `V4L2_FRMIVAL_TYPE_DISCRETE`.
pub(super) const DISCRETE: u32 = 1;
pub(super) const CAN_CAPTURE: u32 = 0x1;
pub(super) const CAN_STREAM: u32 = 0x0400_0000;
/// `Capability::device` is valid.
pub(super) const HAS_DEVICE_CAPABILITIES: u32 = 0x8000_0000;
pub(super) const FORMAT_EMULATED: u32 = 0x2;
pub(super) const BUFFER_ERROR: u32 = 0x40;
pub(super) const TIMESTAMP_MASK: u32 = 0xE000;
pub(super) const TIMESTAMP_MONOTONIC: u32 = 0x2000;
pub(super) const NEXT_CONTROL: u32 = 0x8000_0000;
pub(super) const CONTROL_DISABLED: u32 = 0x1;
pub(super) const CONTROL_READ_ONLY: u32 = 0x4;
/// Another control, such as automatic exposure, overrides it.
pub(super) const CONTROL_INACTIVE: u32 = 0x10;

macro_rules! arguments {
    ($($name:ident { $($field:ident: $kind:ty),* $(,)? })*) => {$(
        #[derive(Clone, Copy, Debug, Default)]
        #[repr(C)]
        pub(super) struct $name { $(pub(super) $field: $kind),* }
    )*};
}

arguments! {
    Capability {
        _driver: [u8; 16], card: [u8; 32], bus: [u8; 32], _version: u32, driver: u32, device: u32,
        _reserved: [u32; 3],
    }
    FormatDescription {
        index: u32, buffer_type: u32, flags: u32, description: [u8; 32], code: u32, _reserved: [u32; 4],
    }
    FrameSize { index: u32, code: u32, kind: u32, width: u32, height: u32, _reserved: [u32; 6] }
    FrameInterval {
        index: u32, code: u32, width: u32, height: u32, kind: u32, numerator: u32, denominator: u32,
        _reserved: [u32; 6],
    }
    Format {
        buffer_type: u32, _padding: u32, width: u32, height: u32, code: u32, _field: u32, stride: u32,
        _unused: [u32; 7], _reserved: [u64; 19],
    }
    Parameters {
        buffer_type: u32, _modes: [u32; 2], numerator: u32, denominator: u32, _reserved: [[u32; 23]; 2],
    }
    BufferRequest { count: u32, buffer_type: u32, memory: u32, _reserved: [u32; 2] }
    Buffer {
        index: u32, buffer_type: u32, bytes: u32, flags: u32, _field: u32, seconds: i64, microseconds: i64,
        _timecode: [u32; 4], sequence: u32, memory: u32, offset: u32, _offset_high: u32, length: u32,
        _reserved: [u32; 3],
    }
    Control { id: u32, value: i32 }
    ControlDescription {
        id: u32, kind: u32, name: [u8; 32], least: i32, most: i32, step: i32, default: i32, flags: u32,
        _reserved: [u32; 2],
    }
}

/// Declares the ioctls: name, argument, direction and number. The opcode contains the size of the argument.
macro_rules! requests {
    ($($name:ident($argument:ty) = $direction:ident $number:literal,)*) => {
        /// An ioctl with its argument, which the kernel replaces by its answer.
        #[derive(Debug)]
        pub(super) enum Request<'a> {
            $($name(&'a mut $argument)),*
        }

        impl Request<'_> {
            pub(super) fn opcode(&self) -> Opcode {
                match self {
                    $(Self::$name(_) => opcode::$direction::<$argument>(b'V', $number)),*
                }
            }

            pub(super) fn pointer(&mut self) -> *mut c_void {
                match self {
                    $(Self::$name(argument) => from_mut::<$argument>(argument).cast()),*
                }
            }
        }
    };
}

requests! {
    QueryCapability(Capability) = read 0,
    EnumFormat(FormatDescription) = read_write 2,
    SetFormat(Format) = read_write 5,
    AllocateBuffers(BufferRequest) = read_write 8,
    QueryBuffer(Buffer) = read_write 9,
    QueueBuffer(Buffer) = read_write 15,
    DequeueBuffer(Buffer) = read_write 17,
    StreamOn(u32) = write 18,
    StreamOff(u32) = write 19,
    SetParameters(Parameters) = read_write 22,
    GetControl(Control) = read_write 27,
    SetControl(Control) = read_write 28,
    QueryControl(ControlDescription) = read_write 36,
    EnumSize(FrameSize) = read_write 74,
    EnumInterval(FrameInterval) = read_write 75,
}

#[cfg(test)]
mod tests {
    use std::mem::offset_of;

    use super::*;

    /// The numbers are those that a C compiler prints for the header.
    #[test]
    fn layout_is_that_of_the_header() {
        let (mut buffer, mut control, mut kind) = (Buffer::default(), Control::default(), 0);
        for (request, opcode) in [
            (Request::QueryCapability(&mut Capability::default()), 0x8068_5600),
            (Request::EnumFormat(&mut FormatDescription::default()), 0xC040_5602),
            (Request::SetFormat(&mut Format::default()), 0xC0D0_5605),
            (Request::AllocateBuffers(&mut BufferRequest::default()), 0xC014_5608),
            (Request::DequeueBuffer(&mut buffer), 0xC058_5611),
            (Request::StreamOn(&mut kind), 0x4004_5612),
            (Request::SetParameters(&mut Parameters::default()), 0xC0CC_5616),
            (Request::SetControl(&mut control), 0xC008_561C),
            (Request::QueryControl(&mut ControlDescription::default()), 0xC044_5624),
            (Request::EnumSize(&mut FrameSize::default()), 0xC02C_564A),
            (Request::EnumInterval(&mut FrameInterval::default()), 0xC034_564B),
        ] {
            assert_eq!(request.opcode(), opcode, "{request:?}");
        }
        assert_eq!((offset_of!(Capability, driver), offset_of!(Capability, device)), (84, 88));
        assert_eq!(offset_of!(FormatDescription, code), 44);
        assert_eq!((offset_of!(FrameSize, width), offset_of!(FrameInterval, numerator)), (12, 20));
        assert_eq!((offset_of!(Format, width), offset_of!(Format, stride)), (8, 24));
        assert_eq!(offset_of!(Parameters, numerator), 12);
        assert_eq!((offset_of!(Buffer, flags), offset_of!(Buffer, seconds)), (12, 24));
        assert_eq!((offset_of!(Buffer, sequence), offset_of!(Buffer, offset)), (56, 64));
        assert_eq!(offset_of!(Buffer, length), 72);
        assert_eq!(
            (offset_of!(ControlDescription, least), offset_of!(ControlDescription, flags)),
            (40, 56)
        );
    }
}
