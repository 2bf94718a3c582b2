//! A video device: capabilities, formats, controls and frames. Tests replace its [`Driver`].

use std::{io, time::Duration};

use rustix::io::Errno;
use serde::Serialize;

use super::{
    abi::{
        self, BUFFER_ERROR, Buffer, BufferRequest, CAN_CAPTURE, CAN_STREAM, CAPTURE,
        CONTROL_DISABLED, CONTROL_INACTIVE, CONTROL_READ_ONLY, Capability, ControlDescription,
        DISCRETE, FORMAT_EMULATED, FrameInterval, FrameSize, HAS_DEVICE_CAPABILITIES, MAPPED,
        NEXT_CONTROL, Parameters, Request, TIMESTAMP_MASK, TIMESTAMP_MONOTONIC,
    },
    pixels,
};

/// Limit of a list, for drivers whose lists do not end.
const MAX_LIST: u32 = 256;
/// `V4L2_CTRL_TYPE_` INTEGER, BOOLEAN, MENU, BITMASK and INTEGER_MENU: the types whose value is a number.
const NUMERIC: [u32; 5] = [1, 2, 3, 8, 9];

/// A format in one size.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct FormatListing {
    pub format: String,
    /// The driver's description.
    pub description: String,
    pub is_read: bool,
    /// Columns, pixels; 0: any.
    pub width: u32,
    /// Rows, pixels; 0: any.
    pub height: u32,
    /// The fastest first.
    pub rates_hz: Vec<f64>,
    #[serde(skip)]
    pub(crate) code: [u8; 4],
    /// A library converts it from another format.
    #[serde(skip)]
    pub(crate) emulated: bool,
}

/// A control whose value is a number.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ControlListing {
    /// The name in a source's address, which is also that of `v4l2-ctl`: `exposure_time_absolute`.
    pub name: String,
    pub least: i32,
    pub most: i32,
    pub step: i32,
    /// Value when plugged in.
    pub default: i32,
    pub value: i32,
    /// Whether it can be set now: it is not read-only and no other control overrides it.
    pub is_settable: bool,
    #[serde(skip)]
    pub(crate) id: u32,
    #[serde(skip)]
    pub(crate) read_only: bool,
}

impl Capability {
    /// Whether the device file streams frames.
    pub(super) fn captures(&self) -> bool {
        let has_own = self.driver & HAS_DEVICE_CAPABILITIES != 0;
        let flags = if has_own { self.device } else { self.driver };
        flags & CAN_CAPTURE != 0 && flags & CAN_STREAM != 0
    }
}

impl Buffer {
    fn numbered(index: u32) -> Self {
        Self { index, buffer_type: CAPTURE, memory: MAPPED, ..Self::default() }
    }

    /// The driver's time stamp; `None` unless it is on the monotonic clock.
    pub(super) fn monotonic_ns(&self) -> Option<i64> {
        let is_monotonic = self.flags & TIMESTAMP_MASK == TIMESTAMP_MONOTONIC;
        is_monotonic.then_some(self.seconds * 1_000_000_000 + self.microseconds * 1000)
    }

    /// Whether the driver reports that the content is damaged.
    pub(super) fn is_broken(&self) -> bool {
        self.flags & BUFFER_ERROR != 0
    }
}

