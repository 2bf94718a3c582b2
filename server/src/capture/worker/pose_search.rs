//! Estimates an unknown camera pose from the reference roundels that the camera sees.
//!
//! Positions of roundels that are tracked throughout a window of frames are averaged, which reduces noise and excludes
//! flickering detections; `core::world::reference` then identifies the references and computes the pose. Robots in view
//! do not matter: they are not arranged like the references.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};
use roundel_core::{
    id::{KindId, TrackNumber},
    world::{
        CameraPlacement, FrameObservations,
        reference::{Reference, Sighting, place_camera},
    },
};

/// Frames of one attempt.
const WINDOW_FRAMES: usize = 15;
/// A pose whose references fit worse than this is rejected.
const MAX_RMS_M: f64 = 0.05;

#[derive(Debug, PartialEq)]
pub(super) enum SearchProgress {
    /// The window is not full yet.
    Waiting,
    /// An attempt failed; the next one has begun.
    Failed(String),
    Found {
        placement: Box<CameraPlacement>,
        references: usize,
        rms_m: f64,
    },
}

#[derive(Debug)]
pub(super) struct PoseSearch {
    references: Vec<Reference>,
    kinds: Vec<KindId>,
    frames: usize,
    /// In the order of the tracks, so that the same frames give the same pose.
    sightings: BTreeMap<TrackNumber, Vec<Sighting>>,
}

impl PoseSearch {
    pub(super) fn new(references: Vec<Reference>, kinds: Vec<KindId>) -> Self {
        Self { references, kinds, frames: 0, sightings: BTreeMap::new() }
    }

    /// Adds one frame; makes an attempt when the window is full.
    pub(super) fn observe(&mut self, frame: &FrameObservations) -> SearchProgress {
        for detection in &frame.detections {
            let is_reference = detection.ring.kind.is_some_and(|kind| self.kinds.contains(&kind));
            if let Some(pose) = detection.pose.as_ref().filter(|_| is_reference) {
                self.sightings.entry(detection.track).or_default().push(Sighting::from(pose));
            }
        }
        self.frames += 1;
        if self.frames < WINDOW_FRAMES {
            return SearchProgress::Waiting;
        }
        self.frames = 0;
        let sightings = std::mem::take(&mut self.sightings).into_values();
        let steady: Vec<Sighting> =
            sightings.filter(|it| it.len() == WINDOW_FRAMES).map(|it| mean(&it)).collect();
        match place_camera(&self.references, &steady) {
            Ok((placement, _)) if placement.rms_m > MAX_RMS_M => SearchProgress::Failed(format!(
                "the references are {:.0} mm away from their configured positions; measure them again",
                placement.rms_m * 1e3
            )),
            Ok((placement, found)) => SearchProgress::Found {
                placement: Box::new(CameraPlacement {
                    world_from_camera: placement.world_from_camera,
                    covariance: placement.covariance,
                }),
                references: found.iter().flatten().count(),
                rms_m: placement.rms_m,
            },
            Err(error) => SearchProgress::Failed(error.to_string()),
        }
    }
}

