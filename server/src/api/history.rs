//! The history, over REST; the same functions answer gRPC.

use std::sync::Arc;

use axum::{
    Json,
    extract::State,
    http::{HeaderValue, Uri, header},
    response::{IntoResponse, Response},
};
use roundel_core::time::Timestamp;
use roundel_proto::v1;

use super::{
    ApiState,
    error::{ApiError, ErrorBody},
    query::QueryParameters,
    region::Region,
};
use crate::{
    api::convert,
    archive::history::{
        HistoryError, export,
        store::{HistoryQuery, HistoryResult, MAX_EXPORT_ROWS, MAX_POINTS},
    },
};

const HOUR_S: f64 = 3600.0;

/// What a request's fields are called, for errors.
struct Fields {
    from: &'static str,
    until: &'static str,
    corners: [&'static str; 2],
}

const PARAMETERS: Fields = Fields { from: "from", until: "until", corners: ["min", "max"] };
const MESSAGE_FIELDS: Fields =
    Fields { from: "from_time_ns", until: "until_time_ns", corners: ["region.min", "region.max"] };

/// Where objects were: ever fewer points of what is longer ago.
#[utoipa::path(
    get, path = "/api/v1/history", tag = "poses",
    params(
        ("objects" = Option<String>, Query, description = "only these, by id, name or code's number, commas between", example = "3,cart"),
        ("from" = Option<i64>, Query, description = "ns since the Unix epoch; an hour before `until` if left out"),
        ("until" = Option<i64>, Query, description = "ns since the Unix epoch; now if left out"),
        ("min" = Option<String>, Query, description = "with max: only places in this box of the world frame; its smallest corner, metres", example = "-1,-1,0"),
        ("max" = Option<String>, Query, description = "the box's largest corner, metres", example = "1,1,2"),
        ("max_points" = Option<u32>, Query, description = "at most so many of all objects together, 1 to 5000"),
    ),
    responses(
        (status = 200, description = "each object's course", body = v1::QueryHistoryResponse),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
        (status = 409, description = "none is kept ([history] in the configuration)", body = ErrorBody),
    ),
)]
pub async fn show(
    State(api): State<Arc<ApiState>>,
    uri: Uri,
) -> Result<Json<v1::QueryHistoryResponse>, ApiError> {
    let mut parameters = QueryParameters::of(&uri)?;
    let request = query_of(&mut parameters)?;
    parameters.finish()?;
    run(&api, request, &PARAMETERS).await.map(Json)
}

/// The same as a table for other programs, without thinning.
#[utoipa::path(
    get, path = "/api/v1/history.csv", tag = "poses",
    params(
        ("objects" = Option<String>, Query, description = "as of /api/v1/history"),
        ("from" = Option<i64>, Query, description = "as of /api/v1/history"),
        ("until" = Option<i64>, Query, description = "as of /api/v1/history"),
        ("min" = Option<String>, Query, description = "as of /api/v1/history"),
        ("max" = Option<String>, Query, description = "as of /api/v1/history"),
        ("step_s" = Option<f64>, Query, description = "seconds from one point to the next: 0.1 (if left out), 1, 10, 100 or 1000, or what is next below"),
    ),
    responses(
        (status = 200, description = "time_ns,object_id,name,roundel,code,x_m,y_m,z_m,yaw_rad,source_id", body = String, content_type = "text/csv"),
        (status = 400, description = "names the wrong parameter, or more than 2,000,000 rows", body = ErrorBody),
        (status = 409, description = "none is kept ([history] in the configuration)", body = ErrorBody),
    ),
)]
pub async fn export(State(api): State<Arc<ApiState>>, uri: Uri) -> Result<Response, ApiError> {
    let text = written(unthinned(&api, &uri).await?, |answer| Ok(export::csv(answer))).await?;
    Ok(file("text/csv; charset=utf-8", "attachment; filename=\"history.csv\"", text))
}

