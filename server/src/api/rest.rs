//! `/api/v1/…`: what the server serves, as JSON of the messages of `proto/roundel/v1`.

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
    convert,
    error::{ApiError, ErrorBody},
    handler::{Answer, Api, NO_STORE, Segment},
    picture, queries,
    query::QueryParameters,
    selection::{QUERY_FIELDS, Selection},
};

/// Capture time of a picture: middle of the exposure, ns since the Unix epoch.
const CAPTURE_TIME_HEADER: HeaderName = HeaderName::from_static("roundel-capture-time-ns");
const DEFAULT_BACKLOG: u32 = 50;

/// The newest snapshot.
#[utoipa::path(
    get, path = "/api/v1/snapshot", tag = "poses",
    params(
        ("ids" = Option<String>, Query, description = "only these objects, and those of names and codes; commas between. Ids change when the server restarts", example = "1,2"),
        ("names" = Option<String>, Query, description = "objects with these configured names, commas between", example = "cart"),
        ("codes" = Option<String>, Query, description = "objects seen with these codes, commas between; 8:12 for one of 8 bits", example = "12"),
        ("roundels" = Option<String>, Query, description = "only objects of these kinds of roundel, commas between", example = "robot"),
        ("min" = Option<String>, Query, description = "with max: only objects in this box of the world frame; its smallest corner, metres", example = "-1,-1,0"),
        ("max" = Option<String>, Query, description = "the box's largest corner, metres", example = "1,1,2"),
        ("horizon_ms" = Option<f64>, Query, description = "predict every pose this far past the server's pose time, 0 to 1000"),
        ("omit_covariance" = Option<bool>, Query, description = "omit the covariances"),
    ),
    responses(
        (status = 200, description = "every selected object at one instant", body = v1::Snapshot),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
        (status = 503, description = "fusion has not published one yet", body = ErrorBody),
    ),
)]
pub async fn snapshot(State(api): Api, uri: Uri) -> Answer<v1::Snapshot> {
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
pub async fn objects(State(api): Api) -> Answer<v1::ListObjectsResponse> {
    let (installation, records) = (api.hub.installation(), api.hub.objects());
    let objects = records.iter().map(|record| convert::object(&installation, record)).collect();
    Ok(Json(v1::ListObjectsResponse { objects }))
}

/// An object with its newest state.
#[derive(Debug, Serialize, ToSchema)]
pub struct ObjectWithState {
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
        (status = 400, description = "not a number", body = ErrorBody),
        (status = 404, description = "no such object now or within the last minute", body = ErrorBody),
    ),
)]
pub async fn object(State(api): Api, id: Segment) -> Answer<ObjectWithState> {
    let number = id.object_id()?;
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

/// The measured size of each kind's prints, in the order of the configuration.
#[utoipa::path(
    get, path = "/api/v1/print-sizes", tag = "poses",
    responses((status = 200, description = "the sizes", body = v1::ListPrintSizesResponse)),
)]
pub async fn print_sizes(State(api): Api) -> Answer<v1::ListPrintSizesResponse> {
    let print_sizes = convert::print_sizes(&api.hub.installation(), &api.hub.print_sizes());
    Ok(Json(v1::ListPrintSizesResponse { print_sizes }))
}

/// Every camera, in the order of the configuration.
#[utoipa::path(
    get, path = "/api/v1/cameras", tag = "cameras",
    responses((status = 200, description = "the cameras", body = v1::ListCamerasResponse)),
)]
pub async fn cameras(State(api): Api) -> Answer<v1::ListCamerasResponse> {
    Ok(Json(v1::ListCamerasResponse { cameras: queries::cameras(&api) }))
}

/// One camera.
#[utoipa::path(
    get, path = "/api/v1/cameras/{name}", tag = "cameras",
    params(("name" = String, Path, description = "the camera's name")),
    responses(
        (status = 200, description = "the camera", body = v1::Camera),
        (status = 404, description = "lists the existing cameras", body = ErrorBody),
    ),
)]
pub async fn camera(State(api): Api, Segment(name): Segment) -> Answer<v1::Camera> {
    queries::camera(&api, &name).map(Json)
}

