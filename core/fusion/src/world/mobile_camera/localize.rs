//! Localization of an object by its own camera: detections of landmarks in a frame as a measurement of the object that
//! carries the camera.
//!
//! A rolling shutter exposes its rows one after another, so detections are first moved to the frame's time by the
//! predicted motion of the carrier; the uncertainty of that motion adds to their errors. Coded landmarks are identified
//! by their codes. Plain ones and unread codes are identified by their position once the carrier is tracked, and plain
//! ones before that by their mutual distances ([`super::super::reference::identify`]). [`solve_camera_pose`] gives the
//! camera's pose; with the mount (R_m, t_m) the carrier is at (R, t) (R_m, t_m)⁻¹. The measurement is like any other.
//! The errors of landmarks and mount are systematic, and so is a share of the rest, as in `measurement`.
//!
//! Where the detections allow two poses (one landmark, both normals), the one nearer to the expected pose is used. For
//! a carrier that is not tracked yet, evidence is accumulated frame by frame, and nothing is returned until the odds
//! are a hundred to one. If later frames reverse the odds, the other pose is returned, and the track starts again.

use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3};

use super::{
    landmark::{Landmark, LandmarkMatch, PoseSolution, pose_difference, solve_camera_pose},
    mount::{CameraMount, CarrierState},
};
use crate::world::{
    FusionParams,
    association::Sighting,
    identity::{CARRIER_NUMBER, Subject},
    measurement::{FLOOR_VARIANCE, StampCorrection, is_valid_pose, orientation, with_lever_arm},
    reference::{Reference, Sighting as Seen, identify},
};
use crate::{
    track::{AttitudeMeasurement, Measurement, Noise, cholesky_lower},
    world::FrameObservations,
};
use roundel_vision::{
    id::{KindId, TrackNumber},
    marker::Code,
    pose::{Detection, RoundelPose},
    rigid::{Covariance6, Rigid, mahalanobis_squared, rotate_covariance},
    time::Timestamp,
};

/// Log-odds between two poses from which one is used.
const MIN_LOG_ODDS: f64 = 4.6;
/// Limit of the log-odds, so that a wrong decision can be reversed.
const MAX_LOG_ODDS: f64 = 8.0;
/// Weight of each frame's evidence, since successive frames share most of their error.
const EVIDENCE_WEIGHT: f64 = 0.25;
/// Limit of the expected pose's contribution to the cost.
const MAX_PRIOR_COST: f64 = 30.0;
/// Age after which evidence is discarded, seconds.
const MAX_AMBIGUITY_AGE_S: f64 = 1.0;
/// Squared Mahalanobis length within which a detection is a plain landmark (χ², 3 degrees of freedom, 0.9999).
const GATE_SQUARED: f64 = 21.1;

/// Decision between two poses, with one of them in the last ambiguous frame.
#[derive(Clone, Copy, Debug)]
struct Ambiguity {
    world_from_camera: Rigid,
    log_odds: f64,
    time: Timestamp,
}

/// Memory of one camera between frames.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Localizer {
    ambiguity: Option<Ambiguity>,
}

/// Result of a frame.
pub(crate) struct Localization {
    /// Measurement of the carrier; `None` if its pose is undetermined.
    pub(crate) sighting: Option<Sighting>,
    /// Detections of landmarks.
    pub(crate) landmarks: Vec<TrackNumber>,
}

/// A frame of a camera that localizes.
pub(crate) struct LocalizationInput<'a> {
    pub(crate) frame: &'a FrameObservations,
    pub(crate) correction: StampCorrection,
    pub(crate) mount: CameraMount,
    /// Subject of its carrier.
    pub(crate) subject: Subject,
    /// Code of its carrier.
    pub(crate) code: Option<Code>,
    /// Predicted state of its carrier, if it is tracked.
    pub(crate) carrier: Option<CarrierState>,
    pub(crate) landmarks: &'a [Landmark],
    pub(crate) params: &'a FusionParams,
}

