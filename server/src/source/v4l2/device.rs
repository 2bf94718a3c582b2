//! A video device: what it can do, how it is set, and its frames. Talks to the kernel through a [`Driver`] only.

use std::{io, time::Duration};

use super::abi::{
    Argument, BUFFER_ERROR, CAN_CAPTURE, CAN_STREAM, CAPTURE, CONTROL_DISABLED, CONTROL_INACTIVE,
    CONTROL_READ_ONLY, FORMAT_EMULATED, HAS_OWN, MAPPED, NEXT_CONTROL, Request, TIME_MASK,
    TIME_MONOTONIC, at,
};

/// Lists of a device that never end are ended here.
const MAX_LIST: u32 = 256;
/// A control's kinds that hold no number: buttons, headings, texts and the like.
const NUMBERS: [u32; 5] = [1, 2, 3, 8, 9];

/// The kernel's side of a device: the border of all that can be tested without one.
pub(super) trait Driver: Send {
    /// Puts a request; its answer replaces the argument.
    fn call(&mut self, request: Request, argument: &mut Argument) -> io::Result<()>;
    /// Makes a buffer of the device readable; buffers are numbered in the order in which they were mapped.
    fn map(&mut self, offset: u64, length: usize) -> io::Result<()>;
    /// The bytes of a mapped buffer.
    fn mapped(&self, index: usize) -> &[u8];
    /// Waits until a frame is there, at most so long; false: none came.
    fn wait(&mut self, longest: Duration) -> io::Result<bool>;
    /// The machine's monotonic clock.
    fn monotonic_ns(&self) -> i64;
}

/// What a device says of itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Capability {
    pub(super) card: String,
    pub(super) bus: String,
    /// Whether it gives frames.
    pub(super) captures: bool,
}

/// A pixel format, with the sizes and rates of it that the device lists.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Format {
    pub(super) code: [u8; 4],
    pub(super) description: String,
    /// Made by a library from another one.
    pub(super) emulated: bool,
    pub(super) sizes: Vec<Size>,
}

/// A size of a format.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Size {
    pub(super) width: u32,
    pub(super) height: u32,
    /// Frames a second, the fastest first.
    pub(super) rates_hz: Vec<f64>,
}

/// A control that holds a number.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Control {
    pub(super) id: u32,
    /// As `v4l2-ctl` writes it: `exposure_time_absolute`.
    pub(super) name: String,
    pub(super) least: i32,
    pub(super) most: i32,
    pub(super) step: i32,
    pub(super) default: i32,
    pub(super) value: i32,
    pub(super) read_only: bool,
    /// Another control decides.
    pub(super) inactive: bool,
}

/// What the device made of a wish.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Set {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) code: [u8; 4],
    pub(super) stride: u32,
}

/// A frame in one of the device's buffers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Filled {
    pub(super) index: u32,
    pub(super) bytes: usize,
    /// Counts the frames that the device has made, also those that found no buffer.
    pub(super) sequence: u32,
    /// On the monotonic clock, ns; `None`: the driver stamps otherwise.
    pub(super) monotonic_ns: Option<i64>,
    /// The device says that its content is not whole.
    pub(super) broken: bool,
}

/// A device that was opened.
#[derive(Debug)]
pub(super) struct Device<D> {
    pub(super) driver: D,
}

impl<D: Driver> Device<D> {
    pub(super) fn capability(&mut self) -> io::Result<Capability> {
        let mut answer = Argument::of(Request::QUERY_CAPABILITY);
        self.driver.call(Request::QUERY_CAPABILITY, &mut answer)?;
        let all = answer.u32(at::CAPABILITY_ALL);
        let own = if all & HAS_OWN == 0 { all } else { answer.u32(at::CAPABILITY_OWN) };
        Ok(Capability {
            card: answer.text(at::CAPABILITY_CARD, 32),
            bus: answer.text(at::CAPABILITY_BUS, 32),
            captures: own & CAN_CAPTURE != 0 && own & CAN_STREAM != 0,
        })
    }

    pub(super) fn formats(&mut self) -> io::Result<Vec<Format>> {
        let mut formats = Vec::new();
        for index in 0..MAX_LIST {
            let wish = Argument::of(Request::ENUM_FORMAT).with(0, index).with(4, CAPTURE);
            let Some(answer) = self.listed(Request::ENUM_FORMAT, wish)? else { break };
            let code = answer.u32(at::DESCRIPTION_FORMAT);
            formats.push(Format {
                code: code.to_ne_bytes(),
                description: answer.text(at::DESCRIPTION_TEXT, 32),
                emulated: answer.u32(at::DESCRIPTION_FLAGS) & FORMAT_EMULATED != 0,
                sizes: self.sizes(code)?,
            });
        }
        Ok(formats)
    }

