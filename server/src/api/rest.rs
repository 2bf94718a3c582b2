//! `/api/v1/…`: everything readable, once. The JSON is that of the messages of `proto/roundel/v1`.

use std::sync::Arc;

use axum::{
    Json,
    extract::State,
    http::{HeaderName, HeaderValue, Uri, header},
    response::{IntoResponse, Response},
};
use roundel_core::id::ObjectId;
use roundel_proto::v1;
use serde::Serialize;
use utoipa::ToSchema;

use super::{
    ApiState,
    error::{ApiError, ErrorBody},
    path::{Segment, object_number, text_of},
    picture, queries,
    query::QueryParameters,
    selection::{QUERY_FIELDS, Selection},
};
use crate::api::convert;

/// When the picture was taken: middle of the exposure, ns since the Unix epoch.
const CAPTURE_TIME_HEADER: HeaderName = HeaderName::from_static("roundel-capture-time-ns");
/// Events given if nobody says how many.
const DEFAULT_BACKLOG: u32 = 50;

/// The newest snapshot.
#[utoipa::path(
    get, path = "/api/v1/snapshot", tag = "poses",
    params(
        ("ids" = Option<String>, Query, description = "only these objects, and those of names and codes; commas between. A server that is started anew gives ids anew", example = "1,2"),
        ("names" = Option<String>, Query, description = "those that have these configured names, commas between", example = "cart"),
        ("codes" = Option<String>, Query, description = "those that were seen with these codes, commas between; 8:12 for one of 8 bits", example = "12"),
        ("roundels" = Option<String>, Query, description = "only objects of these kinds of roundel, commas between", example = "robot"),
        ("min" = Option<String>, Query, description = "with max: only objects in this box of the world frame; its smallest corner, metres", example = "-1,-1,0"),
        ("max" = Option<String>, Query, description = "the box's largest corner, metres", example = "1,1,2"),
        ("horizon_ms" = Option<f64>, Query, description = "predict every pose this far past the server's pose time, 0 to 1000"),
        ("omit_covariance" = Option<bool>, Query, description = "leave the covariances out"),
    ),
    responses(
        (status = 200, description = "every chosen object at one instant", body = v1::Snapshot),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
        (status = 503, description = "fusion has not made one yet", body = ErrorBody),
    ),
)]
pub async fn snapshot(
    State(api): State<Arc<ApiState>>,
    uri: Uri,
) -> Result<Json<v1::Snapshot>, ApiError> {
    let mut parameters = QueryParameters::of(&uri)?;
    let request = parameters.take_selection()?;
    parameters.finish()?;
    let selection = Selection::new(request, &api.hub.installation().kinds, &QUERY_FIELDS)?;
    queries::newest_snapshot(&api, &selection).map(Json)
}

/// Every object, by id; lost ones are kept for a minute.
#[utoipa::path(
    get, path = "/api/v1/objects", tag = "poses",
    responses((status = 200, description = "the objects", body = v1::ListObjectsResponse)),
)]
pub async fn objects(State(api): State<Arc<ApiState>>) -> Json<v1::ListObjectsResponse> {
    Json(v1::ListObjectsResponse { objects: queries::objects(&api) })
}

/// An object with where it is.
#[derive(Debug, Serialize, ToSchema)]
pub struct ObjectWithState {
    /// What the server knows of it.
    pub object: v1::Object,
    /// Its part of the newest snapshot; null once it is lost.
    pub state: Option<v1::ObjectState>,
}

/// One object with its newest state.
#[utoipa::path(
    get, path = "/api/v1/objects/{id}", tag = "poses",
    params(("id" = u64, Path, description = "object_id")),
    responses(
        (status = 200, description = "the object", body = ObjectWithState),
        (status = 400, description = "no number", body = ErrorBody),
        (status = 404, description = "no such object now or within the last minute", body = ErrorBody),
    ),
)]
pub async fn object(
    State(api): State<Arc<ApiState>>,
    id: Segment,
) -> Result<Json<ObjectWithState>, ApiError> {
    let number = object_number(id)?;
    let records = api.hub.objects();
    let Some(record) = records.iter().find(|record| record.id == ObjectId(number)) else {
        let known = "/api/v1/objects lists those seen within the last minute".to_owned();
        return Err(ApiError::NotFound { what: "object", name: number.to_string(), known });
    };
    let installation = api.hub.installation();
    let fused = api.hub.snapshots().borrow().clone();
    let message = Selection::default().filter.message(&installation, &fused);
    let state = message.objects.into_iter().find(|state| state.object_id == number);
    Ok(Json(ObjectWithState { object: convert::object(&installation, record), state }))
}

/// Every camera, in the order of the configuration.
#[utoipa::path(
    get, path = "/api/v1/cameras", tag = "cameras",
    responses((status = 200, description = "the cameras", body = v1::ListCamerasResponse)),
)]
pub async fn cameras(State(api): State<Arc<ApiState>>) -> Json<v1::ListCamerasResponse> {
    Json(v1::ListCamerasResponse { cameras: queries::cameras(&api) })
}

