//! Calibrations of the arena, for clients.

use std::collections::BTreeMap;

use nalgebra::SVector;
use roundel_core::{
    id::CameraId,
    rigid::{Covariance6, upper_triangle},
};
use roundel_proto::v1;

use crate::model::convert::{intrinsics, pose};
use crate::{
    fusion::calibration::{
        CalibrationReport, CalibrationStage, CalibrationStatus, RecordedCamera,
        report::{CameraReport, Finding},
    },
    model::hub::Installation,
};

/// The newest calibration, and the version that is in use.
pub fn calibration(
    installation: &Installation,
    status: &CalibrationStatus,
    version: u64,
) -> v1::Calibration {
    v1::Calibration {
        stage: stage(status.stage) as i32,
        seconds: status.seconds,
        recorded_s: status.recorded_s,
        recorded: status
            .cameras
            .iter()
            .map(|(id, camera)| recorded(installation, *id, camera))
            .collect(),
        steps: count(status.steps),
        error: status.error.clone(),
        report: status.report.as_deref().map(|it| report(installation, it)),
        applied_version: status.applied_version,
        version,
    }
}

fn stage(stage: CalibrationStage) -> v1::CalibrationStage {
    match stage {
        CalibrationStage::Idle => v1::CalibrationStage::Idle,
        CalibrationStage::Recording => v1::CalibrationStage::Recording,
        CalibrationStage::Solving => v1::CalibrationStage::Solving,
        CalibrationStage::Done => v1::CalibrationStage::Done,
        CalibrationStage::Failed => v1::CalibrationStage::Failed,
    }
}

fn recorded(
    installation: &Installation,
    id: CameraId,
    camera: &RecordedCamera,
) -> v1::RecordedCamera {
    v1::RecordedCamera {
        camera: installation.camera_name(id).to_owned(),
        frames: camera.frames,
        codes: count(camera.codes),
        coverage: camera.coverage,
        together: together(installation, &camera.together),
    }
}

fn together(
    installation: &Installation,
    others: &BTreeMap<CameraId, u64>,
) -> Vec<v1::SeenTogether> {
    let each = others.iter().map(|(id, sightings)| v1::SeenTogether {
        camera: installation.camera_name(*id).to_owned(),
        sightings: *sightings,
    });
    each.collect()
}

fn report(installation: &Installation, report: &CalibrationReport) -> v1::CalibrationReport {
    let finding = |Finding { text, is_grave }: &Finding| v1::CalibrationFinding {
        message: text.clone(),
        grave: *is_grave,
    };
    v1::CalibrationReport {
        cameras: report.cameras.iter().map(|camera| calibrated(installation, camera)).collect(),
        findings: report.findings.iter().map(finding).collect(),
        sightings: report.sightings as u64,
        roundels: count(report.roundels),
        length_s: report.length_s,
        steps: count(report.steps),
        solve_s: report.solve_s,
        sound: report.is_sound(),
    }
}

fn calibrated(installation: &Installation, camera: &CameraReport) -> v1::CalibratedCamera {
    let CameraReport { result, lens, moved } = camera;
    let name = |id| installation.camera_name(id).to_owned();
    let neighbours = result.neighbours.iter().map(|neighbour| v1::Neighbour {
        camera: name(neighbour.camera),
        shared: neighbour.shared as u64,
        spread_m: neighbour.spread_m,
    });
    let refined = result.lens.as_ref();
    v1::CalibratedCamera {
        camera: name(result.camera),
        pose: Some(pose(&result.world_from_camera)),
        covariance: upper_triangle(&result.covariance),
        position_deviation_m: deviation(&result.covariance, 0),
        rotation_deviation_rad: deviation(&result.covariance, 3),
        moved_m: moved.map(|[distance_m, _]| distance_m),
        turned_rad: moved.map(|[_, turn_rad]| turn_rad),
        reprojection_px: result.reprojection_rms_px,
        error_ratio: result.error_ratio,
        coverage: result.coverage,
        sightings: result.sightings as u64,
        clock_offset_ms: result.clock_offset_s * 1e3,
        clock_offset_deviation_ms: result.clock_offset_deviation_s * 1e3,
        clock_skew_ppm: result.clock_skew * 1e6,
        neighbours: neighbours.collect(),
        intrinsics: refined.map(|_| intrinsics(lens)),
        intrinsics_deviations: refined.map(|it| it.deviations.to_vec()).unwrap_or_default(),
    }
}

/// Rms over the three axes from `first`.
fn deviation(covariance: &Covariance6, first: usize) -> f64 {
    let variances: SVector<f64, 3> = covariance.diagonal().fixed_rows::<3>(first).into_owned();
    (variances.sum() / 3.0).max(0.0).sqrt()
}

fn count(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}
