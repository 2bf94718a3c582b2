//! `rtsp://…`, `file:` and `gst:` – sources that GStreamer receives and decodes.
//!
//! One pipeline for all: the elements of the address, then an appsink that keeps the newest frame. A luma plane is lent
//! from GStreamer's buffer without a copy. The pipeline's clock is the machine's monotonic one, like the server's, so a
//! frame's running time gives its capture time.
//!
//! | address | capture time |
//! | --- | --- |
//! | `rtsp://` | the camera's NTP time, from its sender reports; mapped to the server's clock if the camera's clock is not synchronized; before the first report: arrival |
//! | `file:` | when it is due; `speed=max`: when it is returned |
//! | `gst:` | base time + time stamp. If the camera's counter stamps the frames, as with `aravissrc`: the counter mapped to the server's clock, from which it drifts |

mod decode_timer;
mod launch;
mod pinned;
mod plugin;

use std::{
    io,
    sync::atomic::{AtomicU64, Ordering},
    time::{Duration, Instant},
};

use gstreamer as gst;
use gstreamer::prelude::*;
use gstreamer_app::AppSink;
use gstreamer_video as gst_video;
use gstreamer_video::prelude::*;
use roundel_core::time::Timestamp;

use super::{
    CaptureClock, FrameInfo, FrameSource, LentFrame, SourceError, SourceParts, bad_frame,
    mailbox::stalled,
    pixels::{GreyConverter, PixelFormat, RawImage, SampleFormat},
    timing::CameraTimeline,
    wrong_size,
};
use crate::model::{address::MediaAddress, regular_file, source_rules::SourceRules};
use decode_timer::DecodeTimer;

/// How often a wait checks the stop signal and the pipeline.
const POLL_INTERVAL: gst::ClockTime = gst::ClockTime::from_mseconds(20);
/// Timeout of the first frame: connection, negotiation, the first key frame.
const FIRST_FRAME: Duration = Duration::from_secs(10);
/// Seconds from NTP's epoch to the Unix epoch.
const UNIX_FROM_NTP_S: u64 = 2_208_988_800;
/// A camera's clock is synchronized if its frames arrive at most this long before and after their NTP time.
const STEP_EARLY_S: f64 = 0.5;
const STEP_LATE_S: f64 = 5.0;

pub(super) struct GstSource {
    pipeline: gst::Pipeline,
    bus: gst::Bus,
    sink: AppSink,
    address: MediaAddress,
    parts: SourceParts,
    timeline: CameraTimeline,
    converter: GreyConverter,
    current: Option<gst_video::VideoFrame<gst_video::video_frame::Readable>>,
    /// The number of the newest frame, as [`number_frames`] gave it.
    newest: u64,
    patience: Duration,
    /// Errors of missing plugins.
    missing: Vec<String>,
    decoding: DecodeTimer,
    /// Whether the camera's counter stamps the frames, not this machine's clock.
    has_camera_timestamps: bool,
    promised_hz: Option<f64>,
    /// A client named the source.
    is_bound: bool,
}

impl GstSource {
    /// `rules`: those that bind the source, if it is not one of the configuration file.
    pub(super) fn open(
        address: &MediaAddress,
        rules: Option<&SourceRules>,
        parts: SourceParts,
    ) -> Result<Self, SourceError> {
        let failed = SourceError::Failed;
        // GStreamer would wait for a pipe. It reports a missing file itself.
        if let MediaAddress::File { path, .. } = address
            && let Err(error) = regular_file::open(path)
            && error.kind() == io::ErrorKind::InvalidInput
        {
            return Err(failed(format!("{address}: cannot play it: {error}")));
        }
        gst::init().map_err(|error| failed(format!("GStreamer does not start: {error}")))?;
        let pinned = match rules {
            Some(rules) => &pinned::pin(address, rules, &parts.stop)?,
            None => address,
        };
        let (pipeline, sink, decoding) = launch::launch(pinned).map_err(failed)?;
        if rules.is_some() {
            pinned::reject_redirects(&pipeline);
        }
        let bus = pipeline.bus().ok_or_else(|| failed("the pipeline has no bus".to_owned()))?;
        number_frames(&sink);
        pipeline.use_clock(Some(&gst::SystemClock::obtain()));
        let has_camera_timestamps = launch::has_camera_timestamps(&pipeline);
        let mut source = Self {
            pipeline,
            bus,
            sink,
            address: address.clone(),
            parts,
            timeline: CameraTimeline::default(),
            converter: GreyConverter::default(),
            current: None,
            newest: 0,
            patience: FIRST_FRAME.max(address.stall()),
            missing: Vec::new(),
            decoding,
            has_camera_timestamps,
            promised_hz: None,
            is_bound: rules.is_some(),
        };
        if source.pipeline.set_state(gst::State::Playing).is_err() {
            source.check_bus()?;
            return Err(failed(source.named("the pipeline does not start")));
        }
        Ok(source)
    }