    /// Sizes that are listed one by one; a device with steps of sizes lists none.
    fn sizes(&mut self, code: u32) -> io::Result<Vec<Size>> {
        let mut sizes = Vec::new();
        for index in 0..MAX_LIST {
            let wish = Argument::of(Request::ENUM_SIZES).with(0, index).with(4, code);
            let Some(answer) = self.listed(Request::ENUM_SIZES, wish)? else { break };
            if answer.u32(at::SIZE_TYPE) != 1 {
                break;
            }
            let (width, height) = (answer.u32(at::SIZE_WIDTH), answer.u32(at::SIZE_HEIGHT));
            let rates_hz = self.rates(code, width, height)?;
            sizes.push(Size { width, height, rates_hz });
        }
        Ok(sizes)
    }

    fn rates(&mut self, code: u32, width: u32, height: u32) -> io::Result<Vec<f64>> {
        let mut rates = Vec::new();
        for index in 0..MAX_LIST {
            let wish = Argument::of(Request::ENUM_INTERVALS)
                .with(0, index)
                .with(at::INTERVAL_FORMAT, code)
                .with(at::INTERVAL_WIDTH, width)
                .with(at::INTERVAL_HEIGHT, height);
            let Some(answer) = self.listed(Request::ENUM_INTERVALS, wish)? else { break };
            if answer.u32(at::INTERVAL_TYPE) != 1 {
                break;
            }
            let numerator = f64::from(answer.u32(at::INTERVAL_NUMERATOR).max(1));
            rates.push(f64::from(answer.u32(at::INTERVAL_DENOMINATOR)) / numerator);
        }
        rates.sort_by(|a, b| b.total_cmp(a));
        Ok(rates)
    }