/// A video device: the required methods are those of the operating system.
pub(super) trait Driver: Send {
    /// Makes a request; the answer replaces its argument.
    fn call(&mut self, request: Request<'_>) -> io::Result<()>;
    /// Maps a buffer of the device; buffers are numbered in the order of the calls.
    fn map(&mut self, offset: u64, length: usize) -> io::Result<()>;
    /// The bytes of a mapped buffer.
    fn mapped(&self, index: usize) -> &[u8];
    /// Waits for a frame; false after a timeout.
    fn wait(&mut self, longest: Duration) -> io::Result<bool>;
    /// The machine's monotonic clock.
    fn monotonic_ns(&self) -> i64;

    fn capability(&mut self) -> io::Result<Capability> {
        let mut capability = Capability::default();
        self.call(Request::QueryCapability(&mut capability))?;
        Ok(capability)
    }

    /// Formats in each of their sizes.
    fn formats(&mut self) -> io::Result<Vec<FormatListing>> {
        let mut formats = Vec::new();
        for index in 0..MAX_LIST {
            let mut found =
                abi::FormatDescription { index, buffer_type: CAPTURE, ..Default::default() };
            if !self.supports(Request::EnumFormat(&mut found))? {
                break;
            }
            let code = found.code.to_ne_bytes();
            let format = FormatListing {
                format: code_text(code),
                description: text(&found.description),
                is_read: pixels(code).is_some(),
                code,
                emulated: found.flags & FORMAT_EMULATED != 0,
                ..FormatListing::default()
            };
            let sizes = self.sizes(found.code)?.into_iter();
            formats.extend(sizes.map(|(width, height, rates_hz)| FormatListing {
                width,
                height,
                rates_hz,
                ..format.clone()
            }));
        }
        Ok(formats)
    }

    /// Discrete sizes with their rates; one of 0 x 0 for a device that lists ranges.
    fn sizes(&mut self, code: u32) -> io::Result<Vec<(u32, u32, Vec<f64>)>> {
        let mut sizes = Vec::new();
        for index in 0..MAX_LIST {
            let mut size = FrameSize { index, code, ..FrameSize::default() };
            if !self.supports(Request::EnumSize(&mut size))? || size.kind != DISCRETE {
                break;
            }
            sizes.push((size.width, size.height, self.rates(&size)?));
        }
        if sizes.is_empty() {
            sizes.push((0, 0, Vec::new()));
        }
        Ok(sizes)
    }

    fn rates(&mut self, size: &FrameSize) -> io::Result<Vec<f64>> {
        let FrameSize { code, width, height, .. } = *size;
        let mut rates = Vec::new();
        for index in 0..MAX_LIST {
            let mut interval =
                FrameInterval { index, code, width, height, ..FrameInterval::default() };
            if !self.supports(Request::EnumInterval(&mut interval))? || interval.kind != DISCRETE {
                break;
            }
            rates.push(rate_hz(interval.numerator, interval.denominator));
        }
        rates.sort_by(|a, b| b.total_cmp(a));
        Ok(rates)
    }

    /// Makes a request that a driver need not support. EINVAL also ends a list.
    fn supports(&mut self, request: Request<'_>) -> io::Result<bool> {
        let outcome = self.call(request);
        match outcome.as_ref().map_err(Errno::from_io_error) {
            Err(Some(Errno::INVAL | Errno::NOTTY)) => Ok(false),
            _ => outcome.map(|()| true),
        }
    }

    /// All controls whose value is a number.
    fn controls(&mut self) -> io::Result<Vec<ControlListing>> {
        let (mut controls, mut last) = (Vec::new(), 0);
        for _ in 0..MAX_LIST {
            let mut found =
                ControlDescription { id: last | NEXT_CONTROL, ..ControlDescription::default() };
            if !self.supports(Request::QueryControl(&mut found))? {
                break;
            }
            last = found.id;
            if found.flags & CONTROL_DISABLED != 0 || !NUMERIC.contains(&found.kind) {
                continue;
            }
            // A write-only control has no value.
            let Ok(value) = self.control(found.id) else { continue };
            let ControlDescription { id, least, most, step, default, flags, .. } = found;
            controls.push(ControlListing {
                name: control_name(&text(&found.name)),
                least,
                most,
                step,
                default,
                value,
                is_settable: flags & (CONTROL_READ_ONLY | CONTROL_INACTIVE) == 0,
                id,
                read_only: flags & CONTROL_READ_ONLY != 0,
            });
        }
        Ok(controls)
    }

    fn control(&mut self, id: u32) -> io::Result<i32> {
        let mut control = abi::Control { id, value: 0 };
        self.call(Request::GetControl(&mut control))?;
        Ok(control.value)
    }

    /// Sets a control and returns the value that the device took.
    fn set_control(&mut self, id: u32, value: i32) -> io::Result<i32> {
        self.call(Request::SetControl(&mut abi::Control { id, value }))?;
        self.control(id)
    }

    /// Sets size and format and returns what the device took.
    fn set_format(&mut self, size: (u32, u32), code: [u8; 4]) -> io::Result<abi::Format> {
        let mut format = abi::Format {
            buffer_type: CAPTURE,
            width: size.0,
            height: size.1,
            code: u32::from_ne_bytes(code),
            ..Default::default()
        };
        self.call(Request::SetFormat(&mut format))?;
        Ok(format)
    }

    /// Sets the rate and returns the one that the device took; `None` where it cannot be set.
    fn set_rate(&mut self, wanted_hz: f64) -> io::Result<Option<f64>> {
        let mut parameters = Parameters {
            buffer_type: CAPTURE,
            numerator: 1000,
            denominator: (wanted_hz * 1000.0).round() as u32,
            ..Default::default()
        };
        let is_set = self.supports(Request::SetParameters(&mut parameters))?;
        let taken_hz = rate_hz(parameters.numerator, parameters.denominator);
        Ok(Some(taken_hz).filter(|taken_hz| is_set && *taken_hz > 0.0))
    }

    /// Maps and queues the buffers that the device grants, up to `count`, and starts streaming.
    fn start(&mut self, count: u32) -> io::Result<()> {
        let mut buffers =
            BufferRequest { count, buffer_type: CAPTURE, memory: MAPPED, ..Default::default() };
        self.call(Request::AllocateBuffers(&mut buffers))?;
        for index in 0..buffers.count {
            let mut buffer = Buffer::numbered(index);
            self.call(Request::QueryBuffer(&mut buffer))?;
            self.map(u64::from(buffer.offset), buffer.length as usize)?;
            self.queue(index)?;
        }
        self.call(Request::StreamOn(&mut { CAPTURE }))
    }

    fn stop(&mut self) -> io::Result<()> {
        self.call(Request::StreamOff(&mut { CAPTURE }))
    }

    /// Gives a buffer to the device to fill.
    fn queue(&mut self, index: u32) -> io::Result<()> {
        self.call(Request::QueueBuffer(&mut Buffer::numbered(index)))
    }

    /// Takes a filled buffer; `None` if there is none.
    fn dequeue(&mut self) -> io::Result<Option<Buffer>> {
        let mut buffer = Buffer::numbered(0);
        match self.call(Request::DequeueBuffer(&mut buffer)) {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(None),
            outcome => outcome.map(|()| Some(buffer)),
        }
    }

    /// The content of a dequeued buffer.
    fn content(&self, buffer: &Buffer) -> &[u8] {
        let bytes = self.mapped(buffer.index as usize);
        &bytes[..(buffer.bytes as usize).min(bytes.len())]
    }
}

/// The rate of an interval in seconds.
fn rate_hz(numerator: u32, denominator: u32) -> f64 {
    f64::from(denominator) / f64::from(numerator.max(1))
}

/// A four-character code without padding.
pub(super) fn code_text(code: [u8; 4]) -> String {
    String::from_utf8_lossy(&code).trim().to_owned()
}

/// Text of the driver, ended by a zero byte.
pub(super) fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).trim().to_owned()
}

/// "Exposure Time, Absolute" → `exposure_time_absolute`.
pub(super) fn control_name(text: &str) -> String {
    let words = text.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    words.map(str::to_ascii_lowercase).collect::<Vec<_>>().join("_")
}