/// Detection without a code, which only its position can identify.
struct UncodedDetection {
    kind: KindId,
    number: TrackNumber,
    pose: RoundelPose,
}

impl Localizer {
    /// Pose of the carrier by one frame.
    pub(crate) fn localize(&mut self, input: &LocalizationInput<'_>) -> Localization {
        let mut pairs = input.pairs();
        let landmarks = pairs.iter().map(|pair| pair.number).collect();
        let expected = input.carrier.as_ref().map(CarrierState::mean_pose);
        let solutions = solve_camera_pose(&mut pairs, expected.as_ref().map(|(place, _)| place));
        let chosen = match solutions[..] {
            [] => None,
            [only] => {
                self.ambiguity = None;
                Some(only)
            }
            [best, other, ..] => self.choose([best, other], expected.as_ref(), input),
        };
        let sighting = chosen.and_then(|solution| input.sighting(&solution));
        Localization { sighting, landmarks }
    }

    /// Chooses between two poses, if the odds suffice.
    fn choose(
        &mut self,
        solutions: [PoseSolution; 2],
        expected: Option<&(Rigid, Covariance6)>,
        input: &LocalizationInput<'_>,
    ) -> Option<PoseSolution> {
        let time = input.time();
        if let Some((place, covariance)) = expected {
            let [first, second] = solutions.map(|solution| {
                let pose_difference = pose_difference(place, &solution.world_from_camera);
                let spread = covariance + solution.covariance();
                let square =
                    mahalanobis_squared(&pose_difference, &spread).unwrap_or(MAX_PRIOR_COST);
                solution.cost + square.min(MAX_PRIOR_COST)
            });
            let nearer = usize::from(second < first);
            let odds = self.update_log_odds(&solutions, nearer, time, || MAX_LOG_ODDS);
            let taken = if odds < -MIN_LOG_ODDS { 1 - nearer } else { nearer };
            return Some(solutions[taken]);
        }
        let upright = |index: usize| {
            let object = solutions[index].world_from_camera.rotation
                * input.mount.object_from_camera.rotation.inverse();
            (object * Vector3::z()).z
        };
        let prior = input.params.motion_model(&Default::default()).upright_log_odds;
        let odds = self.update_log_odds(&solutions, 0, time, || prior * (upright(0) - upright(1)));
        let taken = usize::from(odds < 0.0);
        (odds.abs() >= MIN_LOG_ODDS).then_some(solutions[taken])
    }

    /// Log-odds of the pose at `index` against the other by all frames so far; `prior` before the first.
    fn update_log_odds(
        &mut self,
        solutions: &[PoseSolution; 2],
        index: usize,
        time: Timestamp,
        prior: impl Fn() -> f64,
    ) -> f64 {
        let is_fresh =
            |ambiguity: &Ambiguity| time.seconds_since(ambiguity.time).abs() < MAX_AMBIGUITY_AGE_S;
        let before = self.ambiguity.filter(is_fresh).map_or_else(prior, |ambiguity| {
            let distance = |index: usize| {
                pose_difference(&ambiguity.world_from_camera, &solutions[index].world_from_camera)
                    .norm()
            };
            if distance(index) <= distance(1 - index) {
                ambiguity.log_odds
            } else {
                -ambiguity.log_odds
            }
        });
        let evidence = 0.5 * (solutions[1 - index].cost - solutions[index].cost);
        let log_odds = (before + EVIDENCE_WEIGHT * evidence).clamp(-MAX_LOG_ODDS, MAX_LOG_ODDS);
        let world_from_camera = solutions[index].world_from_camera;
        self.ambiguity = Some(Ambiguity { world_from_camera, log_odds, time });
        log_odds
    }
}