    /// An entry of a list; `None` after the last one, and where the driver has no such list.
    fn listed(&mut self, request: Request, mut wish: Argument) -> io::Result<Option<Argument>> {
        match self.driver.call(request, &mut wish) {
            Ok(()) => Ok(Some(wish)),
            Err(error) if is_unknown(&error) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// All controls that hold a number, with their values.
    pub(super) fn controls(&mut self) -> io::Result<Vec<Control>> {
        let (mut controls, mut last) = (Vec::new(), 0);
        for _ in 0..MAX_LIST {
            let wish = Argument::of(Request::QUERY_CONTROL).with(0, last | NEXT_CONTROL);
            let Some(answer) = self.listed(Request::QUERY_CONTROL, wish)? else { break };
            last = answer.u32(0);
            let flags = answer.u32(at::CONTROL_FLAGS);
            if flags & CONTROL_DISABLED != 0 || !NUMBERS.contains(&answer.u32(at::CONTROL_KIND)) {
                continue;
            }
            // One that can only be written has no value to read.
            let Ok(value) = self.control(last) else { continue };
            controls.push(Control {
                id: last,
                name: control_name(&answer.text(at::CONTROL_NAME, 32)),
                least: answer.i32(at::CONTROL_LEAST),
                most: answer.i32(at::CONTROL_MOST),
                step: answer.i32(at::CONTROL_STEP),
                default: answer.i32(at::CONTROL_DEFAULT),
                value,
                read_only: flags & CONTROL_READ_ONLY != 0,
                inactive: flags & CONTROL_INACTIVE != 0,
            });
        }
        Ok(controls)
    }

    pub(super) fn control(&mut self, id: u32) -> io::Result<i32> {
        let mut answer = Argument::of(Request::GET_CONTROL).with(0, id);
        self.driver.call(Request::GET_CONTROL, &mut answer)?;
        Ok(answer.i32(at::VALUE))
    }

    /// Sets a control, and reads back what became of it.
    pub(super) fn set_control(&mut self, id: u32, value: i32) -> io::Result<i32> {
        let mut wish = Argument::of(Request::SET_CONTROL).with(0, id).with(at::VALUE, value as u32);
        self.driver.call(Request::SET_CONTROL, &mut wish)?;
        self.control(id)
    }

    pub(super) fn set_format(&mut self, size: (u32, u32), code: [u8; 4]) -> io::Result<Set> {
        let mut wish = Argument::of(Request::SET_FORMAT)
            .with(0, CAPTURE)
            .with(at::FORMAT_WIDTH, size.0)
            .with(at::FORMAT_HEIGHT, size.1)
            .with(at::FORMAT_CODE, u32::from_ne_bytes(code));
        self.driver.call(Request::SET_FORMAT, &mut wish)?;
        Ok(Set {
            width: wish.u32(at::FORMAT_WIDTH),
            height: wish.u32(at::FORMAT_HEIGHT),
            code: wish.u32(at::FORMAT_CODE).to_ne_bytes(),
            stride: wish.u32(at::FORMAT_STRIDE),
        })
    }

    /// Asks for a rate; returns the one that the device takes, or `None` where it cannot be set.
    pub(super) fn set_rate(&mut self, rate_hz: f64) -> io::Result<Option<f64>> {
        let mut wish = Argument::of(Request::SET_PARAMETERS)
            .with(0, CAPTURE)
            .with(at::PARAMETERS_NUMERATOR, 1000)
            .with(at::PARAMETERS_DENOMINATOR, (rate_hz * 1000.0).round() as u32);
        match self.driver.call(Request::SET_PARAMETERS, &mut wish) {
            Ok(()) => {
                let numerator = f64::from(wish.u32(at::PARAMETERS_NUMERATOR).max(1));
                let rate = f64::from(wish.u32(at::PARAMETERS_DENOMINATOR)) / numerator;
                Ok(Some(rate).filter(|rate| *rate > 0.0))
            }
            Err(error) if is_unknown(&error) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Makes buffers, hands them to the device and starts it. Returns how many it has.
    pub(super) fn start(&mut self, buffers: u32) -> io::Result<u32> {
        let mut wish = Argument::of(Request::REQUEST_BUFFERS)
            .with(0, buffers)
            .with(at::REQUESTED_TYPE, CAPTURE)
            .with(at::REQUESTED_MEMORY, MAPPED);
        self.driver.call(Request::REQUEST_BUFFERS, &mut wish)?;
        let count = wish.u32(0);
        for index in 0..count {
            let mut buffer = buffer(Request::QUERY_BUFFER, index);
            self.driver.call(Request::QUERY_BUFFER, &mut buffer)?;
            let length = buffer.u32(at::BUFFER_LENGTH) as usize;
            self.driver.map(u64::from(buffer.u32(at::BUFFER_OFFSET)), length)?;
            self.give_back(index)?;
        }
        let mut kind = Argument(CAPTURE.to_ne_bytes().to_vec());
        self.driver.call(Request::STREAM_ON, &mut kind)?;
        Ok(count)
    }

    pub(super) fn stop(&mut self) -> io::Result<()> {
        let mut kind = Argument(CAPTURE.to_ne_bytes().to_vec());
        self.driver.call(Request::STREAM_OFF, &mut kind)
    }

    /// Lets the device fill a buffer again.
    pub(super) fn give_back(&mut self, index: u32) -> io::Result<()> {
        self.driver.call(Request::QUEUE, &mut buffer(Request::QUEUE, index))
    }

    /// A frame that is there; `None`: none is.
    pub(super) fn take(&mut self) -> io::Result<Option<Filled>> {
        let mut answer = buffer(Request::DEQUEUE, 0);
        match self.driver.call(Request::DEQUEUE, &mut answer) {
            Ok(()) => {}
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(None),
            Err(error) => return Err(error),
        }
        let flags = answer.u32(at::BUFFER_FLAGS);
        let seconds = answer.i64(at::BUFFER_SECONDS);
        let monotonic_ns = seconds * 1_000_000_000 + answer.i64(at::BUFFER_MICROSECONDS) * 1000;
        Ok(Some(Filled {
            index: answer.u32(0),
            bytes: answer.u32(at::BUFFER_USED) as usize,
            sequence: answer.u32(at::BUFFER_SEQUENCE),
            monotonic_ns: (flags & TIME_MASK == TIME_MONOTONIC).then_some(monotonic_ns),
            broken: flags & BUFFER_ERROR != 0,
        }))
    }
}

fn buffer(request: Request, index: u32) -> Argument {
    Argument::of(request)
        .with(0, index)
        .with(at::BUFFER_TYPE, CAPTURE)
        .with(at::BUFFER_MEMORY, MAPPED)
}

/// EINVAL ends a list, ENOTTY says that there is none.
fn is_unknown(error: &io::Error) -> bool {
    matches!(error.raw_os_error(), Some(22 | 25))
}

/// "Exposure Time, Absolute" → `exposure_time_absolute`.
pub(super) fn control_name(text: &str) -> String {
    let words = text.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    words.map(str::to_ascii_lowercase).collect::<Vec<_>>().join("_")
}