/// The same as Parquet, from a server that was built with it.
#[utoipa::path(
    get, path = "/api/v1/history.parquet", tag = "poses",
    params(
        ("objects" = Option<String>, Query, description = "as of /api/v1/history"),
        ("from" = Option<i64>, Query, description = "as of /api/v1/history"),
        ("until" = Option<i64>, Query, description = "as of /api/v1/history"),
        ("min" = Option<String>, Query, description = "as of /api/v1/history"),
        ("max" = Option<String>, Query, description = "as of /api/v1/history"),
        ("step_s" = Option<f64>, Query, description = "as of /api/v1/history.csv"),
    ),
    responses(
        (status = 200, description = "the columns of history.csv; time_ns is a timestamp, and what is not known is null", body = Vec<u8>, content_type = "application/vnd.apache.parquet"),
        (status = 400, description = "names the wrong parameter, or more than 2,000,000 rows", body = ErrorBody),
        (status = 409, description = "none is kept ([history] in the configuration), or this server writes no Parquet", body = ErrorBody),
    ),
)]
pub async fn parquet(State(api): State<Arc<ApiState>>, uri: Uri) -> Result<Response, ApiError> {
    let bytes = written(unthinned(&api, &uri).await?, export::parquet).await?;
    let kind = "application/vnd.apache.parquet";
    Ok(file(kind, "attachment; filename=\"history.parquet\"", bytes))
}

/// A table, on a thread that may take its time for millions of rows.
async fn written<T: Send + 'static>(
    answer: HistoryResult,
    write: fn(&HistoryResult) -> Result<T, HistoryError>,
) -> Result<T, ApiError> {
    let written = tokio::task::spawn_blocking(move || write(&answer)).await;
    let written =
        written.map_err(|error| ApiError::Internal(format!("the table ended badly: {error}")))?;
    Ok(written?)
}

fn file(kind: &'static str, disposition: &'static str, content: impl IntoResponse) -> Response {
    let headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static(kind)),
        (header::CONTENT_DISPOSITION, HeaderValue::from_static(disposition)),
    ];
    (headers, content).into_response()
}

/// All that is asked for, without thinning.
async fn unthinned(api: &ApiState, uri: &Uri) -> Result<HistoryResult, ApiError> {
    let mut parameters = QueryParameters::of(uri)?;
    let step_s = parameters.take_parsed::<f64>("step_s", "a number of seconds")?.unwrap_or(0.1);
    if step_s.is_nan() || step_s <= 0.0 {
        return Err(ApiError::invalid("step_s", "seconds above 0", step_s));
    }
    let mut request = query_of(&mut parameters)?;
    parameters.finish()?;
    request.max_points = 0;
    let query = history_query(api, request, &PARAMETERS)?;
    run_query(api, HistoryQuery { max_points: MAX_EXPORT_ROWS, step_s: Some(step_s), ..query })
        .await
}

fn query_of(parameters: &mut QueryParameters) -> Result<v1::QueryHistoryRequest, ApiError> {
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
    api: &ApiState,
    request: v1::QueryHistoryRequest,
) -> Result<v1::QueryHistoryResponse, ApiError> {
    run(api, request, &MESSAGE_FIELDS).await
}

async fn run(
    api: &ApiState,
    request: v1::QueryHistoryRequest,
    fields: &Fields,
) -> Result<v1::QueryHistoryResponse, ApiError> {
    let query = history_query(api, request, fields)?;
    Ok(convert::history(&run_query(api, query).await?))
}

fn history_query(
    api: &ApiState,
    request: v1::QueryHistoryRequest,
    fields: &Fields,
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

/// On a thread that may wait for the disk.
async fn run_query(api: &ApiState, query: HistoryQuery) -> Result<HistoryResult, ApiError> {
    let history = api.history.clone().ok_or_else(|| {
        ApiError::FailedPrecondition(
            "this server keeps no history: [history] in its configuration says where to".to_owned(),
        )
    })?;
    let run = tokio::task::spawn_blocking(move || history.query(&query)).await;
    let run =
        run.map_err(|error| ApiError::Internal(format!("the history ended badly: {error}")))?;
    Ok(run?)
}

impl From<HistoryError> for ApiError {
    fn from(error: HistoryError) -> Self {
        match error {
            HistoryError::TooManyPoints(found) => Self::Invalid { field: "from", message: found },
            HistoryError::Store { .. } | HistoryError::Newer { .. } | HistoryError::Format(_) => {
                Self::FailedPrecondition(error.to_string())
            }
        }
    }
}