/// One camera.
#[utoipa::path(
    get, path = "/api/v1/cameras/{name}", tag = "cameras",
    params(("name" = String, Path, description = "the camera's name")),
    responses(
        (status = 200, description = "the camera", body = v1::Camera),
        (status = 404, description = "names the cameras that there are", body = ErrorBody),
    ),
)]
pub async fn camera(
    State(api): State<Arc<ApiState>>,
    name: Segment,
) -> Result<Json<v1::Camera>, ApiError> {
    let name = text_of(name)?;
    let id = queries::camera_id(&api, &name)?;
    queries::camera(&api, id).map(Json)
}

/// The camera's newest frame, with what was found in it drawn in.
///
/// Waits up to a second for a new frame; without one, the last that there was is given. The header
/// `roundel-capture-time-ns` says when it was taken.
#[utoipa::path(
    get, path = "/api/v1/cameras/{name}/frame.jpg", tag = "cameras",
    params(("name" = String, Path, description = "the camera's name")),
    responses(
        (status = 200, description = "outer rims green, inner rims cyan, centres red, numbers of tracks yellow", body = Vec<u8>, content_type = "image/jpeg"),
        (status = 404, description = "names the cameras that there are", body = ErrorBody),
        (status = 503, description = "the camera gives no frames; says why", body = ErrorBody),
    ),
)]
pub async fn frame(State(api): State<Arc<ApiState>>, name: Segment) -> Result<Response, ApiError> {
    let (jpeg, capture_time) = picture::newest(&api, &text_of(name)?).await?;
    let headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static("image/jpeg")),
        (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
        (CAPTURE_TIME_HEADER, HeaderValue::from(capture_time.as_ns())),
    ];
    Ok((headers, jpeg).into_response())
}

/// What happened lately.
#[derive(Debug, Serialize, ToSchema)]
pub struct EventList {
    /// Oldest first.
    pub events: Vec<v1::Event>,
}

/// The newest events, oldest first.
#[utoipa::path(
    get, path = "/api/v1/events", tag = "server",
    params(("backlog" = Option<u32>, Query, description = "how many at most, up to 1000; 50 if left out")),
    responses(
        (status = 200, description = "the events", body = EventList),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
    ),
)]
pub async fn events(
    State(api): State<Arc<ApiState>>,
    uri: Uri,
) -> Result<Json<EventList>, ApiError> {
    let mut parameters = QueryParameters::of(&uri)?;
    let backlog = parameters.take_parsed("backlog", "a number of events")?;
    parameters.finish()?;
    let backlog = queries::checked_backlog(backlog.unwrap_or(DEFAULT_BACKLOG), "backlog")?;
    let (remembered, _) = api.hub.events(backlog);
    let events = remembered.iter().map(|event| convert::event(event)).collect();
    Ok(Json(EventList { events }))
}

/// What the server says of itself.
#[utoipa::path(
    get, path = "/api/v1/info", tag = "server",
    responses((status = 200, description = "the server", body = v1::ServerInfo)),
)]
pub async fn info(State(api): State<Arc<ApiState>>) -> Json<v1::ServerInfo> {
    Json(queries::server_info(&api))
}

/// What each camera saw in its newest frame, with the poses in the camera's own frame.
#[utoipa::path(
    get, path = "/api/v1/observations", tag = "cameras",
    params(("cameras" = Option<String>, Query, description = "only these cameras, commas between", example = "north")),
    responses(
        (status = 200, description = "a frame of each camera that gave one", body = v1::GetObservationsResponse),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
        (status = 404, description = "names the cameras that there are", body = ErrorBody),
    ),
)]
pub async fn observations(
    State(api): State<Arc<ApiState>>,
    uri: Uri,
) -> Result<Json<v1::GetObservationsResponse>, ApiError> {
    let mut parameters = QueryParameters::of(&uri)?;
    let names: Vec<String> = parameters.take_list("cameras", "names of cameras")?;
    parameters.finish()?;
    queries::newest_observations(&api, &names).map(Json)
}

/// The server's clock.
///
/// It is read as soon as the request came and again before the answer goes: with both times of the client's own clock,
/// that gives the difference of the clocks to within half the round trip, as in NTP.
#[utoipa::path(
    get, path = "/api/v1/time", tag = "server",
    params(("sent_time_ns" = Option<i64>, Query, description = "the client's own clock, ns; comes back in the answer")),
    responses(
        (status = 200, description = "both times, ns since the Unix epoch", body = v1::ServerTime),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
    ),
)]
pub async fn time(
    State(api): State<Arc<ApiState>>,
    uri: Uri,
) -> Result<Json<v1::ServerTime>, ApiError> {
    let received_time_ns = api.clock.now().as_ns();
    let mut parameters = QueryParameters::of(&uri)?;
    let sent = parameters.take_parsed("sent_time_ns", "whole nanoseconds")?;
    parameters.finish()?;
    let replied_time_ns = api.clock.now().as_ns();
    let sent_time_ns = sent.unwrap_or_default();
    Ok(Json(v1::ServerTime { sent_time_ns, received_time_ns, replied_time_ns }))
}
