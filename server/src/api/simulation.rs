//! Drives and pushes the robots of a simulated arena.

use axum::{Json, extract::State};
use nalgebra::Vector3;
use roundel_core::id::ObjectId;
use roundel_proto::v1;

use super::{
    error::{ApiError, ErrorBody},
    handler::{Answer, Api, Body, Example},
};
use crate::capture::source::fleet::{
    DriveCommand, FleetError, MAX_PUSH_M_S, MAX_PUSH_MS, MAX_SPEED_M_S,
};

impl Example for v1::DriveRobotsRequest {
    const EXAMPLE: &str =
        r#"{"robots": [{"object_id": 3, "velocity": {"x": 0.5, "y": 0, "z": 0}}]}"#;
}

impl Example for v1::PushRobotRequest {
    const EXAMPLE: &str =
        r#"{"object_id": 3, "velocity": {"x": 1, "y": 0, "z": 0}, "duration_ms": 500}"#;
}

/// Drives robots of a simulated arena.
///
/// Each keeps its velocity for half a second and then stops, unless another command arrives.
#[utoipa::path(
    post, path = "/api/v1/simulation/drive", tag = "simulation",
    request_body = v1::DriveRobotsRequest,
    responses(
        (status = 200, description = "the robots follow, from the effective time on", body = v1::DriveRobotsResponse),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 404, description = "lists the existing objects", body = ErrorBody),
        (status = 409, description = "nothing is simulated, or the object is not a robot that drives", body = ErrorBody),
    ),
)]
pub async fn drive(
    State(api): Api,
    Body(request): Body<v1::DriveRobotsRequest>,
) -> Answer<v1::DriveRobotsResponse> {
    let mut commands = Vec::with_capacity(request.robots.len());
    for (index, robot) in request.robots.iter().enumerate() {
        let field = format!("robots[{index}]");
        if request.robots[..index].iter().any(|other| other.object_id == robot.object_id) {
            let expected = "each object once";
            return Err(ApiError::invalid(format!("{field}.object_id"), expected, robot.object_id));
        }
        let velocity_m_s = velocity(robot.velocity, &format!("{field}.velocity"), MAX_SPEED_M_S)?;
        commands.push(DriveCommand { object: ObjectId(robot.object_id), velocity_m_s });
    }
    let fused = api.hub.snapshots().borrow().clone();
    let begin = api.fleets.drive(&commands, &fused.snapshot, api.clock.now())?;
    Ok(Json(v1::DriveRobotsResponse { effective_time_ns: begin.as_ns() }))
}

/// Pushes a robot of a simulated arena, overriding its command.
#[utoipa::path(
    post, path = "/api/v1/simulation/push", tag = "simulation",
    request_body = v1::PushRobotRequest,
    responses(
        (status = 200, description = "the robot is pushed, from the effective time on", body = v1::PushRobotResponse),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 404, description = "lists the existing objects", body = ErrorBody),
        (status = 409, description = "nothing is simulated, or the object is not a robot that drives", body = ErrorBody),
    ),
)]
pub async fn push(
    State(api): Api,
    Body(request): Body<v1::PushRobotRequest>,
) -> Answer<v1::PushRobotResponse> {
    let velocity_m_s = velocity(request.velocity, "velocity", MAX_PUSH_M_S)?;
    let duration_ms = request.duration_ms;
    if !(duration_ms > 0.0 && duration_ms <= MAX_PUSH_MS) {
        let expected = format!("milliseconds above 0 and up to {MAX_PUSH_MS}");
        return Err(ApiError::invalid("duration_ms", expected, duration_ms));
    }
    let command = DriveCommand { object: ObjectId(request.object_id), velocity_m_s };
    let fused = api.hub.snapshots().borrow().clone();
    let now = api.clock.now();
    let begin = api.fleets.push(command, duration_ms * 1e-3, &fused.snapshot, now)?;
    Ok(Json(v1::PushRobotResponse { effective_time_ns: begin.as_ns() }))
}

fn velocity(
    velocity: Option<v1::Vector3>,
    field: &str,
    top_m_s: f64,
) -> Result<Vector3<f64>, ApiError> {
    let expected = || format!("a velocity of at most {top_m_s} m/s");
    let Some(v1::Vector3 { x, y, z }) = velocity else {
        return Err(ApiError::invalid(field, expected(), "nothing"));
    };
    let velocity_m_s = Vector3::new(x, y, z);
    let speed_m_s = velocity_m_s.norm();
    // Rounding may leave a vector of the maximum length slightly above it.
    if speed_m_s <= top_m_s * (1.0 + 1e-9) {
        return Ok(velocity_m_s);
    }
    Err(ApiError::invalid(field, expected(), format!("({x}, {y}, {z}), {speed_m_s:.3} m/s")))
}

impl From<FleetError> for ApiError {
    fn from(error: FleetError) -> Self {
        match error {
            FleetError::NoObject { object, known } => {
                Self::NotFound { what: "object", name: object.to_string(), known }
            }
            _ => Self::FailedPrecondition(error.to_string()),
        }
    }
}
