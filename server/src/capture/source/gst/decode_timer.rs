//! Time that decoding a frame takes.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use gstreamer as gst;
use gstreamer::prelude::*;

/// Time from a frame's entry into the decoder to the next output; clones share it.
///
/// A decoder with one thread outputs a frame before it takes the next one: this is then its work. One with several
/// threads outputs an earlier frame: this is then the time for which decoding blocks the stream.
#[derive(Clone, Debug, Default)]
pub(super) struct DecodeTimer(Arc<Mutex<State>>);

#[derive(Debug, Default)]
struct State {
    entered: Option<Instant>,
    taken: Duration,
}

impl DecodeTimer {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The time of the newest frame; zero if nothing is decoded.
    pub(super) fn newest(&self) -> Duration {
        self.lock().taken
    }

    /// Measures an element if it decodes pictures; of a bin, its elements are measured.
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
            this.lock().entered = Some(Instant::now());
            gst::PadProbeReturn::Ok
        });
        let this = self.clone();
        src.add_probe(gst::PadProbeType::BUFFER, move |_, _| {
            let mut state = this.lock();
            state.taken = state.entered.map_or(Duration::ZERO, |entered| entered.elapsed());
            gst::PadProbeReturn::Ok
        });
    }
}
