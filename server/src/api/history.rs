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
    Api,
    error::{ApiError, ErrorBody},
    query::Parameters,
    region::Region,
};
use crate::{
    api::convert,
    archive::history::{
        HistoryError, export,
        store::{Answer, MAX_EXPORTED, MAX_POINTS, Question},
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
    State(api): State<Arc<Api>>,
    uri: Uri,
) -> Result<Json<v1::QueryHistoryResponse>, ApiError> {
    let mut parameters = Parameters::of(&uri)?;
    let request = wish(&mut parameters)?;
    parameters.finish()?;
    answered(&api, request, &PARAMETERS).await.map(Json)
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
pub async fn export(State(api): State<Arc<Api>>, uri: Uri) -> Result<Response, ApiError> {
    let text = written(whole(&api, &uri).await?, |answer| Ok(export::csv(answer))).await?;
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
pub async fn parquet(State(api): State<Arc<Api>>, uri: Uri) -> Result<Response, ApiError> {
    let bytes = written(whole(&api, &uri).await?, export::parquet).await?;
    let kind = "application/vnd.apache.parquet";
    Ok(file(kind, "attachment; filename=\"history.parquet\"", bytes))
}

/// A table, on a thread that may take its time for millions of rows.
async fn written<T: Send + 'static>(
    answer: Answer,
    write: fn(&Answer) -> Result<T, HistoryError>,
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
async fn whole(api: &Api, uri: &Uri) -> Result<Answer, ApiError> {
    let mut parameters = Parameters::of(uri)?;
    let step_s = parameters.take_parsed::<f64>("step_s", "a number of seconds")?.unwrap_or(0.1);
    if step_s.is_nan() || step_s <= 0.0 {
        return Err(ApiError::invalid("step_s", "seconds above 0", step_s));
    }
    let mut request = wish(&mut parameters)?;
    parameters.finish()?;
    request.max_points = 0;
    let question = question(api, request, &PARAMETERS)?;
    ask(api, Question { max_points: MAX_EXPORTED, step_s: Some(step_s), ..question }).await
}

fn wish(parameters: &mut Parameters) -> Result<v1::QueryHistoryRequest, ApiError> {
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
    api: &Api,
    request: v1::QueryHistoryRequest,
) -> Result<v1::QueryHistoryResponse, ApiError> {
    answered(api, request, &MESSAGE_FIELDS).await
}

async fn answered(
    api: &Api,
    request: v1::QueryHistoryRequest,
    fields: &Fields,
) -> Result<v1::QueryHistoryResponse, ApiError> {
    let question = question(api, request, fields)?;
    Ok(convert::history(&ask(api, question).await?))
}

fn question(
    api: &Api,
    request: v1::QueryHistoryRequest,
    fields: &Fields,
) -> Result<Question, ApiError> {
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
    Ok(Question { objects, region_m, from, until, max_points, step_s: None })
}

/// On a thread that may wait for the disk.
async fn ask(api: &Api, question: Question) -> Result<Answer, ApiError> {
    let history = api.history.clone().ok_or_else(|| {
        ApiError::FailedPrecondition(
            "this server keeps no history: [history] in its configuration says where to".to_owned(),
        )
    })?;
    let answered = tokio::task::spawn_blocking(move || history.ask(&question)).await;
    let answered = answered
        .map_err(|error| ApiError::Internal(format!("the history ended badly: {error}")))?;
    Ok(answered?)
}

impl From<HistoryError> for ApiError {
    fn from(error: HistoryError) -> Self {
        match error {
            HistoryError::TooMuch(found) => Self::Invalid { field: "from", message: found },
            HistoryError::Store { .. } | HistoryError::Newer { .. } | HistoryError::Form(_) => {
                Self::FailedPrecondition(error.to_string())
            }
        }
    }
}
