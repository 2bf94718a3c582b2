//! Calibration of the arena.

use axum::{Json, extract::State};
use roundel_core::{
    id::CameraId,
    rigid::{Covariance6, upper_triangle},
};
use roundel_proto::v1;

use super::{
    ApiState,
    convert::{intrinsics, pixels as count, pose},
    error::{ApiError, ErrorBody},
    handler::{Answer, Api, Body, Example, blocking},
};
use crate::{
    fusion::calibration::{
        ApplyPolicy, CalibrationError, CalibrationReport, CalibrationRequest, CalibrationStage,
        CalibrationStatus, DEFAULT_DURATION_S, DURATION_RANGE_S, RecordedCamera,
        report::{CameraReport, Finding},
    },
    model::hub::Installation,
};

impl Example for v1::StartCalibrationRequest {
    const EXAMPLE: &str = r#"{"seconds": 60}"#;
}

/// Progress and result of the newest calibration of the arena.
#[utoipa::path(
    get, path = "/api/v1/calibration", tag = "calibration",
    responses((status = 200, description = "the newest calibration", body = v1::Calibration)),
)]
pub async fn show(State(api): Api) -> Answer<v1::Calibration> {
    Ok(Json(newest(&api)))
}

/// Starts a calibration of the arena. Let robots drive about while it records; tracking continues.
#[utoipa::path(
    post, path = "/api/v1/calibration", tag = "calibration",
    request_body = v1::StartCalibrationRequest,
    responses(
        (status = 200, description = "it records", body = v1::Calibration),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 409, description = "a calibration is running, or references are missing", body = ErrorBody),
    ),
)]
pub async fn start(
    State(api): Api,
    Body(request): Body<v1::StartCalibrationRequest>,
) -> Answer<v1::Calibration> {
    let apply = match v1::CalibrationApply::try_from(request.apply) {
        Ok(v1::CalibrationApply::Unspecified | v1::CalibrationApply::IfSound) => {
            ApplyPolicy::IfSound
        }
        Ok(v1::CalibrationApply::Always) => ApplyPolicy::Always,
        Ok(v1::CalibrationApply::Never) => ApplyPolicy::Never,
        Err(_) => {
            let expected = "a value of CalibrationApply";
            return Err(ApiError::invalid("apply", expected, request.apply));
        }
    };
    api.calibrator.start(CalibrationRequest {
        seconds: request.seconds.unwrap_or(DEFAULT_DURATION_S),
        refine_lenses: request.refine_lenses,
        apply,
    })?;
    Ok(Json(newest(&api)))
}

/// Cancels the running calibration.
#[utoipa::path(
    delete, path = "/api/v1/calibration", tag = "calibration",
    responses(
        (status = 200, description = "it was cancelled", body = v1::Calibration),
        (status = 409, description = "no calibration is running", body = ErrorBody),
    ),
)]
pub async fn cancel(State(api): Api) -> Answer<v1::Calibration> {
    api.calibrator.cancel()?;
    Ok(Json(newest(&api)))
}

/// Applies the result of the newest calibration to the cameras.
#[utoipa::path(
    put, path = "/api/v1/calibration/applied", tag = "calibration",
    responses(
        (status = 200, description = "cameras use it from their next frames on", body = v1::Calibration),
        (status = 409, description = "it has no result", body = ErrorBody),
    ),
)]
pub async fn apply(State(api): Api) -> Answer<v1::Calibration> {
    let calibrator = api.calibrator.clone();
    blocking(move || calibrator.apply()).await?;
    Ok(Json(newest(&api)))
}

impl From<CalibrationError> for ApiError {
    fn from(error: CalibrationError) -> Self {
        match error {
            CalibrationError::Seconds(found) => {
                let [least, most] = DURATION_RANGE_S;
                Self::invalid("seconds", format!("{least} to {most} seconds"), found)
            }
            CalibrationError::Thread(_) => Self::Internal(error.to_string()),
            _ => Self::FailedPrecondition(error.to_string()),
        }
    }
}

/// The newest calibration, and the version in use.
pub(super) fn newest(api: &ApiState) -> v1::Calibration {
    let status: CalibrationStatus = api.calibrator.status().borrow().clone();
    let installation = api.hub.installation();
    let cameras = status.cameras.iter();
    v1::Calibration {
        stage: stage(status.stage) as i32,
        seconds: status.seconds,
        recorded_s: status.recorded_s,
        recorded: cameras.map(|(id, camera)| recorded(&installation, *id, camera)).collect(),
        steps: count(status.steps),
        error: status.error,
        report: status.report.as_deref().map(|it| report(&installation, it)),
        applied_version: status.applied_version,
        version: api.calibrator.version(),
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
    let together = camera.together.iter().map(|(id, sightings)| v1::SeenTogether {
        camera: installation.camera_name(*id).to_owned(),
        sightings: *sightings,
    });
    v1::RecordedCamera {
        camera: installation.camera_name(id).to_owned(),
        frames: camera.frames,
        codes: count(camera.codes),
        coverage: camera.coverage,
        together: together.collect(),
    }
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
    (covariance.diagonal().fixed_rows::<3>(first).sum() / 3.0).max(0.0).sqrt()
}
