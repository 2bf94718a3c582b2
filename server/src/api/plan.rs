//! `GET /api/v1/plan`: a map of the precision and coverage of this server's cameras.

use std::sync::Arc;

use axum::{
    extract::State,
    http::{Uri, header},
    response::{IntoResponse, Response},
};
use clap::ValueEnum as _;
use roundel_core::{
    marker::{Kind, Polarity},
    plan::{
        Imaging, PlanError,
        map::{MapArea, PlacedCamera, map_while},
    },
};

use super::{
    ApiState,
    error::{ApiError, ErrorBody},
    heavy::{half_of_the_processors, stopped},
    print::take_spec,
    query::QueryParameters,
};
use crate::{
    lab::{
        plan::{
            map_area,
            map_drawing::{self, MapFormat},
            plan_map::{MapLayer, PlanMap},
            planned_camera::{self, usable_stations},
        },
        print::spec::{self, PrintSpec},
    },
    model::stop::StopSignal,
};

/// Maximum number of spots of one request.
const MAX_SPOTS: usize = 20_000;
/// Memory of the largest map and its encoding.
const MAP_BYTES: usize = 16 * 1024 * 1024;
/// Default height of the roundels, metres.
const HEIGHT_M: f64 = 0.3;

/// Predicted precision over the arena for roundels that lie face up, after one frame of each camera.
///
/// Uses the cameras' current poses, their measured blur and noise, and fusion's covariances.
#[utoipa::path(
    get, path = "/api/v1/plan", tag = "plan",
    params(
        ("format" = Option<String>, Query, description = "json, svg or png [json]"),
        ("show" = Option<String>, Query, description = "layer of a picture: precision or cameras [precision]"),
        ("roundel" = Option<String>, Query, description = "a kind of the configuration [the first one]", example = "robot"),
        ("marker" = Option<String>, Query, description = "diameters of another roundel: OUTER_MM:INNER_MM", example = "160:64"),
        ("code" = Option<String>, Query, description = "with marker: BITS[:DISTANCE]", example = "8:2"),
        ("height" = Option<f64>, Query, description = "height of the roundels, metres [0.3]"),
        ("min" = Option<String>, Query, description = "least x,y of the map, metres [what the cameras see]", example = "-5,-4"),
        ("max" = Option<String>, Query, description = "greatest x,y of the map, metres [what the cameras see]", example = "5,4"),
        ("step" = Option<f64>, Query, description = "distance between spots, metres [about 2400 spots]"),
    ),
    responses(
        (status = 200, description = "the map", body = PlanMap),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
        (status = 409, description = "no camera with a known pose", body = ErrorBody),
        (status = 503, description = "the server is busy", body = ErrorBody),
    ),
)]
pub async fn show(State(api): State<Arc<ApiState>>, uri: Uri) -> Result<Response, ApiError> {
    let mut parameters = QueryParameters::of(&uri)?;
    let format = take_spec(&mut parameters, "format", |text| {
        let wrong = |_| format!("expected json, svg or png, found {text:?}");
        MapFormat::from_str(text, true).map_err(wrong)
    })?;
    let show = take_spec(&mut parameters, "show", |text| {
        let wrong = |_| format!("expected precision or cameras, found {text:?}");
        MapLayer::from_str(text, true).map_err(wrong)
    })?;
    let (format, show) = (format.unwrap_or(MapFormat::Json), show.unwrap_or_default());
    let kind = kind(&api, &mut parameters)?;
    let height_m = parameters.take_parsed("height", "metres")?.unwrap_or(HEIGHT_M);
    let [least_m, most_m] = MapArea::HEIGHTS_M;
    if !(least_m..=most_m).contains(&height_m) {
        let expected = format!("{least_m} to {most_m} metres");
        return Err(ApiError::invalid("height", expected, height_m));
    }
    let corners = [corner(&mut parameters, "min")?, corner(&mut parameters, "max")?];
    let step_m = parameters.take_parsed::<f64>("step", "metres")?;
    parameters.finish()?;
    let installation = api.hub.installation();
    let states = api.hub.cameras();
    let cameras: Vec<_> = installation
        .cameras
        .iter()
        .filter_map(|(id, info)| {
            let state = states.get(id)?;
            Some(planned_camera::from_running(info, state, Imaging::default(), &api.trials))
        })
        .collect();
    let stations = usable_stations(&cameras).map_err(ApiError::FailedPrecondition)?;
    let field = field(&stations, height_m, corners, step_m)?;
    let internal = |error: &dyn std::fmt::Display| ApiError::Internal(error.to_string());
    let work = move |stop: &StopSignal| {
        // The shared pool of threads would take every processor.
        let threads = rayon::ThreadPoolBuilder::new().num_threads(half_of_the_processors());
        let threads = threads.build().map_err(|error| internal(&error))?;
        let map = threads
            .install(|| map_while(&stations, &kind, field, || !stop.is_stopped()))
            .map_err(wrong_query)?
            .ok_or_else(stopped)?;
        let map = PlanMap::of(&map, &kind.name, &cameras);
        map_drawing::encode(&map, format, show).map_err(|error| internal(&error))
    };
    let bytes = api.files.run(MAP_BYTES, work).await?.into_bytes();
    Ok(([(header::CONTENT_TYPE, format.media_type())], bytes).into_response())
}

