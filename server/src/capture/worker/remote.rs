//! What a remote program has seen: nothing is searched here, the rest is as with frames.

use std::{sync::Arc, time::Instant};

use super::Worker;
use crate::capture::source::{Sighting, push::RemoteFigures};

impl Worker {
    /// Takes what was seen in a frame: counted, numbered, and handed to fusion.
    pub(super) fn take_seen(&mut self, sighting: Sighting) {
        let Sighting { mut observations, clock, skipped, figures } = sighting;
        if let Some(adoption) = self.parts.inbox.take() {
            self.adopt(adoption);
        }
        let now = self.parts.clock.now();
        self.frames += 1;
        self.dropped += skipped;
        observations.camera = self.parts.id;
        observations.frame = self.frames;
        self.rate.add(now);
        self.judge_pace(now, 1);
        let figures = figures.unwrap_or_else(|| {
            let camera = self.parts.pipeline.camera();
            RemoteFigures {
                width: camera.width(),
                height: camera.height(),
                ..RemoteFigures::default()
            }
        });
        if self.running_since.is_none() {
            self.running_since = Some(Instant::now());
            self.report_running((figures.width, figures.height), now);
        }
        self.find_place(&observations, now);
        let observations = Arc::new(observations);
        self.hand_to_fusion(observations.clone());
        self.parts.hub.update_camera(self.parts.id, |state| {
            state.frames = self.frames;
            // What its sender left out, and what never came from there.
            state.dropped = self.dropped + figures.dropped;
            state.broken = self.broken + figures.broken;
            state.capture_clock = Some(clock);
            state.rate_hz = self.rate.hz();
            state.detections = observations.detections.len();
            (state.detect_ms, state.decode_ms) = (figures.detect_ms, figures.decode_ms);
            (state.blur_px, state.noise) = (figures.blur_px, figures.noise);
        });
        self.parts.hub.publish_observations(observations);
    }
}
