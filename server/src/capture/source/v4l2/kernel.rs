//! The kernel's side of a video device, and the only `unsafe` code of the module.
//!
//! Two invariants make it sound. An opcode contains the size of its argument, and both come from the same type in
//! `abi`. The device writes to a mapped buffer only while the buffer is queued, and [`super::V4l2Source`] reads a
//! buffer only while it is dequeued.
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
    io::{Errno, retry_on_intr},
    ioctl::{Ioctl, IoctlOutput, Opcode, ioctl},
    mm::{MapFlags, ProtFlags, mmap, munmap},
    time::{ClockId, clock_gettime},
};

use super::{abi::Request, device::Driver};

#[derive(Debug)]
pub(super) struct Kernel {
    file: File,
    mappings: Vec<Mapping>,
}

/// A buffer of the device, mapped into this process.
#[derive(Debug)]
struct Mapping {
    begin: NonNull<u8>,
    length: usize,
}

// SAFETY: the mapping is the only owner of its memory.
unsafe impl Send for Mapping {}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: it was mapped with this length, and references to it borrow the mapping.
        if let Err(error) = unsafe { munmap(self.begin.as_ptr().cast(), self.length) } {
            tracing::warn!(%error, "cannot unmap a buffer of a camera");
        }
    }
}

impl Kernel {
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        let flags = OFlags::NONBLOCK.bits() as i32;
        let file = OpenOptions::new().read(true).write(true).custom_flags(flags).open(path)?;
        Ok(Self { file, mappings: Vec::new() })
    }
}

// SAFETY: the opcode contains the size of the argument, and the kernel writes no further.
unsafe impl Ioctl for &mut Request<'_> {
    type Output = ();
    const IS_MUTATING: bool = true;

    fn opcode(&self) -> Opcode {
        Request::opcode(self)
    }

    fn as_ptr(&mut self) -> *mut c_void {
        self.pointer()
    }

    unsafe fn output_from_ptr(_: IoctlOutput, _: *mut c_void) -> rustix::io::Result<()> {
        Ok(())
    }
}

impl Driver for Kernel {
    fn call(&mut self, mut request: Request<'_>) -> io::Result<()> {
        // SAFETY: see the implementation of `Ioctl`.
        Ok(retry_on_intr(|| unsafe { ioctl(&self.file, &mut request) })?)
    }

    fn map(&mut self, offset: u64, length: usize) -> io::Result<()> {
        let (access, kind) = (ProtFlags::READ, MapFlags::SHARED);
        // SAFETY: the kernel chooses the address, so no other memory is replaced.
        let begin = unsafe { mmap(null_mut(), length, access, kind, &self.file, offset)? };
        let begin = NonNull::new(begin.cast()).ok_or(io::ErrorKind::OutOfMemory)?;
        self.mappings.push(Mapping { begin, length });
        Ok(())
    }

    fn mapped(&self, index: usize) -> &[u8] {
        let mapping = &self.mappings[index];
        // SAFETY: it lives as long as `self`; the module page says when the device writes to it.
        unsafe { std::slice::from_raw_parts(mapping.begin.as_ptr(), mapping.length) }
    }

    fn wait(&mut self, longest: Duration) -> io::Result<bool> {
        let longest = Timespec::try_from(longest).map_err(io::Error::other)?;
        match poll(&mut [PollFd::new(&self.file, PollFlags::IN)], Some(&longest)) {
            Ok(ready) => Ok(ready > 0),
            Err(Errno::INTR) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    fn monotonic_ns(&self) -> i64 {
        let now = clock_gettime(ClockId::Monotonic);
        now.tv_sec * 1_000_000_000 + now.tv_nsec
    }
}
