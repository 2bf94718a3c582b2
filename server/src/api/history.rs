//! Past positions of objects.

use std::{convert::Infallible, mem::size_of};

use axum::{Json, body::Body, extract::State, http::Uri, response::Response};
use futures::stream;
use roundel_core::time::Timestamp;
use roundel_proto::v1;

use super::{
    ApiState,
    error::{ApiError, ErrorBody},
    handler::{Answer, Api, download},
    heavy::{Charged, stopped},
    query::QueryParameters,
    region::Region,
};
use crate::archive::history::{
    HistoryError, export,
    store::{HistoryPoint, HistoryQuery, HistoryResult, MAX_EXPORT_ROWS, MAX_POINTS},
};

const HOUR_S: f64 = 3600.0;
/// Memory of the points of the largest export.
const EXPORT_BYTES: usize = MAX_EXPORT_ROWS * size_of::<HistoryPoint>();
/// Memory of the points of other queries, before they are thinned.
const QUERY_BYTES: usize = 16 * 1024 * 1024;

/// Names in errors of the fields whose names differ between messages and queries.
struct FieldNames {
    from: &'static str,
    until: &'static str,
    corners: [&'static str; 2],
}

const QUERY_FIELDS: FieldNames =
    FieldNames { from: "from", until: "until", corners: ["min", "max"] };
const MESSAGE_FIELDS: FieldNames = FieldNames {
    from: "from_time_ns",
    until: "until_time_ns",
    corners: ["region.min", "region.max"],
};

/// Past positions of objects, in tiers that get coarser with age.
#[utoipa::path(
    get, path = "/api/v1/history", tag = "poses",
    params(
        ("objects" = Option<String>, Query, description = "only these objects, by id, name or code number, commas between", example = "3,cart"),
        ("from" = Option<i64>, Query, description = "ns since the Unix epoch [an hour before `until`]"),
        ("until" = Option<i64>, Query, description = "ns since the Unix epoch [now]"),
        ("min" = Option<String>, Query, description = "with max: only points in this box of the world frame; its smallest corner, metres", example = "-1,-1,0"),
        ("max" = Option<String>, Query, description = "the box's largest corner, metres", example = "1,1,2"),
        ("max_points" = Option<u32>, Query, description = "maximum number of points of all objects together, 1 to 5000"),
    ),
    responses(
        (status = 200, description = "each object's points", body = v1::QueryHistoryResponse),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
        (status = 503, description = "the server is busy", body = ErrorBody),
        (status = 409, description = "the server keeps no history ([history] in the configuration)", body = ErrorBody),
    ),
)]
pub async fn show(State(api): Api, uri: Uri) -> Answer<v1::QueryHistoryResponse> {
    let mut parameters = QueryParameters::of(&uri)?;
    let request = request(&mut parameters)?;
    parameters.finish()?;
    run(&api, request, &QUERY_FIELDS).await
}

/// Past positions of objects as a CSV table, without thinning.
#[utoipa::path(
    get, path = "/api/v1/history.csv", tag = "poses",
    params(
        ("objects" = Option<String>, Query, description = "as for /api/v1/history"),
        ("from" = Option<i64>, Query, description = "as for /api/v1/history"),
        ("until" = Option<i64>, Query, description = "as for /api/v1/history"),
        ("min" = Option<String>, Query, description = "as for /api/v1/history"),
        ("max" = Option<String>, Query, description = "as for /api/v1/history"),
        ("step_s" = Option<f64>, Query, description = "seconds between points: 0.1, 1, 10, 100 or 1000; other values are rounded down [0.1]"),
    ),
    responses(
        (status = 200, description = "time_ns,object_id,name,roundel,code,x_m,y_m,z_m,yaw_rad,source_id", body = String, content_type = "text/csv"),
        (status = 400, description = "names the wrong parameter, or more than 2,000,000 rows", body = ErrorBody),
        (status = 503, description = "the server is busy", body = ErrorBody),
        (status = 409, description = "the server keeps no history ([history] in the configuration)", body = ErrorBody),
    ),
)]
pub async fn export(State(api): Api, uri: Uri) -> Result<Response, ApiError> {
    let mut result = table(&api, &uri, Ok).await?;
    let points: usize = result.objects.iter().map(|(_, points)| points.capacity()).sum();
    result.shrink_to(points * size_of::<HistoryPoint>());
    // Written as the client reads.
    let pieces = stream::iter(export::csv(result).map(Ok::<_, Infallible>));
    download("text/csv; charset=utf-8", "history.csv", Body::from_stream(pieces))
}

/// Past positions of objects as a Parquet table, if the server was built with Parquet.
#[utoipa::path(
    get, path = "/api/v1/history.parquet", tag = "poses",
    params(
        ("objects" = Option<String>, Query, description = "as for /api/v1/history"),
        ("from" = Option<i64>, Query, description = "as for /api/v1/history"),
        ("until" = Option<i64>, Query, description = "as for /api/v1/history"),
        ("min" = Option<String>, Query, description = "as for /api/v1/history"),
        ("max" = Option<String>, Query, description = "as for /api/v1/history"),
        ("step_s" = Option<f64>, Query, description = "as for /api/v1/history.csv"),
    ),
    responses(
        (status = 200, description = "the columns of history.csv; time_ns is a timestamp, and unknown values are null", body = Vec<u8>, content_type = "application/vnd.apache.parquet"),
        (status = 400, description = "names the wrong parameter, or more than 2,000,000 rows", body = ErrorBody),
        (status = 503, description = "the server is busy", body = ErrorBody),
        (status = 409, description = "the server keeps no history ([history] in the configuration), or was built without Parquet", body = ErrorBody),
    ),
)]
pub async fn parquet(State(api): Api, uri: Uri) -> Result<Response, ApiError> {
    let bytes = table(&api, &uri, |result| export::parquet(&result)).await?;
    download("application/vnd.apache.parquet", "history.parquet", bytes.into_bytes())
}