/// The camera's newest frame with its detections drawn in.
///
/// Waits up to a second for a new frame, then returns the last one. The header `roundel-capture-time-ns` has its capture
/// time.
#[utoipa::path(
    get, path = "/api/v1/cameras/{name}/frame.jpg", tag = "cameras",
    params(("name" = String, Path, description = "the camera's name")),
    responses(
        (status = 200, description = "outer rims green, inner rims cyan, centres red, numbers of tracks yellow", body = Vec<u8>, content_type = "image/jpeg"),
        (status = 404, description = "lists the existing cameras", body = ErrorBody),
        (status = 503, description = "the camera delivers no frames; says why", body = ErrorBody),
    ),
)]
pub async fn frame(State(api): Api, Segment(name): Segment) -> Result<Response, ApiError> {
    let (jpeg, capture_time) = picture::newest(&api, &name).await?;
    let headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static("image/jpeg")),
        NO_STORE,
        (CAPTURE_TIME_HEADER, HeaderValue::from(capture_time.as_ns())),
    ];
    Ok((headers, jpeg).into_response())
}

/// The newest events.
#[derive(Debug, Serialize, ToSchema)]
pub struct EventList {
    /// Oldest first.
    pub events: Vec<v1::Event>,
}

/// The newest events, oldest first.
#[utoipa::path(
    get, path = "/api/v1/events", tag = "server",
    params(("backlog" = Option<u32>, Query, description = "maximum number, up to 1000 [50]")),
    responses(
        (status = 200, description = "the events", body = EventList),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
    ),
)]
pub async fn events(State(api): Api, uri: Uri) -> Answer<EventList> {
    let mut parameters = QueryParameters::of(&uri)?;
    let backlog = parameters.take_parsed("backlog", "a number of events")?;
    parameters.finish()?;
    let backlog = queries::checked_backlog(backlog.unwrap_or(DEFAULT_BACKLOG))?;
    let (remembered, _) = api.hub.events(backlog);
    let events = remembered.into_iter().map(Arc::unwrap_or_clone).collect();
    Ok(Json(EventList { events }))
}

/// The server's identity and abilities.
#[utoipa::path(
    get, path = "/api/v1/info", tag = "server",
    responses((status = 200, description = "the server", body = v1::ServerInfo)),
)]
pub async fn info(State(api): Api) -> Answer<v1::ServerInfo> {
    Ok(Json(v1::ServerInfo {
        records: api.recorder.is_some(),
        replays: api.replay.is_some(),
        keeps_history: api.history.is_some(),
        history_error: api.history.as_ref().map(|history| history.error()).unwrap_or_default(),
        allows_setup: api.camera_manager.is_some(),
        ..convert::server_info(&api.hub.installation())
    }))
}

/// The detections in each camera's newest frame, with poses in the camera's own frame.
#[utoipa::path(
    get, path = "/api/v1/observations", tag = "cameras",
    params(("cameras" = Option<String>, Query, description = "only these cameras, commas between", example = "north")),
    responses(
        (status = 200, description = "the newest frame of each camera that has one", body = v1::GetObservationsResponse),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
        (status = 404, description = "lists the existing cameras", body = ErrorBody),
    ),
)]
pub async fn observations(State(api): Api, uri: Uri) -> Answer<v1::GetObservationsResponse> {
    let mut parameters = QueryParameters::of(&uri)?;
    let names: Vec<String> = parameters.take_list("cameras", "names of cameras")?;
    parameters.finish()?;
    queries::newest_observations(&api, &names).map(Json)
}

/// The server's clock.
///
/// It is read when the request arrives and again before the response leaves. With the two times of the client's own clock,
/// that gives the difference of the clocks to within half the round trip, as in NTP.
#[utoipa::path(
    get, path = "/api/v1/time", tag = "server",
    params(("sent_time_ns" = Option<i64>, Query, description = "the client's own clock, ns; returned in the response")),
    responses(
        (status = 200, description = "both times, ns since the Unix epoch", body = v1::ServerTime),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
    ),
)]
pub async fn time(State(api): Api, uri: Uri) -> Answer<v1::ServerTime> {
    let received_time_ns = api.clock.now().as_ns();
    let mut parameters = QueryParameters::of(&uri)?;
    let sent = parameters.take_parsed("sent_time_ns", "whole nanoseconds")?;
    parameters.finish()?;
    let replied_time_ns = api.clock.now().as_ns();
    let sent_time_ns = sent.unwrap_or_default();
    Ok(Json(v1::ServerTime { sent_time_ns, received_time_ns, replied_time_ns }))
}
