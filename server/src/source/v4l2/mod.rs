//! `v4l2:` – cameras of this machine, by Linux' own interface.
//!
//! | module | what it does |
//! | --- | --- |
//! | `abi` | requests and what they carry |
//! | `device` | formats, controls and frames, through the border that tests take the kernel's place at |
//! | `kernel` | the kernel's side of that border |
//! | `choice` | which of a device's formats is used |
//! | `listing` | what is connected, for `roundel cameras` |
//!
//! Frames stay in the device's buffers: a luma plane is lent as it lies there, and the buffer goes back when the next
//! frame is asked for. Capture times are the driver's, on the machine's monotonic clock, which is the server's.

mod abi;
mod choice;
mod device;
mod kernel;
mod listing;

use std::{
    io,
    time::{Duration, Instant},
};

pub use listing::{ControlListing, DeviceListing, FormatListing, devices};

use self::{
    choice::Choice,
    device::{Device, Driver, Filled},
    kernel::Kernel,
};
use super::{
    CaptureClock, DeviceAddress, FrameInfo, FrameSource, LentFrame, SourceError, bad_frame,
    jpeg::{JpegFault, LumaDecoder},
    pixels::{Converter, PixelFormat, Raw},
    wrong_size,
};
use crate::{clock::Clock, stop::Stop};

/// One is lent, one waits, and the device fills the others.
const BUFFERS: u32 = 4;
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// Cameras take their time to begin.
const FIRST_FRAME: Duration = Duration::from_secs(5);
const STALL: Duration = Duration::from_secs(1);

/// What a source has to fit into.
#[derive(Clone, Copy, Debug)]
pub(super) struct V4l2Parts {
    /// Of the camera's calibration.
    pub(super) size: (usize, usize),
    /// The server's.
    pub(super) clock: Clock,
}

/// A camera that streams.
struct V4l2Source<D: Driver> {
    device: Device<D>,
    name: String,
    parts: V4l2Parts,
    stop: Stop,
    /// What the device took the rate to be.
    promised_hz: Option<f64>,
    choice: Choice,
    stride: usize,
    /// The buffer that is lent.
    lent: Option<u32>,
    /// Number of the newest frame.
    newest: Option<u32>,
    converter: Converter,
    decoder: LumaDecoder,
    patience: Duration,
}

/// Opens a camera of this machine.
pub(super) fn open(
    address: &DeviceAddress,
    parts: V4l2Parts,
    stop: Stop,
) -> Result<Box<dyn FrameSource>, SourceError> {
    let driver = Kernel::open(&address.path).map_err(|error| {
        let remedy = match error.kind() {
            io::ErrorKind::NotFound => {
                "no such device: is it plugged in? `roundel cameras` lists what is"
            }
            io::ErrorKind::PermissionDenied => "the user needs to be in the group `video`",
            _ => "see `roundel cameras`",
        };
        SourceError::Failed(format!("{address}: {error}; {remedy}"))
    })?;
    Ok(Box::new(V4l2Source::start(Device { driver }, address, parts, stop)?))
}

impl<D: Driver> V4l2Source<D> {
    /// Sets the device as wished and lets it stream.
    fn start(
        mut device: Device<D>,
        address: &DeviceAddress,
        parts: V4l2Parts,
        stop: Stop,
    ) -> Result<Self, SourceError> {
        let name = address.to_string();
        let failed = |what: &str, error: io::Error| {
            SourceError::Failed(format!("{name}: {what}: {error}{}", remedy(&error)))
        };
        let capability =
            device.capability().map_err(|error| failed("is no video device", error))?;
        if !capability.captures {
            let card = capability.card;
            return Err(SourceError::Failed(format!(
                "{name}: `{card}` gives no frames by this device file; `roundel cameras` lists those that do"
            )));
        }
        let formats = device.formats().map_err(|error| failed("cannot list its formats", error))?;
        let choice = choice::choose(&formats, parts.size, address)
            .map_err(|why| SourceError::Failed(format!("{name}: {why}")))?;
        let size = (parts.size.0 as u32, parts.size.1 as u32);
        let set = device
            .set_format(size, choice.code)
            .map_err(|error| failed("cannot set size and format", error))?;
        if (set.width, set.height) != size {
            return Err(wrong_size(&name, parts.size, (set.width as usize, set.height as usize)));
        }
        if set.code != choice.code {
            return Err(SourceError::Failed(format!(
                "{name}: asked for {}, and the device took {}: write format=",
                choice::text(choice.code),
                choice::text(set.code)
            )));
        }
        let mut promised_hz = choice.rate_hz;
        if let Some(rate_hz) = choice.rate_hz {
            let taken =
                device.set_rate(rate_hz).map_err(|error| failed("cannot set the rate", error))?;
            if let Some(taken) = taken.filter(|taken| (taken / rate_hz - 1.0).abs() > 0.05) {
                tracing::warn!(
                    camera = name,
                    "asked for {rate_hz} Hz, and the device took {taken:.1} Hz"
                );
            }
            promised_hz = taken.or(promised_hz);
        }
        choice::set_controls(&mut device, address)
            .map_err(|why| SourceError::Failed(format!("{name}: {why}")))?;
        device.start(BUFFERS).map_err(|error| failed("cannot start", error))?;
        Ok(Self {
            device,
            name,
            parts,
            stop,
            choice,
            promised_hz,
            stride: set.stride as usize,
            lent: None,
            newest: None,
            converter: Converter::default(),
            decoder: LumaDecoder::new(parts.size),
            patience: FIRST_FRAME,
        })
    }

