//! `v4l2:` – cameras of this machine, by Video4Linux.
//!
//! | module | purpose |
//! | --- | --- |
//! | `abi` | ioctls and their arguments |
//! | `device` | the trait `Driver`: formats, controls and frames of a device |
//! | `kernel` | the `Driver` of real devices; all `unsafe` code |
//! | `choice` | chooses the format and sets the controls |
//! | `listing` | lists devices for `roundel cameras` |
//!
//! Frames stay in the device's buffers: a luma plane is lent without a copy, and its buffer is queued again when the
//! next frame is requested. Capture times are the driver's, on the machine's monotonic clock, which is the server's.
//!
//! No crate does this job. `v4l` and `v4l2r` generate their bindings with libclang. `linuxvideo` 0.3 hides the time
//! stamp and the sequence number of a buffer (`ReadBufferView`), uses two buffers and queues each one before it
//! returns. `moq-v4l` 0.1 panics on a control of a type that it does not know and on text that is not UTF-8.

mod abi;
mod choice;
mod device;
mod kernel;
mod listing;

use std::{
    fs, io,
    os::unix::fs::{FileTypeExt, MetadataExt},
    time::{Duration, Instant},
};

use rustix::io::Errno;

pub use device::{ControlListing, FormatListing};
pub use listing::{DeviceListing, devices};

use self::{abi::Buffer, choice::Choice, device::Driver, kernel::Kernel};
use super::{
    FrameInfo, FrameSource, LentFrame, SourceError, SourceParts, bad_frame,
    jpeg::LumaDecoder,
    mailbox::stalled,
    pixels::{GreyConverter, PixelFormat, RawImage},
    wrong_size,
};
use crate::model::{address::DeviceAddress, capture_clock::CaptureClock};

/// One is lent, one waits, and the device fills the others.
const BUFFERS: u32 = 4;
/// How often a wait checks the stop signal.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Timeout of the first frame, which takes longer than the others.
const FIRST_FRAME: Duration = Duration::from_secs(5);
const STALL: Duration = Duration::from_secs(1);
/// The kernel's number of Video4Linux.
const VIDEO_MAJOR: u32 = 81;

struct V4l2Source<D: Driver> {
    device: D,
    name: String,
    parts: SourceParts,
    promised_hz: Option<f64>,
    choice: Choice,
    stride: usize,
    lent: Option<u32>,
    /// Sequence number of the newest frame.
    newest: Option<u32>,
    converter: GreyConverter,
    decoder: LumaDecoder,
    patience: Duration,
}

/// Opens a camera of this machine.
pub(super) fn open(
    address: &DeviceAddress,
    parts: SourceParts,
) -> Result<Box<dyn FrameSource>, SourceError> {
    // Opening another device may have effects: a watchdog starts.
    if fs::metadata(&address.path).is_ok_and(|found| !is_video_device(&found)) {
        return Err(SourceError::Failed(format!(
            "{address} is no video device; `roundel cameras` lists devices"
        )));
    }
    let device = Kernel::open(&address.path).map_err(|error| {
        let remedy = match error.kind() {
            io::ErrorKind::NotFound => {
                "no such device: is it plugged in? `roundel cameras` lists devices"
            }
            io::ErrorKind::PermissionDenied => "the user needs to be in the group `video`",
            _ => "see `roundel cameras`",
        };
        SourceError::Failed(format!("{address}: {error}; {remedy}"))
    })?;
    Ok(Box::new(V4l2Source::start(device, address, parts)?))
}

fn is_video_device(found: &fs::Metadata) -> bool {
    found.file_type().is_char_device() && rustix::fs::major(found.rdev()) == VIDEO_MAJOR
}

impl<D: Driver> V4l2Source<D> {
    /// Sets the device up and starts streaming.
    fn start(
        mut device: D,
        address: &DeviceAddress,
        parts: SourceParts,
    ) -> Result<Self, SourceError> {
        let name = address.to_string();
        let unusable = |why| SourceError::Failed(format!("{name}: {why}"));
        let failed =
            |what| move |error: io::Error| unusable(format!("{what}: {error}{}", remedy(&error)));
        let capability = device.capability().map_err(failed("is no video device"))?;
        if !capability.captures() {
            let card = device::text(&capability.card);
            return Err(unusable(format!(
                "`{card}` delivers no frames through this device file; `roundel cameras` lists those that do"
            )));
        }
        let formats = device.formats().map_err(failed("cannot list its formats"))?;
        let choice = choice::choose(&formats, parts.size, address).map_err(unusable)?;
        let size = (parts.size.0 as u32, parts.size.1 as u32);
        let set =
            device.set_format(size, choice.code).map_err(failed("cannot set size and format"))?;
        if (set.width, set.height) != size {
            return Err(wrong_size(&name, parts.size, (set.width as usize, set.height as usize)));
        }
        if set.code.to_ne_bytes() != choice.code {
            return Err(unusable(format!(
                "requested {}, but the device uses {}: set format=",
                device::code_text(choice.code),
                device::code_text(set.code.to_ne_bytes())
            )));
        }
        let mut promised_hz = choice.rate_hz;
        if let Some(rate_hz) = choice.rate_hz {
            let taken = device.set_rate(rate_hz).map_err(failed("cannot set the rate"))?;
            if let Some(taken) = taken.filter(|taken| (taken / rate_hz - 1.0).abs() > 0.05) {
                tracing::warn!(
                    camera = name,
                    "requested {rate_hz} Hz, but the device uses {taken:.1} Hz"
                );
            }
            promised_hz = taken.or(promised_hz);
        }
        choice::set_controls(&mut device, address).map_err(unusable)?;
        device.start(BUFFERS).map_err(failed("cannot start"))?;
        Ok(Self {
            device,
            name,
            choice,
            promised_hz,
            stride: set.stride as usize,
            lent: None,
            newest: None,
            converter: GreyConverter::default(),
            decoder: LumaDecoder::new(parts.size),
            parts,
            patience: FIRST_FRAME,
        })
    }

