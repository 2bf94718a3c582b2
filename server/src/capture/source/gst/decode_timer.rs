//! What decoding a frame takes.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use gstreamer as gst;
use gstreamer::prelude::*;

/// From a frame's way into the decoder to the next way out, of the newest frame.
///
/// A decoder that works in one thread gives a frame out before it takes the next one in: this is then its work. One
/// with several threads gives out an earlier frame: this is then the time that decoding holds the stream up.
#[derive(Clone, Debug)]
pub(super) struct DecodeTimer {
    since: Instant,
    /// ns after `since`.
    entered: Arc<AtomicU64>,
    taken_ns: Arc<AtomicU64>,
}

impl Default for DecodeTimer {
    fn default() -> Self {
        Self { since: Instant::now(), entered: Arc::default(), taken_ns: Arc::default() }
    }
}

impl DecodeTimer {
    /// Of the newest frame; zero where nothing is decoded.
    pub(super) fn newest(&self) -> Duration {
        Duration::from_nanos(self.taken_ns.load(Ordering::Relaxed))
    }

    fn elapsed_ns(&self) -> u64 {
        u64::try_from(self.since.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }

    /// Watches an element if it decodes pictures; bins are watched by what is in them.
    pub(super) fn watch(&self, element: &gst::Element) {
        let decodes = element.factory().is_some_and(|factory| {
            factory.has_type(gst::ElementFactoryType::DECODER)
                && !factory.has_type(gst::ElementFactoryType::MEDIA_AUDIO)
        });
        let pads = element.static_pad("sink").zip(element.static_pad("src"));
        let Some((sink, src)) = pads.filter(|_| decodes && !element.is::<gst::Bin>()) else {
            return;
        };
        let this = self.clone();
        sink.add_probe(gst::PadProbeType::BUFFER, move |_, _| {
            this.entered.store(this.elapsed_ns(), Ordering::Relaxed);
            gst::PadProbeReturn::Ok
        });
        let this = self.clone();
        src.add_probe(gst::PadProbeType::BUFFER, move |_, _| {
            let taken_ns = this.elapsed_ns().saturating_sub(this.entered.load(Ordering::Relaxed));
            this.taken_ns.store(taken_ns, Ordering::Relaxed);
            gst::PadProbeReturn::Ok
        });
    }
}