/// A table of every selected point, without thinning.
async fn table<T: Send + 'static>(
    api: &ApiState,
    uri: &Uri,
    write: fn(HistoryResult) -> Result<T, HistoryError>,
) -> Result<Charged<T>, ApiError> {
    let mut parameters = QueryParameters::of(uri)?;
    let step_s = parameters.take_parsed::<f64>("step_s", "a number of seconds")?.unwrap_or(0.1);
    if step_s.is_nan() || step_s <= 0.0 {
        return Err(ApiError::invalid("step_s", "seconds above 0", step_s));
    }
    let request = v1::QueryHistoryRequest { max_points: 0, ..request(&mut parameters)? };
    parameters.finish()?;
    let query = HistoryQuery {
        max_points: MAX_EXPORT_ROWS,
        step_s: Some(step_s),
        ..history_query(api, request, &QUERY_FIELDS)?
    };
    run_query(api, query, EXPORT_BYTES, write).await
}

fn request(parameters: &mut QueryParameters) -> Result<v1::QueryHistoryRequest, ApiError> {
    const TIME: &str = "nanoseconds since the Unix epoch";
    let region = parameters.take_region()?;
    Ok(v1::QueryHistoryRequest {
        objects: parameters.take_list("objects", "ids, names or codes with commas between")?,
        region,
        from_time_ns: parameters.take_parsed("from", TIME)?.unwrap_or(0),
        until_time_ns: parameters.take_parsed("until", TIME)?.unwrap_or(0),
        max_points: parameters.take_parsed("max_points", "1 to 5000")?.unwrap_or(0),
    })
}

pub(super) async fn query(
    State(api): Api,
    request: v1::QueryHistoryRequest,
) -> Answer<v1::QueryHistoryResponse> {
    run(&api, request, &MESSAGE_FIELDS).await
}

async fn run(
    api: &ApiState,
    request: v1::QueryHistoryRequest,
    fields: &FieldNames,
) -> Answer<v1::QueryHistoryResponse> {
    let query = history_query(api, request, fields)?;
    let answer = run_query(api, query, QUERY_BYTES, |result| Ok(message(&result))).await?;
    Ok(Json(answer.into_inner()))
}

fn history_query(
    api: &ApiState,
    request: v1::QueryHistoryRequest,
    fields: &FieldNames,
) -> Result<HistoryQuery, ApiError> {
    let until = match request.until_time_ns {
        0 => api.clock.now(),
        ns => Timestamp::from_ns(ns),
    };
    let from = match request.from_time_ns {
        0 => until.plus_seconds(-HOUR_S),
        ns => Timestamp::from_ns(ns),
    };
    if from > until {
        let expected = format!("a time before `{}`", fields.until);
        return Err(ApiError::invalid(fields.from, expected, from.as_ns()));
    }
    let max_points = match request.max_points as usize {
        0 => MAX_POINTS,
        most if most <= MAX_POINTS => most,
        most => return Err(ApiError::invalid("max_points", format!("1 to {MAX_POINTS}"), most)),
    };
    let region = request.region.map(|it| Region::checked(it, fields.corners)).transpose()?;
    let region_m = region.map(|it| [it.min_m.into(), it.max_m.into()]);
    let objects = request.objects;
    Ok(HistoryQuery { objects, region_m, from, until, max_points, step_s: None })
}

async fn run_query<T: Send + 'static>(
    api: &ApiState,
    query: HistoryQuery,
    bytes: usize,
    write: fn(HistoryResult) -> Result<T, HistoryError>,
) -> Result<Charged<T>, ApiError> {
    let history = api.history.clone().ok_or_else(|| {
        ApiError::FailedPrecondition(
            "this server keeps no history: add [history] to its configuration".to_owned(),
        )
    })?;
    api.files.run(bytes, move |stop| write(history.query(&query, stop)?)).await
}

impl From<HistoryError> for ApiError {
    fn from(error: HistoryError) -> Self {
        match error {
            HistoryError::TooManyPoints { .. } => {
                Self::Invalid { field: "from", message: error.to_string() }
            }
            HistoryError::Stopped => stopped(),
            _ => Self::FailedPrecondition(error.to_string()),
        }
    }
}

fn message(result: &HistoryResult) -> v1::QueryHistoryResponse {
    let point = |point: &HistoryPoint| {
        let [x, y, z] = point.position_m;
        v1::HistoryPoint {
            time_ns: point.time.as_ns(),
            position: Some(v1::Vector3 { x, y, z }),
            yaw_rad: point.yaw_rad,
        }
    };
    let each = result.objects.iter().map(|(identity, points)| v1::ObjectHistory {
        object_id: identity.id,
        source_id: identity.run.clone(),
        name: identity.name.clone(),
        roundel: identity.kind.clone(),
        code: identity.code,
        points: points.iter().map(point).collect(),
    });
    let points: usize = result.objects.iter().map(|(_, points)| points.len()).sum();
    let (oldest, newest) = result.kept.unwrap_or_default();
    v1::QueryHistoryResponse {
        objects: each.collect(),
        step_s: result.step_s,
        points: points as u32,
        oldest_time_ns: oldest.as_ns(),
        newest_time_ns: newest.as_ns(),
    }
}
