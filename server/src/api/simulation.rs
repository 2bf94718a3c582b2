//! Simulated robots that clients drive, over REST; the same functions answer gRPC.

use std::sync::Arc;

use axum::{
    Json,
    extract::{State, rejection::JsonRejection},
};
use nalgebra::Vector3;
use roundel_core::id::ObjectId;
use roundel_proto::v1;

use super::{
    ApiState,
    error::{ApiError, ErrorBody},
};
use crate::capture::source::fleet::{
    DriveCommand, FleetError, MAX_PUSH_M_S, MAX_PUSH_MS, MAX_SPEED_M_S,
};

const DRIVE_EXAMPLE: &str =
    r#"{"robots": [{"object_id": 3, "velocity": {"x": 0.5, "y": 0, "z": 0}}]}"#;
const PUSH_EXAMPLE: &str =
    r#"{"object_id": 3, "velocity": {"x": 1, "y": 0, "z": 0}, "duration_ms": 500}"#;

/// Drives robots of a simulated arena.
///
/// Each goes on with its velocity for half a second, and then stops unless it is told again.
#[utoipa::path(
    post, path = "/api/v1/simulation/drive", tag = "simulation",
    request_body = v1::DriveRobotsRequest,
    responses(
        (status = 200, description = "they do, a moment later", body = v1::DriveRobotsResponse),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 404, description = "names the objects that there are", body = ErrorBody),
        (status = 409, description = "nothing is simulated here, or the object is no robot that drives", body = ErrorBody),
    ),
)]
pub async fn drive(
    State(api): State<Arc<ApiState>>,
    body: Result<Json<v1::DriveRobotsRequest>, JsonRejection>,
) -> Result<Json<v1::DriveRobotsResponse>, ApiError> {
    drive_robots(&api, &ApiError::body(body, DRIVE_EXAMPLE)?).map(Json)
}

/// Pushes a robot of a simulated arena, against what it is told.
#[utoipa::path(
    post, path = "/api/v1/simulation/push", tag = "simulation",
    request_body = v1::PushRobotRequest,
    responses(
        (status = 200, description = "it gives way, a moment later", body = v1::PushRobotResponse),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 404, description = "names the objects that there are", body = ErrorBody),
        (status = 409, description = "nothing is simulated here, or the object is no robot that drives", body = ErrorBody),
    ),
)]
pub async fn push(
    State(api): State<Arc<ApiState>>,
    body: Result<Json<v1::PushRobotRequest>, JsonRejection>,
) -> Result<Json<v1::PushRobotResponse>, ApiError> {
    push_robot(&api, &ApiError::body(body, PUSH_EXAMPLE)?).map(Json)
}

pub(super) fn drive_robots(
    api: &ApiState,
    request: &v1::DriveRobotsRequest,
) -> Result<v1::DriveRobotsResponse, ApiError> {
    let mut orders = Vec::with_capacity(request.robots.len());
    for (place, robot) in request.robots.iter().enumerate() {
        let field = format!("robots[{place}]");
        if request.robots[..place].iter().any(|other| other.object_id == robot.object_id) {
            let expected = "each object once";
            return Err(ApiError::invalid(format!("{field}.object_id"), expected, robot.object_id));
        }
        let velocity_m_s = velocity(robot.velocity, &format!("{field}.velocity"), MAX_SPEED_M_S)?;
        orders.push(DriveCommand { object: ObjectId(robot.object_id), velocity_m_s });
    }
    let fused = api.hub.snapshots().borrow().clone();
    let begin = api.fleets.drive(&orders, &fused.snapshot, api.clock.now())?;
    Ok(v1::DriveRobotsResponse { effective_time_ns: begin.as_ns() })
}

pub(super) fn push_robot(
    api: &ApiState,
    request: &v1::PushRobotRequest,
) -> Result<v1::PushRobotResponse, ApiError> {
    let velocity_m_s = velocity(request.velocity, "velocity", MAX_PUSH_M_S)?;
    let duration_ms = request.duration_ms;
    if !(duration_ms > 0.0 && duration_ms <= MAX_PUSH_MS) {
        let expected = format!("milliseconds above 0 and up to {MAX_PUSH_MS}");
        return Err(ApiError::invalid("duration_ms", expected, duration_ms));
    }
    let order = DriveCommand { object: ObjectId(request.object_id), velocity_m_s };
    let fused = api.hub.snapshots().borrow().clone();
    let now = api.clock.now();
    let begin = api.fleets.push(order, duration_ms * 1e-3, &fused.snapshot, now)?;
    Ok(v1::PushRobotResponse { effective_time_ns: begin.as_ns() })
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
    // A hair above is what rounding makes of a vector of the full length.
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
