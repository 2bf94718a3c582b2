//! A fake driver that answers each ioctl as a UVC camera does.

use std::{
    collections::{BTreeMap, VecDeque},
    io,
    path::Path,
};

use roundel_core::time::Timestamp;

use super::{
    abi::{CAPTURE, DISCRETE, MAPPED, NEXT_CONTROL, Request},
    device::{Driver, control_name},
    listing::query,
    *,
};
use crate::model::{address::SourceAddress, clock::Clock, stop::StopSignal};

const WIDTH: u32 = 8;
const HEIGHT: u32 = 4;
/// The machine's clock in the tests.
const NOW_NS: i64 = 50_000_000_000;

const EXPOSURE: u32 = 0x009A_0902;
const AUTO_EXPOSURE: u32 = 0x009A_0901;

/// A frame that the camera will have: sequence, flags, age in ms, content.
type Coming = (u32, u32, i64, Vec<u8>);

type Listed = ([u8; 4], Vec<(u32, u32)>, Vec<u32>);

#[derive(Default)]
struct Camera {
    formats: Vec<Listed>,
    /// Id → name, least, most, value.
    controls: BTreeMap<u32, (&'static str, i32, i32, i32)>,
    coming: VecDeque<Coming>,
    buffers: Vec<Vec<u8>>,
    /// Buffers that the camera may fill.
    queued: VecDeque<u32>,
    filled: VecDeque<(u32, Coming)>,
    set: Option<([u8; 4], u32, u32)>,
    /// Error of the next request.
    fails: Option<Errno>,
}

fn put_text(bytes: &mut [u8], text: &str) {
    bytes[..text.len()].copy_from_slice(text.as_bytes());
}

impl Camera {
    fn sizes_and_rates(&self, code: u32) -> Result<&Listed, Errno> {
        self.formats.iter().find(|it| it.0 == code.to_ne_bytes()).ok_or(Errno::INVAL)
    }

    fn answer(&mut self, request: Request<'_>) -> Result<(), Errno> {
        match request {
            Request::QueryCapability(capability) => {
                put_text(&mut capability.card, "Test Camera");
                put_text(&mut capability.bus, "usb-0000:00:14.0-1");
                (capability.driver, capability.device) = (0x84A0_0001, 0x0420_0001);
            }
            Request::EnumFormat(format) => {
                assert_eq!(format.buffer_type, CAPTURE);
                let (code, ..) = self.formats.get(format.index as usize).ok_or(Errno::INVAL)?;
                format.code = u32::from_ne_bytes(*code);
                put_text(&mut format.description, "driver's description");
            }
            Request::EnumSize(size) => {
                let (_, sizes, _) = self.sizes_and_rates(size.code)?;
                let found = sizes.get(size.index as usize).ok_or(Errno::INVAL)?;
                (size.kind, (size.width, size.height)) = (DISCRETE, *found);
            }
            Request::EnumInterval(interval) => {
                let (_, _, rates) = self.sizes_and_rates(interval.code)?;
                let rate = rates.get(interval.index as usize).ok_or(Errno::INVAL)?;
                interval.kind = DISCRETE;
                (interval.numerator, interval.denominator) = (1, *rate);
            }
            Request::QueryControl(control) => {
                let next = self.controls.range((control.id & !NEXT_CONTROL) + 1..).next();
                let (id, (name, least, most, _)) = next.ok_or(Errno::INVAL)?;
                // Manual exposure is active where the automatic one is off.
                let automatic = self.controls.get(&AUTO_EXPOSURE).is_some_and(|it| it.3 != 1);
                control.flags = if *id == EXPOSURE && automatic { 0x10 } else { 0 };
                put_text(&mut control.name, name);
                (control.id, control.kind, control.step) = (*id, 1, 1);
                (control.least, control.most) = (*least, *most);
            }
            Request::GetControl(control) => {
                control.value = self.controls.get(&control.id).ok_or(Errno::INVAL)?.3;
            }
            Request::SetControl(control) => {
                self.controls.get_mut(&control.id).ok_or(Errno::INVAL)?.3 = control.value;
            }
            Request::SetFormat(format) => {
                let code = format.code.to_ne_bytes();
                format.stride = if code == *b"YUYV" { 2 * format.width } else { format.width };
                self.set = Some((code, format.width, format.height));
            }
            Request::AllocateBuffers(buffers) => {
                assert_eq!(buffers.memory, MAPPED);
                // Grants fewer than requested.
                buffers.count = buffers.count.min(3);
            }
            Request::QueryBuffer(buffer) => {
                (buffer.offset, buffer.length) = (buffer.index * 4096, 1024);
            }
            Request::QueueBuffer(buffer) => {
                assert_eq!((buffer.buffer_type, buffer.memory), (CAPTURE, MAPPED));
                self.queued.push_back(buffer.index);
            }
            Request::DequeueBuffer(buffer) => {
                let filled = self.filled.pop_front().ok_or(Errno::AGAIN)?;
                let (index, (sequence, flags, age_ms, content)) = filled;
                (buffer.index, buffer.sequence, buffer.flags) = (index, sequence, flags);
                buffer.bytes = content.len() as u32;
                let taken_us = (NOW_NS - age_ms * 1_000_000) / 1000;
                (buffer.seconds, buffer.microseconds) =
                    (taken_us / 1_000_000, taken_us % 1_000_000);
            }
            Request::SetParameters(_) | Request::StreamOn(_) | Request::StreamOff(_) => {}
        }
        Ok(())
    }
}

impl Driver for Camera {
    fn call(&mut self, request: Request<'_>) -> io::Result<()> {
        match self.fails.take() {
            Some(error) => Err(error.into()),
            None => Ok(self.answer(request)?),
        }
    }