fn wrong_query(error: PlanError) -> ApiError {
    ApiError::Invalid { field: "query", message: error.to_string() }
}

fn kind(api: &ApiState, parameters: &mut QueryParameters) -> Result<Kind, ApiError> {
    let name = parameters.take("roundel")?;
    let diameters = take_spec(parameters, "marker", spec::diameters)?;
    let code = take_spec(parameters, "code", spec::code)?;
    if diameters.is_some() {
        if name.is_some() {
            return Err(ApiError::invalid("marker", "either `roundel` or `marker`", "both"));
        }
        let print = PrintSpec { diameters, code, polarity: Polarity::BlackRing };
        let expected = "OUTER_MM:INNER_MM, such as 160:64, or a `code`";
        let wrong = || ApiError::invalid("marker", expected, "an outer diameter alone");
        return Ok(Kind { name: "the roundel".to_owned(), ..print.kind().ok_or_else(wrong)? });
    }
    if code.is_some() {
        let expected = "a `marker` as well, since configured kinds have their own codes";
        return Err(ApiError::invalid("code", expected, "none"));
    }
    let Some(name) = name else {
        let expected = "OUTER_MM:INNER_MM, since this server has no configured roundels";
        let first = api.kinds.first().cloned();
        return first.ok_or_else(|| ApiError::invalid("marker", expected, "nothing"));
    };
    let known: Vec<&str> = api.kinds.iter().map(|kind| kind.name.as_str()).collect();
    let known = format!("the configured kinds are {}", known.join(", "));
    let found = api.kinds.iter().find(|kind| kind.name == name);
    found.cloned().ok_or(ApiError::NotFound { what: "roundel", name, known })
}

/// The requested part of the arena; by default what the cameras see.
fn field(
    stations: &[PlacedCamera],
    height_m: f64,
    [low, high]: [Option<[f64; 2]>; 2],
    step_m: Option<f64>,
) -> Result<MapArea, ApiError> {
    let corners_m = match (low.zip(high), MapArea::seen_corners_m(stations, height_m)) {
        (Some((low, high)), _) => [low, high],
        (None, Some([min_m, max_m])) => [low.unwrap_or(min_m), high.unwrap_or(max_m)],
        (None, None) => {
            let message = format!(
                "no camera sees the plane at a height of {height_m} m from above: set `min` and `max`, or another height"
            );
            return Err(ApiError::Invalid { field: "height", message });
        }
    };
    let field = map_area(corners_m, height_m, step_m);
    let [columns, rows] = field.counts().map_err(wrong_query)?;
    if columns * rows > MAX_SPOTS {
        let expected = format!("a step that gives at most {MAX_SPOTS} spots");
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