    /// Waits for frames and keeps the newest; counts those that were not whole.
    fn newest(&mut self, broken: &mut u64, begun: Instant) -> Result<Filled, SourceError> {
        loop {
            if self.stop.is_stopped() {
                return Err(SourceError::Stopped);
            }
            let mut newest: Option<Filled> = None;
            if self.device.driver.wait(LOOK_EVERY).map_err(|error| self.lost(&error))? {
                while let Some(filled) = self.device.take().map_err(|error| self.lost(&error))? {
                    if let Some(older) = newest.replace(filled) {
                        self.give_back(older.index)?;
                    }
                }
            }
            match newest {
                Some(filled) if !filled.broken => return Ok(filled),
                Some(filled) => {
                    *broken += 1;
                    self.give_back(filled.index)?;
                }
                None => {}
            }
            if begun.elapsed() >= self.patience {
                let seconds = self.patience.as_secs_f64();
                let broken = if *broken > 0 { format!(", {broken} broken") } else { String::new() };
                return Err(SourceError::Failed(format!(
                    "{}: stalled: no picture for {seconds:.1} s{broken}; another program may use the camera, or its \
                     port gives too little power or bandwidth",
                    self.name
                )));
            }
        }
    }

    fn give_back(&mut self, index: u32) -> Result<(), SourceError> {
        self.device.give_back(index).map_err(|error| self.lost(&error))
    }

    fn lost(&self, error: &io::Error) -> SourceError {
        SourceError::Failed(format!("{}: {error}{}", self.name, remedy(error)))
    }

    /// What is known of a frame, `broken` and `skipped` apart.
    fn info(&self, filled: &Filled) -> FrameInfo {
        let now = self.parts.clock.now();
        match filled.monotonic_ns {
            Some(ns) => {
                let age_ns = self.device.driver.monotonic_ns() - ns;
                let clock = CaptureClock::DRIVER;
                FrameInfo { clock, ..FrameInfo::at(now.plus_ns(-age_ns.max(0))) }
            }
            None => FrameInfo { clock: CaptureClock::ARRIVAL, ..FrameInfo::at(now) },
        }
    }
}

/// ENODEV: it was unplugged; EBUSY: another program has it; ENOSPC: the bus is full.
fn remedy(error: &io::Error) -> &'static str {
    match error.raw_os_error() {
        Some(19) => "; it was unplugged, and is tried again",
        Some(16) => "; another program uses it",
        Some(28) => "; its USB bus has not the bandwidth: use another port, or format=MJPG",
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
            self.give_back(index)?;
        }
        let (mut skipped, mut broken) = (0, 0);
        let (filled, info) = loop {
            let filled = self.newest(&mut broken, begun)?;
            let after = |newest: u32| filled.sequence.wrapping_sub(newest).wrapping_sub(1);
            let gap = self.newest.map_or(0, after);
            // A counter that starts anew has left nothing out.
            skipped += if gap < 1000 { u64::from(gap) } else { 0 };
            self.newest = Some(filled.sequence);
            let info = self.info(&filled);
            if self.choice.pixels.is_some() {
                break (filled, info);
            }
            let decoding = Instant::now();
            let bytes = self.device.driver.mapped(filled.index as usize);
            let decoded = self.decoder.decode(&bytes[..filled.bytes.min(bytes.len())]);
            let decoding = decoding.elapsed();
            match decoded {
                Ok(()) => break (filled, FrameInfo { decoding, ..info }),
                Err(JpegFault::Size(width, height)) => {
                    return Err(wrong_size(&self.name, self.parts.size, (width, height)));
                }
                Err(JpegFault::Broken(_)) => broken += 1,
            }
            self.give_back(filled.index)?;
        };
        // Broken ones were numbered too.
        let info = FrameInfo { skipped: skipped.saturating_sub(broken), broken, ..info };
        self.patience = STALL;
        self.lent = Some(filled.index);
        let Some(format) = self.choice.pixels else {
            return Ok(LentFrame { frame: self.decoder.frame()?, info });
        };
        let bytes = self.device.driver.mapped(filled.index as usize);
        let (width, height) = self.parts.size;
        let stride = self.stride.max(format.row_bytes(width));
        let raw =
            Raw { format, bytes: &bytes[..filled.bytes.min(bytes.len())], width, height, stride };
        Ok(LentFrame { frame: self.converter.grey(&raw).map_err(bad_frame)?, info })
    }
}

impl<D: Driver> Drop for V4l2Source<D> {
    fn drop(&mut self) {
        // Of a device that was unplugged there is nothing to stop.
        let _ = self.device.stop();
    }
}

/// Formats with their pixels, and those that are JPEG.
fn pixels(code: [u8; 4]) -> Option<Option<PixelFormat>> {
    match &code {
        b"MJPG" | b"JPEG" => Some(None),
        _ => PixelFormat::of_fourcc(code).map(Some),
    }
}

#[cfg(test)]
mod tests;
