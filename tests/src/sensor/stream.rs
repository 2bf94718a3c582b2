//! Frames of all cameras in order of arrival.

use std::collections::BTreeMap;

use roundel_core::world::FrameObservations;

use super::{Sensing, Sensor};
use crate::arena::Arena;

/// Generates frames on demand, so that ten minutes of them need little memory.
#[derive(Clone, Debug)]
pub struct Stream<'a> {
    arena: &'a Arena,
    min_latency_s: f64,
    end_ns: i64,
    sensors: Vec<(Sensor<'a>, usize)>,
    /// By arrival and camera.
    waiting: BTreeMap<(i64, usize), FrameObservations>,
}

impl<'a> Stream<'a> {
    /// Every camera's frames for `seconds`.
    pub fn new(arena: &'a Arena, sensing: Sensing, seconds: f64) -> Self {
        let sensors =
            (0..arena.sites.len()).map(|index| (Sensor::new(arena, index, sensing), 0)).collect();
        Self {
            arena,
            min_latency_s: sensing.latency_s.0,
            end_ns: arena.start_ns + (seconds * 1e9) as i64,
            sensors,
            waiting: BTreeMap::new(),
        }
    }

    /// The camera whose next frame is captured first, and its capture time.
    fn next_exposure(&self) -> Option<(usize, i64)> {
        let exposure = |(index, (_, frame)): (usize, &(Sensor<'_>, usize))| {
            (index, self.arena.capture_time_ns(&self.arena.sites[index], *frame))
        };
        let next = self.sensors.iter().enumerate().map(exposure).min_by_key(|next| next.1);
        next.filter(|&(_, time_ns)| time_ns < self.end_ns)
    }
}

impl Iterator for Stream<'_> {
    type Item = FrameObservations;

    fn next(&mut self) -> Option<FrameObservations> {
        while let Some((index, time_ns)) = self.next_exposure() {
            // All later frames arrive after this.
            let earliest_ns = time_ns + (self.min_latency_s * 1e9) as i64;
            if self.waiting.first_key_value().is_some_and(|(key, _)| key.0 < earliest_ns) {
                break;
            }
            let (sensor, number) = &mut self.sensors[index];
            let frame = sensor.frame(*number);
            *number += 1;
            self.waiting.insert((frame.received_time.as_ns(), index), frame);
        }
        self.waiting.pop_first().map(|(_, frame)| frame)
    }
}