    /// Waits for the newest sample.
    fn sample(&mut self) -> Result<gst::Sample, SourceError> {
        let begun = Instant::now();
        loop {
            if self.parts.stop.is_stopped() {
                return Err(SourceError::Stopped);
            }
            if let Some(sample) = self.sink.try_pull_sample(POLL_INTERVAL) {
                self.patience = self.address.stall();
                return Ok(sample);
            }
            self.check_bus()?;
            if self.sink.is_eos() {
                self.end()?;
            }
            if begun.elapsed() >= self.patience {
                if self.hides_failures() {
                    return Err(SourceError::Failed(pinned::no_answer(&self.address)));
                }
                return Err(SourceError::Failed(self.named(&stalled(self.patience, "", 0))));
            }
        }
    }

    /// Returns an error that the pipeline has reported.
    fn check_bus(&mut self) -> Result<(), SourceError> {
        while let Some(message) = self.bus.pop() {
            match message.view() {
                gst::MessageView::Element(element) => {
                    let structure = element.structure();
                    self.missing.extend(structure.and_then(plugin::missing));
                }
                gst::MessageView::Error(error)
                    if self.hides_failures() && !pinned::is_answer(&error.error()) =>
                {
                    return Err(SourceError::Failed(pinned::no_answer(&self.address)));
                }
                gst::MessageView::Error(error) => {
                    let what = error.error().to_string();
                    let element = error.src().map(|source| source.name().to_string());
                    let debug = error.debug().map(|debug| debug.to_string()).unwrap_or_default();
                    return Err(SourceError::Failed(self.describe_error(
                        &what,
                        element.as_deref(),
                        &debug,
                    )));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Whether an error must not reveal why a connection failed.
    fn hides_failures(&self) -> bool {
        let is_network = matches!(self.address, MediaAddress::Rtsp { .. });
        self.is_bound && is_network && self.newest == 0 && self.missing.is_empty()
    }

    fn describe_error(&self, what: &str, element: Option<&str>, debug: &str) -> String {
        if let Some(missing) = self.missing.first() {
            return self.named(missing);
        }
        // The lines before the last one name places in GStreamer's sources.
        let last = debug.lines().last().filter(|line| !line.contains("gst"));
        let detail = last.map(|line| line.trim_end_matches('.')).or(element);
        let detail = detail.map(|detail| format!(" ({detail})")).unwrap_or_default();
        let remedy = plugin::remedy(what, debug).map(|remedy| format!("; {remedy}"));
        let what = what.trim_end_matches('.');
        self.named(&format!("{what}{detail}{}", remedy.unwrap_or_default()))
    }

    fn named(&self, what: &str) -> String {
        format!("{}: {what}", self.address)
    }

    /// Handles the end of the stream: a repeated file starts again.
    fn end(&mut self) -> Result<(), SourceError> {
        match &self.address {
            MediaAddress::File { repeat: true, .. } => {
                let flags = gst::SeekFlags::FLUSH | gst::SeekFlags::KEY_UNIT;
                let seek = self.pipeline.seek_simple(flags, gst::ClockTime::ZERO);
                seek.map_err(|_| SourceError::Failed(self.named("cannot seek to the beginning")))
            }
            MediaAddress::File { .. } => Err(SourceError::Finished),
            _ => Err(SourceError::Failed(self.named("the stream has ended"))),
        }
    }

    /// Capture time of a sample, and its clock.
    fn time(&mut self, sample: &gst::Sample) -> (Timestamp, CaptureClock) {
        let now = self.parts.clock.now();
        let buffer = sample.buffer();
        if let Some(ntp_ns) = buffer.and_then(ntp_ns) {
            let unix_ns = ntp_ns - UNIX_FROM_NTP_S as i64 * 1_000_000_000;
            let age_s = now.seconds_since(Timestamp::from_ns(unix_ns));
            if (-STEP_EARLY_S..STEP_LATE_S).contains(&age_s) {
                return (Timestamp::from_ns(unix_ns), CaptureClock::SYNCHRONIZED);
            }
            return (self.timeline.capture_time(unix_ns, now), CaptureClock::CAMERA);
        }
        let segment = sample.segment().and_then(|segment| segment.downcast_ref::<gst::ClockTime>());
        let running = segment.zip(buffer.and_then(|buffer| buffer.pts()));
        let running = running.and_then(|(segment, pts)| segment.to_running_time(pts));
        if let Some(count) = running.filter(|_| self.has_camera_timestamps) {
            let count_ns = i64::try_from(count.nseconds()).unwrap_or(i64::MAX);
            return (self.timeline.capture_time(count_ns, now), CaptureClock::CAMERA);
        }
        let due = running.zip(self.pipeline.base_time()).map(|(running, base)| base + running);
        let due = due.zip(self.pipeline.clock().map(|clock| clock.time()));
        let capture_time = due.map_or(now, |(due, clock_now)| {
            now.plus_ns(due.nseconds() as i64 - clock_now.nseconds() as i64)
        });
        match &self.address {
            // The time stamps are the arrivals of packets.
            MediaAddress::Rtsp { .. } => (capture_time.min(now), CaptureClock::ARRIVAL),
            MediaAddress::File { hurry: true, .. } => (now, CaptureClock::EXACT),
            MediaAddress::File { .. } => (capture_time, CaptureClock::EXACT),
            MediaAddress::Pipeline(_) => (capture_time.min(now), CaptureClock::DRIVER),
        }
    }

    /// Frame rate that the source announces. Rates that decoders derive from an H.264 stream are often wrong.
    fn promise(&self, video: &gst_video::VideoInfo) -> Option<f64> {
        match &self.address {
            // The session description has it.
            MediaAddress::Rtsp { .. } => {
                let origin = self.pipeline.by_name(launch::ORIGIN)?;
                let caps = origin.src_pads().iter().find_map(|pad| pad.current_caps())?;
                caps.structure(0)?.get::<&str>("a-framerate").ok()?.parse().ok()
            }
            MediaAddress::File { .. } => None,
            MediaAddress::Pipeline(_) => {
                let (frames, seconds) = (video.fps().numer(), video.fps().denom());
                Some(f64::from(frames) / f64::from(seconds))
            }
        }
    }
}

/// Numbers the buffers that reach the sink, from 1, so that those that it drops are counted.
fn number_frames(sink: &AppSink) {
    let Some(pad) = sink.static_pad("sink") else { return };
    let number = AtomicU64::new(1);
    pad.add_probe(gst::PadProbeType::BUFFER, move |_, info| {
        if let Some(buffer) = info.buffer_mut() {
            // Copies the metadata, not the pixels.
            buffer.make_mut().set_offset(number.fetch_add(1, Ordering::Relaxed));
        }
        gst::PadProbeReturn::Ok
    });
}

/// The camera's own time of a frame, ns since NTP's epoch.
fn ntp_ns(buffer: &gst::BufferRef) -> Option<i64> {
    let metas = buffer.iter_meta::<gst::ReferenceTimestampMeta>();
    let mut ntp = metas.filter(|meta| {
        meta.reference().structure(0).is_some_and(|it| it.name() == "timestamp/x-ntp")
    });
    ntp.next().and_then(|meta| i64::try_from(meta.timestamp().nseconds()).ok())
}

impl FrameSource for GstSource {
    fn is_paced(&self) -> bool {
        !matches!(self.address, MediaAddress::File { hurry: true, .. })
    }

    fn promised_hz(&self) -> Option<f64> {
        self.promised_hz.filter(|hz| (0.01..1e4).contains(hz))
    }

    fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
        let sample = self.sample()?;
        let number = sample.buffer().map_or(0, |buffer| buffer.offset());
        let skipped = number.saturating_sub(self.newest + 1);
        self.newest = number;
        let (capture_time, clock) = self.time(&sample);
        let decoding = self.decoding.newest();
        let info = FrameInfo { clock, skipped, decoding, ..FrameInfo::at(capture_time) };

        let caps = sample.caps().ok_or_else(|| bad_frame("a sample without caps"))?;
        let video = gst_video::VideoInfo::from_caps(caps).map_err(bad_frame)?;
        let found = (video.width() as usize, video.height() as usize);
        if found != self.parts.size {
            return Err(wrong_size(&self.address.to_string(), self.parts.size, found));
        }
        if self.current.is_none() {
            self.promised_hz = self.promise(&video);
        }
        let format = pixel_format(video.format())
            .ok_or_else(|| SourceError::Failed(self.named(&format!("found frames of {caps}"))))?;
        let buffer = sample.buffer_owned().ok_or_else(|| bad_frame("a sample without buffer"))?;
        let frame = gst_video::VideoFrame::from_buffer_readable(buffer, &video)
            .map_err(|_| bad_frame("a buffer that cannot be read"))?;
        // This returns the previous frame to GStreamer.
        let frame = self.current.insert(frame);
        let raw = RawImage {
            format,
            bytes: frame.plane_data(0).map_err(bad_frame)?,
            width: found.0,
            height: found.1,
            stride: usize::try_from(frame.plane_stride()[0]).map_err(bad_frame)?,
        };
        Ok(LentFrame { frame: self.converter.grey(&raw).map_err(bad_frame)?, info })
    }
}

/// Converts a format that the sink accepts.
fn pixel_format(format: gst_video::VideoFormat) -> Option<PixelFormat> {
    use gst_video::VideoFormat as Known;
    match format {
        Known::Gray8
        | Known::I420
        | Known::Yv12
        | Known::Nv12
        | Known::Nv21
        | Known::Y42b
        | Known::Nv16
        | Known::Y444 => Some(PixelFormat::GREY8),
        Known::Gray16Le => Some(PixelFormat::Grey(SampleFormat::Words(16))),
        Known::Yuy2 | Known::Yvyu => Some(PixelFormat::Packed { chroma_first: false }),
        Known::Uyvy => Some(PixelFormat::Packed { chroma_first: true }),
        _ => None,
    }
}

impl Drop for GstSource {
    fn drop(&mut self) {
        // A frame that is still lent would keep a driver's buffer.
        self.current = None;
        if self.pipeline.set_state(gst::State::Null).is_err() {
            tracing::warn!(source = %self.address, "the pipeline does not stop");
        }
    }
}
