//! Heights that were said of what drives, held against what cameras see.

use super::{Fusion, MotionClass};
use crate::world::{WrongHeight, identity::Subject};

impl Fusion {
    /// Takes what was found out since the last call of heights that were said wrong; each is told once, until
    /// cameras are content with it.
    pub fn drain_wrong_heights(&mut self) -> impl Iterator<Item = WrongHeight> + '_ {
        self.height_checks.drain()
    }

    /// Lets the present sightings speak for or against the heights of what they are of.
    pub(super) fn check_heights(&mut self) {
        for index in 0..self.sightings.len() {
            let subject = self.sightings[index].subject;
            if let Some(heights_m) = self.heights_m(&subject) {
                self.height_checks.observe(subject, &self.sightings[index].measurement, heights_m);
            }
        }
    }

    /// The height that something is held at by the point that is followed, and what was said of it.
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
