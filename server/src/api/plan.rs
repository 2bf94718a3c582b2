//! What the cameras of this server would make of roundels all over the arena: a map.

use std::sync::Arc;

use axum::{
    Json,
    extract::State,
    http::{HeaderValue, Uri, header},
    response::{IntoResponse, Response},
};
use clap::ValueEnum as _;
use roundel_core::{
    marker::{Kind, Polarity},
    plan::{
        Imaging,
        map::{Field, map},
    },
};

use super::{
    ApiState,
    error::{ApiError, ErrorBody},
    query::QueryParameters,
};
use crate::lab::{
    plan::{
        DEFAULT_SPOTS, map_drawing,
        plan_map::MapLayer,
        plan_map::{PlanMap, usable_stations},
        planned_camera::{self, PlannedCamera},
    },
    print::spec::{self, PrintSpec},
};

/// Most spots that are computed for a request.
const MAX_SPOTS: usize = 20_000;
/// Roundels lie so high, if nobody says how high, metres.
const HEIGHT_M: f64 = 0.3;

/// How exactly roundels would be located that lie face up, all over the arena, by the cameras as they stand now and with
/// the blur and noise that are measured of them: from one set of frames, by the covariances that fusion uses.
#[utoipa::path(
    get, path = "/api/v1/plan", tag = "plan",
    params(
        ("format" = Option<String>, Query, description = "json, svg or png [json]"),
        ("show" = Option<String>, Query, description = "of pictures: precision or cameras [precision]"),
        ("roundel" = Option<String>, Query, description = "name of a kind of the configuration [the first one]", example = "robot"),
        ("marker" = Option<String>, Query, description = "another roundel instead: OUTER_MM:INNER_MM", example = "160:64"),
        ("code" = Option<String>, Query, description = "with marker: BITS[:DISTANCE]", example = "8:2"),
        ("height" = Option<f64>, Query, description = "of the roundels, metres [0.3]"),
        ("min" = Option<String>, Query, description = "x,y where the map begins, metres [what the cameras see]", example = "-5,-4"),
        ("max" = Option<String>, Query, description = "x,y where it ends, metres", example = "5,4"),
        ("step" = Option<f64>, Query, description = "from spot to spot, metres [2400 spots]"),
    ),
    responses(
        (status = 200, description = "the map", body = PlanMap),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
        (status = 409, description = "no camera's place is known", body = ErrorBody),
    ),
)]
pub async fn show(State(api): State<Arc<ApiState>>, uri: Uri) -> Result<Response, ApiError> {
    let mut parameters = QueryParameters::of(&uri)?;
    let format = parameters.take("format")?.unwrap_or_else(|| "json".to_owned());
    let show = match parameters.take("show")? {
        Some(word) => MapLayer::from_str(&word, true)
            .map_err(|_| ApiError::invalid("show", "precision or cameras", word))?,
        None => MapLayer::default(),
    };
    let kind = kind(&api, &mut parameters)?;
    let height_m = parameters.take_parsed("height", "metres")?.unwrap_or(HEIGHT_M);
    let [least_m, most_m] = Field::HEIGHTS_M;
    if !(least_m..=most_m).contains(&height_m) {
        let expected = format!("{least_m} to {most_m} metres");
        return Err(ApiError::invalid("height", expected, height_m));
    }
    let corners = [corner(&mut parameters, "min")?, corner(&mut parameters, "max")?];
    let step_m = parameters.take_parsed::<f64>("step", "metres")?;
    parameters.finish()?;
    if !["json", "svg", "png"].contains(&format.as_str()) {
        return Err(ApiError::invalid("format", "json, svg or png", format!("{format:?}")));
    }
    let cameras = cameras(&api);
    let field = field(&cameras, height_m, corners, step_m)?;
    let work = move || -> Result<Response, ApiError> {
        let wrong = |error: roundel_core::plan::PlanError| ApiError::Invalid {
            field: "query",
            message: error.to_string(),
        };
        let map = map(&usable_stations(&cameras), &kind, field).map_err(wrong)?;
        let map = PlanMap::of(&map, &kind.name, &cameras);
        match format.as_str() {
            "svg" => Ok(sent("image/svg+xml", map_drawing::svg(&map, show).into_bytes())),
            "png" => map_drawing::png(&map, show)
                .map(|bytes| sent("image/png", bytes))
                .map_err(|error| ApiError::Internal(error.to_string())),
            _ => Ok(Json(map).into_response()),
        }
    };
    tokio::task::spawn_blocking(work)
        .await
        .map_err(|error| ApiError::Internal(format!("planning ended early: {error}")))?
}

