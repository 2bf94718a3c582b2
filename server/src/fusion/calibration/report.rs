//! Result of a calibration, with the installation's names.

use std::collections::BTreeMap;

use roundel_core::{
    calib::arena::{ArenaCalibration, CalibratedCamera, Names},
    camera::Camera,
    id::{CameraId, KindId},
    rigid::Rigid,
    world::CameraPlacement,
};

use crate::model::hub::{CameraState, Installation};

/// Offset of a trusted clock that is reported, seconds, and in standard deviations.
const CLOCK_OFF_S: f64 = 1e-3;
const CLOCK_DEVIATIONS: f64 = 5.0;

#[derive(Clone, Debug)]
pub struct CalibrationReport {
    /// In the order of the configuration, without cameras that nothing connects to the references.
    pub cameras: Vec<CameraReport>,
    /// Grave ones first.
    pub findings: Vec<Finding>,
    pub sightings: usize,
    /// Roundels on robots that at least two cameras saw.
    pub roundels: usize,
    /// Length of the recording, seconds.
    pub length_s: f64,
    pub steps: usize,
    /// Time that the solver took, seconds.
    pub solve_s: f64,
}

#[derive(Clone, Debug)]
pub struct CameraReport {
    pub result: CalibratedCamera,
    pub lens: Camera,
    /// Distance and angle to the pose before, metres and radians; `None` if that was unknown.
    pub moved: Option<[f64; 2]>,
}

impl CameraReport {
    pub fn placement(&self) -> CameraPlacement {
        let CalibratedCamera { world_from_camera, covariance, .. } = self.result;
        CameraPlacement { world_from_camera, covariance }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    pub text: String,
    /// The result must be checked before it is applied.
    pub is_grave: bool,
}

impl CalibrationReport {
    /// Whether it may be applied without confirmation.
    pub fn is_sound(&self) -> bool {
        !self.findings.iter().any(|finding| finding.is_grave)
    }
}

/// Configured names; references are numbered in the order of the configuration, from 1.
pub struct InstallationNames<'a>(pub &'a Installation);

impl Names for InstallationNames<'_> {
    fn camera(&self, id: CameraId) -> String {
        format!("camera {}", self.0.camera_name(id))
    }

    fn reference(&self, index: usize) -> String {
        format!("reference {}", index + 1)
    }

    fn kind(&self, id: KindId) -> String {
        format!("\"{}\"", self.0.kind_name(Some(id)))
    }
}

/// `states`: the cameras before the calibration.
pub(super) fn report(
    found: ArenaCalibration,
    installation: &Installation,
    states: &BTreeMap<CameraId, CameraState>,
    solve_s: f64,
) -> CalibrationReport {
    let names = InstallationNames(installation);
    let state = |id: CameraId| states.get(&id);
    let solved = found
        .findings
        .iter()
        .map(|finding| Finding { text: finding.message(&names), is_grave: finding.is_grave() });
    let clocks = found.cameras.iter().filter_map(|camera| {
        let is_trusted = state(camera.camera)?.clock.is_none_or(|clock| clock.deviation_s == 0.0);
        let text = clock_warning(camera, &names).filter(|_| is_trusted)?;
        Some(Finding { text, is_grave: false })
    });
    let mut findings: Vec<Finding> = solved.chain(clocks).collect();
    findings.sort_by_key(|finding| !finding.is_grave);
    let cameras = found.cameras.iter().filter_map(|result| {
        let state = state(result.camera)?;
        let refined = result.lens.as_ref().map(|lens| lens.camera.clone());
        let before = state.pose.placement.as_ref().map(|it| &it.world_from_camera);
        Some(CameraReport {
            lens: refined.or_else(|| state.camera.clone())?,
            moved: before.map(|before| moved(before, &result.world_from_camera)),
            result: result.clone(),
        })
    });
    CalibrationReport {
        cameras: cameras.collect(),
        findings,
        sightings: found.sightings,
        roundels: found.roundels,
        length_s: found.length_s,
        steps: found.steps,
        solve_s,
    }
}

fn moved(before: &Rigid, after: &Rigid) -> [f64; 2] {
    let distance_m = (after.translation.vector - before.translation.vector).norm();
    [distance_m, before.rotation.angle_to(&after.rotation)]
}

fn clock_warning(camera: &CalibratedCamera, names: &InstallationNames<'_>) -> Option<String> {
    let (offset_s, deviation_s) = (camera.clock_offset_s, camera.clock_offset_deviation_s);
    let is_off = offset_s.abs() > CLOCK_OFF_S && offset_s.abs() > CLOCK_DEVIATIONS * deviation_s;
    is_off.then(|| {
        format!(
            "the time stamps of {} differ by {:.1} ms from those of the camera that sees the references, and the \
             configuration trusts them: set its `clock_uncertainty_ms` to {:.0}",
            names.camera(camera.camera),
            offset_s.abs() * 1e3,
            (offset_s.abs() * 2e3).ceil()
        )
    })
}