    /// Waits for frames and returns the newest; counts broken ones.
    fn newest(&mut self, broken: &mut u64, begun: Instant) -> Result<Buffer, SourceError> {
        loop {
            if self.parts.stop.is_stopped() {
                return Err(SourceError::Stopped);
            }
            let mut newest: Option<Buffer> = None;
            if self.device.wait(POLL_INTERVAL).map_err(|error| self.lost(&error))? {
                while let Some(filled) = self.device.dequeue().map_err(|error| self.lost(&error))? {
                    if let Some(older) = newest.replace(filled) {
                        self.queue(older.index)?;
                    }
                }
            }
            if let Some(filled) = newest {
                if !filled.is_broken() {
                    return Ok(filled);
                }
                *broken += 1;
                self.queue(filled.index)?;
            }
            if begun.elapsed() >= self.patience {
                let hint = "another program may use the camera, or its port gives too little power or bandwidth";
                let stalled = stalled(self.patience, hint, *broken);
                return Err(SourceError::Failed(format!("{}: {stalled}", self.name)));
            }
        }
    }

    fn queue(&mut self, index: u32) -> Result<(), SourceError> {
        self.device.queue(index).map_err(|error| self.lost(&error))
    }

    fn lost(&self, error: &io::Error) -> SourceError {
        SourceError::Failed(format!("{}: {error}{}", self.name, remedy(error)))
    }
}

fn remedy(error: &io::Error) -> &'static str {
    match Errno::from_io_error(error) {
        Some(Errno::NODEV) => "; it was unplugged; the server retries",
        Some(Errno::BUSY) => "; another program uses it",
        Some(Errno::NOSPC) => {
            "; its USB bus has too little bandwidth: use another port, or format=MJPG"
        }
        _ => "",
    }
}

impl<D: Driver> FrameSource for V4l2Source<D> {
    fn promised_hz(&self) -> Option<f64> {
        self.promised_hz
    }

    fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
        let begun = Instant::now();
        if let Some(index) = self.lent.take() {
            self.queue(index)?;
        }
        let (mut skipped, mut broken) = (0, 0);
        let (filled, info) = loop {
            let filled = self.newest(&mut broken, begun)?;
            let after = |newest: u32| filled.sequence.wrapping_sub(newest).wrapping_sub(1);
            let gap = self.newest.map_or(0, after);
            // A larger gap means that the counter was reset.
            skipped += if gap < 1000 { u64::from(gap) } else { 0 };
            self.newest = Some(filled.sequence);
            let now = self.parts.clock.now();
            let (capture_time, clock) = match filled.monotonic_ns() {
                Some(ns) => {
                    let age_ns = self.device.monotonic_ns() - ns;
                    (now.plus_ns(-age_ns.max(0)), CaptureClock::DRIVER)
                }
                None => (now, CaptureClock::ARRIVAL),
            };
            let info = FrameInfo { clock, ..FrameInfo::at(capture_time) };
            if self.choice.pixels.is_some() {
                break (filled, info);
            }
            let decoding = Instant::now();
            let decoded = self.decoder.decode(self.device.content(&filled));
            let decoding = decoding.elapsed();
            if self.decoder.accept(decoded, || self.name.clone())? {
                break (filled, FrameInfo { decoding, ..info });
            }
            broken += 1;
            self.queue(filled.index)?;
        };
        // Broken frames have sequence numbers too.
        let info = FrameInfo { skipped: skipped.saturating_sub(broken), broken, ..info };
        self.patience = STALL;
        self.lent = Some(filled.index);
        let Some(format) = self.choice.pixels else {
            return Ok(LentFrame { frame: self.decoder.frame()?, info });
        };
        let (width, height) = self.parts.size;
        let stride = self.stride.max(format.row_bytes(width));
        let raw = RawImage { format, bytes: self.device.content(&filled), width, height, stride };
        Ok(LentFrame { frame: self.converter.grey(&raw).map_err(bad_frame)?, info })
    }
}

impl<D: Driver> Drop for V4l2Source<D> {
    fn drop(&mut self) {
        // Fails if the device was unplugged, and then there is nothing to stop.
        let _ = self.device.stop();
    }
}

/// How a format is decoded: `None` if it is not supported, `Some(None)` if it is JPEG.
fn pixels(code: [u8; 4]) -> Option<Option<PixelFormat>> {
    match &code {
        b"MJPG" | b"JPEG" => Some(None),
        _ => PixelFormat::from_fourcc(code).map(Some),
    }
}

#[cfg(test)]
mod tests;
