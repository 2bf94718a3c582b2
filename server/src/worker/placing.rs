//! Finds the place of a camera whose pose is unknown, from the reference roundels that it sees.
//!
//! What its tracker holds throughout a window of frames is averaged, so that noise is less and what
//! flickers is left out; `core::world::reference` then says which are the references and where the
//! camera is. Robots in view do no harm: they are not arranged like the references.

use std::collections::HashMap;

use nalgebra::{Matrix3, Vector3};
use roundel_core::{
    id::{KindId, TrackNumber},
    world::{
        CameraPlacement, FrameObservations,
        reference::{Reference, Sighting, place_camera},
    },
};

/// Frames that one attempt looks at.
const WINDOW_FRAMES: usize = 15;
/// A place whose references fit worse than this is not believed.
const MAX_RMS_M: f64 = 0.05;

/// How far the search is.
#[derive(Debug, PartialEq)]
pub(super) enum Progress {
    /// The window is not full yet.
    Waiting,
    /// An attempt failed, and why; the next one has begun.
    Failed(String),
    /// Found.
    Found {
        /// Where the camera is.
        placement: Box<CameraPlacement>,
        /// From how many references.
        references: usize,
        /// How well they fit, metres.
        rms_m: f64,
    },
}

#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    count: usize,
    position_m: Vector3<f64>,
    covariance: Matrix3<f64>,
}

/// The search for one camera's place.
#[derive(Debug)]
pub(super) struct Placing {
    references: Vec<Reference>,
    kinds: Vec<KindId>,
    frames: usize,
    sums: HashMap<TrackNumber, Sum>,
}

impl Placing {
    pub(super) fn new(references: Vec<Reference>, kinds: Vec<KindId>) -> Self {
        Self { references, kinds, frames: 0, sums: HashMap::new() }
    }

    /// Takes in one frame; every so many frames it makes an attempt.
    pub(super) fn observe(&mut self, frame: &FrameObservations) -> Progress {
        for detection in &frame.detections {
            let is_reference = detection.ring.kind.is_some_and(|kind| self.kinds.contains(&kind));
            let Some(pose) = detection.pose.as_ref().filter(|_| is_reference) else { continue };
            let sighting = Sighting::from(pose);
            let sum = self.sums.entry(detection.track).or_default();
            sum.count += 1;
            sum.position_m += sighting.position_m;
            sum.covariance += sighting.covariance;
        }
        self.frames += 1;
        if self.frames < WINDOW_FRAMES {
            return Progress::Waiting;
        }
        let progress = self.attempt();
        self.frames = 0;
        self.sums.clear();
        progress
    }

    fn attempt(&self) -> Progress {
        // In the order of the tracks, so that the same frames give the same place.
        let mut steady: Vec<(&TrackNumber, &Sum)> =
            self.sums.iter().filter(|(_, sum)| sum.count == WINDOW_FRAMES).collect();
        steady.sort_by_key(|(track, _)| **track);
        // Much of the error is the same from frame to frame: the covariance stays that of one.
        let seen: Vec<Sighting> = steady
            .iter()
            .map(|(_, sum)| Sighting {
                position_m: sum.position_m / sum.count as f64,
                covariance: sum.covariance / sum.count as f64,
            })
            .collect();
        match place_camera(&self.references, &seen) {
            Ok((placement, _)) if placement.rms_m > MAX_RMS_M => Progress::Failed(format!(
                "the references are {:.0} mm off their places; measure them again",
                placement.rms_m * 1e3
            )),
            Ok((placement, found)) => Progress::Found {
                placement: Box::new(CameraPlacement {
                    world_from_camera: placement.world_from_camera,
                    covariance: placement.covariance,
                }),
                references: found.iter().flatten().count(),
                rms_m: placement.rms_m,
            },
            Err(error) => Progress::Failed(error.to_string()),
        }
    }
}
