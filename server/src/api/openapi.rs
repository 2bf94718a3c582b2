//! `/openapi.json`. Routes are built from their descriptions, so every route has one.

use std::sync::{Arc, OnceLock};

use axum::Json;
use utoipa::{OpenApi, openapi};
use utoipa_axum::{router::OpenApiRouter, routes};

use super::{
    ApiState, access::session, calibration, configuration, history, lens, metrics, objects, plan,
    print, recording, replay, rest, setup, simulation, source_probe, ws,
};

#[derive(OpenApi)]
#[openapi(info(
    title = "Roundel",
    description = "Where every robot is, live. Units are SI, frames and signs those of \
        core/docs/conventions.md; times are nanoseconds since the Unix epoch, as decimal strings. \
        The same messages are on gRPC, at the same address (package roundel.v1, with reflection).",
))]
struct Description;

/// Every path but the dashboard's files, with its description.
pub fn described_routes() -> OpenApiRouter<Arc<ApiState>> {
    OpenApiRouter::with_openapi(Description::openapi())
        .routes(routes!(rest::snapshot))
        .routes(routes!(rest::objects))
        .routes(routes!(rest::object))
        .routes(routes!(rest::print_sizes))
        .routes(routes!(objects::name))
        .routes(routes!(configuration::show, configuration::apply))
        .routes(routes!(configuration::text))
        .routes(routes!(configuration::check))
        .routes(routes!(objects::add))
        .routes(routes!(objects::show, objects::change, objects::remove))
        .routes(routes!(history::show))
        .routes(routes!(history::export))
        .routes(routes!(history::parquet))
        .routes(routes!(rest::cameras, setup::add))
        .routes(routes!(rest::camera, setup::change, setup::remove))
        .routes(routes!(setup::show))
        .routes(routes!(rest::frame))
        .routes(routes!(rest::observations))
        .routes(routes!(rest::events))
        .routes(routes!(rest::time))
        .routes(routes!(source_probe::test))
        .routes(routes!(rest::info))
        .routes(routes!(calibration::show, calibration::start, calibration::cancel))
        .routes(routes!(calibration::apply))
        .routes(routes!(lens::show, lens::start, lens::cancel))
        .routes(routes!(lens::finish))
        .routes(routes!(lens::picture))
        .routes(routes!(lens::file))
        .routes(routes!(lens::apply))
        .routes(routes!(plan::show))
        .routes(routes!(print::file))
        .routes(routes!(print::codes))
        .routes(routes!(recording::show, recording::start, recording::stop))
        .routes(routes!(recording::files))
        .routes(routes!(replay::show, replay::control))
        .routes(routes!(simulation::drive))
        .routes(routes!(simulation::push))
        .routes(routes!(ws::stream))
        .routes(routes!(session::show, session::sign_in, session::sign_out))
        .routes(routes!(document))
        .routes(routes!(metrics::metrics))
        .routes(routes!(metrics::health))
        .routes(routes!(metrics::readiness))
}

/// This description.
#[utoipa::path(
    get, path = "/openapi.json", tag = "server",
    responses((status = 200, description = "OpenAPI 3.1", content_type = "application/json")),
)]
pub async fn document() -> Json<&'static openapi::OpenApi> {
    static DOCUMENT: OnceLock<openapi::OpenApi> = OnceLock::new();
    Json(DOCUMENT.get_or_init(|| described_routes().into_openapi()))
}
