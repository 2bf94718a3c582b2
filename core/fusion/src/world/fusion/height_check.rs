//! Configured heights of objects on a floor, compared with what cameras measure.

use super::{Fusion, MotionClass};
use crate::world::{WrongHeight, identity::Subject};

impl Fusion {
    /// Takes the wrong heights found since the last call. Each is reported once, until cameras agree with it
    /// again.
    pub fn drain_wrong_heights(&mut self) -> impl Iterator<Item = WrongHeight> + '_ {
        self.height_checks.drain()
    }

    /// Adds the current sightings to the checks of their heights.
    pub(super) fn check_heights(&mut self) {
        for index in 0..self.sightings.len() {
            let subject = self.sightings[index].subject;
            if let Some(heights_m) = self.heights_m(&subject) {
                self.height_checks.observe(subject, &self.sightings[index].measurement, heights_m);
            }
        }
    }

    /// Heights to which the tracked point and the origin of a subject are constrained.
    fn heights_m(&self, subject: &Subject) -> Option<(f64, f64)> {
        if let Some(body) = subject.body {
            return self.bodies.heights_m(body);
        }
        match self.classes.get(&subject.kind?)? {
            MotionClass::Ground { height_m: Some(height_m) } => Some((*height_m, *height_m)),
            MotionClass::Ground { height_m: None } | MotionClass::Free => None,
        }
    }
}
