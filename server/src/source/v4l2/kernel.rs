//! The real kernel's side of a video device. All that is unsafe about Video4Linux is here.
//!
//! Two things are: a request's argument must be as long as its number says, which is asserted before each call; and a
//! mapped buffer is memory that the device writes. It does so only between queueing and dequeueing a buffer, and
//! [`super::V4l2Source`] looks into a buffer only between dequeueing and queueing it. A mapping ends after the last
//! look, with the device.
#![allow(unsafe_code)]

use std::{
    ffi::c_void,
    fs::{File, OpenOptions},
    io,
    os::unix::fs::OpenOptionsExt,
    path::Path,
    ptr::{NonNull, null_mut},
    time::Duration,
};

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    fs::OFlags,
    ioctl::{Ioctl, IoctlOutput, Opcode, ioctl},
    mm::{MapFlags, ProtFlags, mmap, munmap},
    time::{ClockId, clock_gettime},
};

use super::{
    abi::{Argument, Request},
    device::Driver,
};

/// An open device file.
#[derive(Debug)]
pub(super) struct Kernel {
    file: File,
    mappings: Vec<Mapping>,
}

/// A buffer of the device in this process.
#[derive(Debug)]
struct Mapping {
    begin: NonNull<u8>,
    length: usize,
}

// SAFETY: the pointer is to memory that belongs to the mapping alone, on whatever thread it is used.
unsafe impl Send for Mapping {}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: mapped with this length, and nobody can hold a reference: they borrow the mapping.
        if let Err(error) = unsafe { munmap(self.begin.as_ptr().cast(), self.length) } {
            tracing::warn!(%error, "a camera's buffer is not given back");
        }
    }
}

impl Kernel {
    /// Opens a device file.
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        let flags = i32::try_from(OFlags::NONBLOCK.bits()).unwrap_or_default();
        let file = OpenOptions::new().read(true).write(true).custom_flags(flags).open(path)?;
        Ok(Self { file, mappings: Vec::new() })
    }
}

/// A request with its argument, as rustix takes it.
struct Call<'a> {
    request: Request,
    bytes: &'a mut [u8],
}

// SAFETY: the argument is as long as the request's number says (asserted by the only caller), and the kernel writes no
// further than that.
unsafe impl Ioctl for Call<'_> {
    type Output = ();
    const IS_MUTATING: bool = true;

    fn opcode(&self) -> Opcode {
        Opcode::from(self.request.0)
    }

    fn as_ptr(&mut self) -> *mut c_void {
        self.bytes.as_mut_ptr().cast()
    }

    unsafe fn output_from_ptr(_: IoctlOutput, _: *mut c_void) -> rustix::io::Result<()> {
        Ok(())
    }
}

impl Driver for Kernel {
    fn call(&mut self, request: Request, argument: &mut Argument) -> io::Result<()> {
        assert_eq!(argument.0.len(), request.size(), "argument of {request:?}");
        loop {
            let call = Call { request, bytes: &mut argument.0 };
            // SAFETY: `Call` is sound as its own comment says.
            match unsafe { ioctl(&self.file, call) } {
                Err(rustix::io::Errno::INTR) => {}
                outcome => return Ok(outcome?),
            }
        }
    }

    fn map(&mut self, offset: u64, length: usize) -> io::Result<()> {
        let (access, kind) = (ProtFlags::READ, MapFlags::SHARED);
        // SAFETY: the kernel chooses where, so nothing else is covered.
        let begin = unsafe { mmap(null_mut(), length, access, kind, &self.file, offset)? };
        let begin = NonNull::new(begin.cast()).ok_or(io::ErrorKind::OutOfMemory)?;
        self.mappings.push(Mapping { begin, length });
        Ok(())
    }

    fn mapped(&self, index: usize) -> &[u8] {
        let mapping = &self.mappings[index];
        // SAFETY: it lives as long as `self`; who writes to it and when is told at the top.
        unsafe { std::slice::from_raw_parts(mapping.begin.as_ptr(), mapping.length) }
    }

    fn wait(&mut self, longest: Duration) -> io::Result<bool> {
        let mut files = [PollFd::new(&self.file, PollFlags::IN)];
        let longest = Timespec {
            tv_sec: i64::try_from(longest.as_secs()).unwrap_or(i64::MAX),
            tv_nsec: longest.subsec_nanos().into(),
        };
        match poll(&mut files, Some(&longest)) {
            Ok(ready) => Ok(ready > 0),
            Err(rustix::io::Errno::INTR) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    fn monotonic_ns(&self) -> i64 {
        let now = clock_gettime(ClockId::Monotonic);
        now.tv_sec * 1_000_000_000 + now.tv_nsec
    }
}