/// The cameras as they are now, in their order.
fn cameras(api: &ApiState) -> Vec<PlannedCamera> {
    let installation = api.hub.installation();
    let states = api.hub.cameras();
    let usual = Imaging::default();
    let each = installation.cameras.iter();
    each.filter_map(|(id, info)| {
        Some(planned_camera::from_running(info, states.get(id)?, usual, &api.trials))
    })
    .collect()
}

fn kind(api: &ApiState, parameters: &mut QueryParameters) -> Result<Kind, ApiError> {
    let name = parameters.take("roundel")?;
    let marker = parameters.take("marker")?;
    let code = match parameters.take("code")? {
        Some(_) if marker.is_none() => {
            let expected =
                "a `marker` beside it, since kinds of the configuration have their codes";
            return Err(ApiError::invalid("code", expected, "none"));
        }
        Some(text) => Some(
            spec::code(&text).map_err(|message| ApiError::Invalid { field: "code", message })?,
        ),
        None => None,
    };
    if let Some(text) = marker {
        if name.is_some() {
            return Err(ApiError::invalid("marker", "no `roundel` beside it", "both"));
        }
        let wrong = |message| ApiError::Invalid { field: "marker", message };
        let diameters = spec::diameters(&text).map_err(wrong)?;
        let print = PrintSpec { diameters: Some(diameters), code, polarity: Polarity::BlackRing };
        let expected =
            || ApiError::invalid("marker", "OUTER_MM:INNER_MM, such as 160:64, or a `code`", text);
        return Ok(Kind { name: "the roundel".to_owned(), ..print.kind().ok_or_else(expected)? });
    }
    let known = || -> Vec<&str> { api.kinds.iter().map(|kind| kind.name.as_str()).collect() };
    match name {
        Some(name) => {
            let found = api.kinds.iter().find(|kind| kind.name == name);
            let known = format!("the kinds here are {}", known().join(", "));
            found.cloned().ok_or(ApiError::NotFound { what: "roundel", name, known })
        }
        None => api.kinds.first().cloned().ok_or_else(|| {
            let expected = "OUTER_MM:INNER_MM, since no size of a roundel is known here";
            ApiError::invalid("marker", expected, "nothing")
        }),
    }
}

/// What is looked at: what was asked for, else what the cameras see.
fn field(
    cameras: &[PlannedCamera],
    height_m: f64,
    [low, high]: [Option<[f64; 2]>; 2],
    step_m: Option<f64>,
) -> Result<Field, ApiError> {
    let stations = usable_stations(cameras);
    if stations.is_empty() {
        let reasons: Vec<String> = cameras
            .iter()
            .filter_map(|camera| {
                Some(format!("{}: {}", camera.name, camera.station.as_ref().err()?))
            })
            .collect();
        return Err(ApiError::FailedPrecondition(format!(
            "expected a camera whose lens and place are known, found none; {}",
            if reasons.is_empty() { "there are no cameras".to_owned() } else { reasons.join("; ") }
        )));
    }
    let seen = Field::seen_by(&stations, height_m, DEFAULT_SPOTS);
    let (low_m, high_m) = match (low.zip(high), &seen) {
        (Some(corners), _) => corners,
        (None, Some(seen)) => (low.unwrap_or(seen.low_m), high.unwrap_or(seen.high_m)),
        (None, None) => {
            let message = format!(
                "no camera looks down on the plane {height_m} m high: say `min` and `max`, or another height"
            );
            return Err(ApiError::Invalid { field: "height", message });
        }
    };
    let sides = [high_m[0] - low_m[0], high_m[1] - low_m[1]];
    let usual_m = (sides[0] * sides[1] / DEFAULT_SPOTS as f64).max(0.0).sqrt();
    let field = Field { low_m, high_m, height_m, step_m: step_m.unwrap_or(usual_m) };
    let wrong = |error: roundel_core::plan::PlanError| ApiError::Invalid {
        field: "query",
        message: error.to_string(),
    };
    let [columns, rows] = field.counts().map_err(wrong)?;
    if columns * rows > MAX_SPOTS {
        let expected = format!("so long a step that there are at most {MAX_SPOTS} spots");
        return Err(ApiError::invalid("step", expected, format!("{columns} x {rows}")));
    }
    Ok(field)
}

fn corner(
    parameters: &mut QueryParameters,
    name: &'static str,
) -> Result<Option<[f64; 2]>, ApiError> {
    let numbers: Vec<f64> = parameters.take_list(name, "x,y in metres")?;
    match numbers[..] {
        [] => Ok(None),
        [x, y] => Ok(Some([x, y])),
        _ => Err(ApiError::invalid(name, "x,y in metres", format!("{} numbers", numbers.len()))),
    }
}

fn sent(kind: &'static str, bytes: Vec<u8>) -> Response {
    ([(header::CONTENT_TYPE, HeaderValue::from_static(kind))], bytes).into_response()
}
