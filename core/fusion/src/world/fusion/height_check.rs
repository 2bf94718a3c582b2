//! Configured heights of objects on a floor, compared with what cameras measure.

use super::{Fusion, MotionClass};
use crate::world::{WrongHeight, height_check::ConstrainedHeight, identity::Subject};

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
            if let Some(heights) = self.constrained_height(&subject) {
                self.height_checks.observe(subject, &self.sightings[index].measurement, heights);
            }
        }
    }

    /// Heights to which the tracked point and the origin of a subject are constrained.
    fn constrained_height(&self, subject: &Subject) -> Option<ConstrainedHeight> {
        if let Some(body) = subject.body {
            return self.bodies.constrained_height(body);
        }
        match self.classes.get(&subject.kind?)? {
            MotionClass::Ground { height_m: Some(height_m) } => {
                Some(ConstrainedHeight { tracked_m: *height_m, configured_m: *height_m })
            }
            MotionClass::Ground { height_m: None } | MotionClass::Free => None,
        }
    }
}