fn mean(sightings: &[Sighting]) -> Sighting {
    let count = sightings.len() as f64;
    Sighting {
        position_m: sightings.iter().map(|it| it.position_m).sum::<Vector3<f64>>() / count,
        // Errors of successive frames are correlated, so the covariance stays that of one frame.
        covariance: sightings.iter().map(|it| it.covariance).sum::<Matrix3<f64>>() / count,
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;
    use roundel_core::{
        camera::PixelPoint,
        ellipse::Ellipse,
        id::CameraId,
        marker::Ring,
        pose::{Detection, RoundelPose},
        rigid::{Covariance6, Rigid},
        time::Timestamp,
    };

    use super::*;

    const REFERENCE: KindId = KindId(1);

    fn detection(camera: &Rigid, track: u64, kind: KindId, world_m: Vector3<f64>) -> Detection {
        let rim = Ellipse {
            center: PixelPoint { u: 320.0, v: 240.0 },
            semi_major_px: 20.0,
            semi_minor_px: 20.0,
            angle_rad: 0.0,
        };
        let position_m = camera.inverse_transform_point(&world_m.into()).coords;
        let normal = camera.rotation.inverse() * Vector3::z();
        Detection {
            track: TrackNumber(track),
            ring: Ring { kind: Some(kind), ..Ring::of_rims(rim, rim) },
            capture_time: Timestamp::default(),
            pose: Some(RoundelPose {
                position_m,
                normal,
                normal_likelihood: 1.0,
                other_normal: normal,
                yaw_rad: None,
                yaw_symmetry: 1,
                covariance: Covariance6::identity() * 1e-6,
            }),
        }
    }

    fn frame(detections: Vec<Detection>) -> FrameObservations {
        FrameObservations {
            camera: CameraId(0),
            frame: 1,
            capture_time: Timestamp::default(),
            received_time: Timestamp::default(),
            calibration_version: 1,
            detections,
        }
    }

    fn places() -> Vec<Vector3<f64>> {
        [[0.0, 0.0], [2.0, 0.0], [0.0, 1.5], [2.0, 1.7]]
            .map(|[x, y]| Vector3::new(x, y, 0.0))
            .into()
    }

    fn pose_search() -> PoseSearch {
        let reference = |position_m| Reference { position_m, normal: None };
        PoseSearch::new(places().into_iter().map(reference).collect(), vec![REFERENCE])
    }

    #[test]
    fn the_pose_is_found_among_robots_and_flickering_detections() {
        let turn = UnitQuaternion::from_euler_angles(std::f64::consts::PI - 0.2, 0.1, 0.7);
        let camera = Rigid::from_parts(Vector3::new(0.5, -0.5, 4.0).into(), turn);
        let mut pose_search = pose_search();
        let mut progress = SearchProgress::Waiting;
        for number in 0..WINDOW_FRAMES {
            assert_eq!(progress, SearchProgress::Waiting);
            let mut seen: Vec<Detection> = (10..)
                .zip(places())
                .map(|(track, place)| detection(&camera, track, REFERENCE, place))
                .collect();
            // A robot, and a flickering detection of the references' kind.
            let robot = Vector3::new(0.1 * number as f64, 1.0, 0.3);
            seen.push(detection(&camera, 3, KindId(0), robot));
            if number % 2 == 0 {
                seen.push(detection(&camera, 4, REFERENCE, Vector3::new(1.0, 1.0, 0.0)));
            }
            progress = pose_search.observe(&frame(seen));
        }
        let SearchProgress::Found { placement, references, rms_m } = progress else {
            panic!("{progress:?}")
        };
        assert_eq!(references, 4);
        assert!(rms_m < 1e-6, "{rms_m}");
        let off = placement.world_from_camera.inverse() * camera;
        assert!(off.translation.vector.norm() < 1e-6 && off.rotation.angle() < 1e-6, "{off}");
    }

    #[test]
    fn too_few_references_are_a_failure_and_the_search_goes_on() {
        let camera = Rigid::from_parts(
            Vector3::new(0.0, 0.0, 4.0).into(),
            UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0),
        );
        let mut pose_search = pose_search();
        let mut attempt = |count: usize| {
            let seen: Vec<Detection> = (1..)
                .zip(places().into_iter().take(count))
                .map(|(track, place)| detection(&camera, track, REFERENCE, place))
                .collect();
            (0..WINDOW_FRAMES).map(|_| pose_search.observe(&frame(seen.clone()))).last()
        };
        assert!(matches!(attempt(2), Some(SearchProgress::Failed(reason)) if !reason.is_empty()));
        assert!(matches!(attempt(4), Some(SearchProgress::Found { .. })));
    }
}