impl LocalizationInput<'_> {
    fn time(&self) -> Timestamp {
        self.correction.corrected(self.frame.capture_time)
    }

    /// Landmarks in the frame, each once, in the camera frame at the frame's time.
    fn pairs(&self) -> Vec<LandmarkMatch> {
        let mut pairs: Vec<LandmarkMatch> = Vec::new();
        let mut uncoded: Vec<UncodedDetection> = Vec::new();
        for detection in &self.frame.detections {
            let is_kind = |landmark: &Landmark| Some(landmark.kind) == detection.ring.kind;
            let (Some(pose), Some(kind)) = (&detection.pose, detection.ring.kind) else { continue };
            if !is_valid_pose(pose) || !self.landmarks.iter().any(is_kind) {
                continue;
            }
            let (number, pose) = (detection.track, self.at_frame(detection, pose));
            let Some(code) = detection.ring.code.map(|reading| reading.code) else {
                uncoded.push(UncodedDetection { kind, number, pose });
                continue;
            };
            let is_it = |landmark: &&Landmark| is_kind(landmark) && landmark.code == Some(code);
            let Some(&landmark) = self.landmarks.iter().find(is_it) else { continue };
            if !pairs.iter().any(|other| other.landmark == landmark) {
                pairs.push(LandmarkMatch { landmark, number, pose });
            }
        }
        match (&self.carrier, uncoded.is_empty()) {
            (_, true) => {}
            (Some(carrier), _) => self.match_places(carrier, uncoded, &mut pairs),
            (None, _) => self.match_distances(uncoded, &mut pairs),
        }
        pairs
    }

    /// Identifies plain landmarks and unread codes by their positions.
    fn match_places(
        &self,
        carrier: &CarrierState,
        uncoded: Vec<UncodedDetection>,
        pairs: &mut Vec<LandmarkMatch>,
    ) {
        let (place, covariance) = carrier.mean_pose();
        for UncodedDetection { kind, number, pose } in uncoded {
            let arm_m = place.rotation * pose.position_m;
            let observed = rotate_covariance(&place.rotation, &pose.covariance)
                + with_lever_arm(&covariance, &arm_m);
            let block: Matrix3<f64> = observed.fixed_view::<3, 3>(0, 0).into_owned();
            let square = |landmark: &Landmark| {
                let error = landmark.position_m - arm_m - place.translation.vector;
                let variance = landmark.position_deviation_m.powi(2);
                let block = block + Matrix3::from_diagonal_element(variance);
                mahalanobis_squared(&error, &block).unwrap_or(f64::INFINITY)
            };
            let own = self.landmarks.iter().filter(|landmark| landmark.kind == kind);
            let nearest = own
                .map(|landmark| (square(landmark), landmark))
                .min_by(|one, other| one.0.total_cmp(&other.0));
            let Some((square, &landmark)) = nearest else { continue };
            let is_taken = pairs.iter().any(|pair| pair.landmark == landmark);
            if square < GATE_SQUARED && !is_taken {
                pairs.push(LandmarkMatch { landmark, number, pose });
            }
        }
    }

    /// Identifies plain landmarks by their mutual distances.
    fn match_distances(&self, uncoded: Vec<UncodedDetection>, pairs: &mut Vec<LandmarkMatch>) {
        let plain: Vec<&Landmark> =
            self.landmarks.iter().filter(|landmark| landmark.code.is_none()).collect();
        let references: Vec<Reference> = plain
            .iter()
            .map(|landmark| Reference {
                position_m: landmark.position_m,
                normal: landmark.orientation.map(|turn| turn * Vector3::z()),
            })
            .collect();
        let observed: Vec<Seen> = uncoded.iter().map(|it| Seen::from(&it.pose)).collect();
        // An ambiguous arrangement waits for a frame that shows more.
        let Ok(found) = identify(&references, &observed) else { return };
        for (&landmark, index) in plain.into_iter().zip(found) {
            let Some(index) = index else { continue };
            let UncodedDetection { kind, number, pose } = &uncoded[index];
            if *kind == landmark.kind {
                pairs.push(LandmarkMatch { landmark, number: *number, pose: pose.clone() });
            }
        }
    }

    /// A detection moved to the frame's time.
    fn at_frame(&self, detection: &Detection, pose: &RoundelPose) -> RoundelPose {
        let row_s = detection.capture_time.seconds_since(self.frame.capture_time);
        let mut moved = pose.clone();
        let distance_m = pose.position_m.norm();
        let (speed_m_s, turning_rad_s) = match &self.carrier {
            Some(carrier) => {
                let time = self.time();
                let (frame, row) =
                    (carrier.pose_at(time), carrier.pose_at(time.plus_seconds(row_s)));
                let change = frame.world_from_camera.inverse() * row.world_from_camera;
                moved.position_m = change.rotation * pose.position_m + change.translation.vector;
                moved.normal = change.rotation * pose.normal;
                moved.other_normal = change.rotation * pose.other_normal;
                moved.yaw_rad =
                    pose.yaw_rad.map(|yaw_rad| turned_yaw(&change.rotation, &pose.normal, yaw_rad));
                moved.covariance = rotate_covariance(&change.rotation, &pose.covariance);
                carrier.rate_deviations()
            }
            None => (self.params.speed_m_s, self.params.angular_speed_rad_s),
        };
        let slip_m2 = (speed_m_s * row_s).powi(2) + (turning_rad_s * row_s * distance_m).powi(2);
        let slip_rad2 = (turning_rad_s * row_s).powi(2);
        for axis in 0..3 {
            moved.covariance[(axis, axis)] += slip_m2;
            moved.covariance[(axis + 3, axis + 3)] += slip_rad2;
        }
        moved
    }

    /// Measurement of the carrier.
    fn sighting(&self, solution: &PoseSolution) -> Option<Sighting> {
        let mount = &self.mount;
        let camera_from_object = mount.object_from_camera.inverse();
        let place = solution.world_from_camera * camera_from_object;
        let arm_m = solution.world_from_camera.rotation * camera_from_object.translation.vector;
        let share = self.params.systematic_share.clamp(0.0, 1.0);
        // An error of the mount in the object's frame moves the object by the same amount in the opposite
        // direction.
        let mut back = Matrix6::identity();
        let camera_m = mount.object_from_camera.translation.vector;
        back.fixed_view_mut::<3, 3>(0, 3).copy_from(&camera_m.cross_matrix());
        let mounted = back * mount.covariance * back.transpose();
        let mounted = rotate_covariance(&place.rotation, &mounted);
        let systematic =
            with_lever_arm(&(solution.observed * share + solution.stated_covariance), &arm_m)
                + mounted;
        let total = with_lever_arm(&solution.covariance(), &arm_m) + mounted;
        let noise = |corner: usize| {
            let block = |whole: &Covariance6| -> Matrix3<f64> {
                let block = whole.fixed_view::<3, 3>(corner, corner);
                (block + block.transpose()) * 0.5
            };
            Noise {
                total: block(&total) + Matrix3::from_diagonal_element(FLOOR_VARIANCE),
                systematic_root: cholesky_lower(&block(&systematic)).unwrap_or_else(Matrix3::zeros),
                timing_s: 0.0,
            }
        };
        let (position_noise, rotation_noise) = (noise(0), noise(3));
        if [&position_noise, &rotation_noise].iter().any(|n| cholesky_lower(&n.total).is_none()) {
            return None;
        }
        let turn: UnitQuaternion<f64> = place.rotation;
        Some(Sighting {
            subject: self.subject,
            code: self.code,
            measurement: Measurement {
                time: self.time(),
                clock_correction_s: self.correction.offset_s,
                camera: self.frame.camera,
                frame: self.frame.frame,
                number: CARRIER_NUMBER,
                position_m: place.translation.vector,
                position_noise,
                attitude: AttitudeMeasurement::new([turn; 2], 1.0, Some(1), rotation_noise),
            },
        })
    }
}

/// Yaw of a roundel after a rotation.
fn turned_yaw(turn: &UnitQuaternion<f64>, normal: &Vector3<f64>, yaw_rad: f64) -> f64 {
    let x = turn * orientation(normal, Some(yaw_rad)) * Vector3::x();
    let level = orientation(&(turn * normal), None).inverse() * x;
    level.y.atan2(level.x)
}