    fn map(&mut self, offset: u64, length: usize) -> io::Result<()> {
        assert_eq!(offset, self.buffers.len() as u64 * 4096);
        self.buffers.push(vec![0; length]);
        Ok(())
    }

    fn mapped(&self, index: usize) -> &[u8] {
        assert!(!self.queued.contains(&(index as u32)), "buffer {index} is the camera's");
        &self.buffers[index]
    }

    /// The camera fills as many buffers as it has.
    fn wait(&mut self, _: Duration) -> io::Result<bool> {
        while let Some(index) = self.queued.pop_front() {
            let Some(coming) = self.coming.pop_front() else {
                self.queued.push_front(index);
                break;
            };
            self.buffers[index as usize][..coming.3.len()].copy_from_slice(&coming.3);
            self.filled.push_back((index, coming));
        }
        Ok(!self.filled.is_empty())
    }

    fn monotonic_ns(&self) -> i64 {
        NOW_NS
    }
}

fn camera(formats: &[&[u8; 4]]) -> Camera {
    let sizes = vec![(640, 480), (WIDTH, HEIGHT)];
    let formats = formats.iter().map(|code| (**code, sizes.clone(), vec![60, 30, 15]));
    let controls = [
        (AUTO_EXPOSURE, ("Auto Exposure", 0, 3, 3)),
        (EXPOSURE, ("Exposure Time, Absolute", 3, 2047, 250)),
    ];
    Camera { formats: formats.collect(), controls: controls.into(), ..Camera::default() }
}

fn start(camera: Camera, options: &str) -> Result<V4l2Source<Camera>, String> {
    let url = format!("v4l2:/dev/video0?{options}");
    let Ok(SourceAddress::Device(address)) = SourceAddress::parse(&url, Path::new("/")) else {
        panic!("{url}")
    };
    let clock = Clock::anchored(Instant::now(), Timestamp::from_ns(1_700_000_000_000_000_000));
    let size = (WIDTH as usize, HEIGHT as usize);
    let parts = SourceParts { size, clock, stop: StopSignal::default() };
    let source = V4l2Source::start(camera, &address, parts);
    source.map_err(|error| error.to_string())
}

/// Level in every luma byte of packed YUV.
fn packed(level: u8) -> Vec<u8> {
    [level, 128].repeat((WIDTH * HEIGHT) as usize)
}

#[test]
fn formats_and_controls_are_listed() {
    let mut device = camera(&[b"MJPG", b"H264"]);
    let listing = query(&mut device).unwrap().unwrap();
    assert_eq!(
        (listing.card.as_str(), listing.bus.as_str()),
        ("Test Camera", "usb-0000:00:14.0-1")
    );
    assert_eq!(listing.formats.len(), 4);
    let read: Vec<bool> = listing.formats.iter().map(|format| format.is_read).collect();
    assert_eq!(read, [true, true, false, false]);
    assert_eq!(listing.formats[1].rates_hz, [60.0, 30.0, 15.0]);
    let names: Vec<&str> = listing.controls.iter().map(|control| control.name.as_str()).collect();
    assert_eq!(names, ["auto_exposure", "exposure_time_absolute"]);
    assert_eq!((listing.controls[1].least, listing.controls[1].most), (3, 2047));
    assert!(!listing.controls[1].is_settable, "while the automatic is on");
    assert_eq!(control_name("White Balance Temperature, Auto"), "white_balance_temperature_auto");
}

#[test]
fn the_cheapest_format_that_is_fast_enough_is_taken() {
    let taken = |camera: Camera, options: &str| {
        let source = start(camera, options).unwrap();
        (source.device.set.unwrap().0, source.choice.rate_hz)
    };
    assert_eq!(taken(camera(&[b"MJPG", b"YUYV", b"NV12"]), ""), (*b"NV12", Some(30.0)));
    assert_eq!(taken(camera(&[b"MJPG", b"YUYV"]), "fps=50"), (*b"YUYV", Some(60.0)));
    assert_eq!(taken(camera(&[b"MJPG", b"YUYV"]), "format=MJPG"), (*b"MJPG", Some(30.0)));
    // A full bus: raw frames come five times a second.
    let mut slow = camera(&[b"YUYV", b"MJPG"]);
    slow.formats[0].2 = vec![5];
    assert_eq!(taken(slow, ""), (*b"MJPG", Some(30.0)));
}

#[test]
fn controls_are_set_in_their_order() {
    let options = "auto_exposure=1&exposure_time_absolute=40";
    let source = start(camera(&[b"NV12"]), options).unwrap();
    let controls = &source.device.controls;
    assert_eq!((controls[&AUTO_EXPOSURE].3, controls[&EXPOSURE].3), (1, 40));
}

#[test]
fn wrong_options_are_rejected_with_the_valid_ones() {
    let nv12 = || camera(&[b"NV12"]);
    for (camera, options, expected) in [
        (nv12(), "exposure_time_absolute=40", "`exposure_time_absolute` is set by another control"),
        (nv12(), "auto_exposure=9", "`auto_exposure` must be from 0 to 3 in steps of 1, found 9"),
        (nv12(), "exposure=40", "has no control `exposure`"),
        (nv12(), "format=GREY", "for 8 x 4 pixels as GREY; it has NV12 640x480 8x4; choose one"),
        (camera(&[b"H264"]), "", "it has H264 (not read) 640x480 8x4"),
        (Camera { fails: Some(Errno::BUSY), ..nv12() }, "", "another program uses it"),
    ] {
        let Err(message) = start(camera, options) else { panic!("{options} was accepted") };
        assert!(message.starts_with("/dev/video0: ") && message.contains(expected), "{message}");
    }
}

#[test]
fn frames_have_the_drivers_time_and_the_newest_wins() {
    let mut camera = camera(&[b"YUYV"]);
    // Monotonic stamps.
    let frame = |sequence, age_ms, level| (sequence, 0x2000, age_ms, packed(level));
    camera.coming = [frame(7, 60, 10), frame(8, 30, 20), frame(11, 12, 30)].into();
    let mut source = start(camera, "").unwrap();
    let clock = source.parts.clock;
    let lent = source.next_frame().unwrap();
    assert_eq!((lent.frame.width(), lent.frame.height()), (8, 4));
    assert!((0..4).all(|v| lent.frame.row(v) == [30; 8]), "the newest");
    assert_eq!((lent.info.clock, lent.info.broken), (CaptureClock::DRIVER, 0));
    let age_s = clock.now().seconds_since(lent.info.capture_time);
    assert!((0.012..1.0).contains(&age_s), "{age_s}");
    // All buffers but the lent one are queued.
    assert_eq!(source.device.queued.len(), 2);

    // A damaged frame and a whole one; the two before it found no buffer.
    let damaged = (12, 0x2040, 5, packed(40));
    source.device.coming = [damaged, frame(15, 0, 50)].into();
    let lent = source.next_frame().unwrap();
    assert_eq!(lent.frame.row(0), [50; 8]);
    assert_eq!(source.device.queued.len(), 2);
}

#[test]
fn luma_planes_are_lent_where_the_driver_put_them() {
    let mut camera = camera(&[b"NV12"]);
    let luma: Vec<u8> = (0..WIDTH * HEIGHT).map(|at| at as u8).collect();
    camera.coming = [(1, 0, 0, [luma, vec![128; 16]].concat())].into();
    let mut source = start(camera, "").unwrap();
    let (lent, at) = {
        let lent = source.next_frame().unwrap();
        assert_eq!(lent.frame.row(3), [24, 25, 26, 27, 28, 29, 30, 31]);
        assert_eq!(lent.info.clock, CaptureClock::ARRIVAL, "it does not say which clock it has");
        (lent.frame.row(0).as_ptr(), source.lent.unwrap() as usize)
    };
    assert!(std::ptr::eq(lent, source.device.buffers[at].as_ptr()), "copied");
}

#[test]
fn an_unplugged_camera_is_reported() {
    let mut source = start(camera(&[b"NV12"]), "").unwrap();
    source.device.coming = [(1, 0x2000, 0, vec![9; 48])].into();
    source.next_frame().unwrap();
    source.device.fails = Some(Errno::NODEV);
    let message = source.next_frame().unwrap_err().to_string();
    assert!(message.starts_with("/dev/video0: "), "{message}");
    assert!(message.contains("it was unplugged"), "{message}");
}

#[test]
fn silence_is_a_stall() {
    let mut source = start(camera(&[b"NV12"]), "").unwrap();
    source.patience = Duration::from_millis(30);
    let message = source.next_frame().unwrap_err().to_string();
    assert!(message.contains("stalled: no picture for 0.0 s; another program"), "{message}");
}
