//! Objects that are named, added, changed and removed while they are being served, over REST; the same functions answer
//! gRPC.

use std::sync::Arc;

use axum::{
    Json,
    extract::{State, rejection::JsonRejection},
};
use roundel_core::id::ObjectId;
use roundel_proto::v1;
use serde::Deserialize;
use serde_json::{Map, Value};
use utoipa::ToSchema;

use super::{
    ApiState,
    error::{ApiError, ErrorBody},
    path::{Segment, object_number, text_of},
    setup::{manager_if_allowed, run_blocking},
};
use crate::model::config::edit::Message;

const EXAMPLE: &str = concat!(
    r#"{"name": "cart", "roundel": "robot", "code": 3, "offset_m": {"x": 0, "y": 0, "z": -0.3}} "#,
    r#"(or "roundels": [{"kind": "robot", "code": 3, "position_m": {"x": 0.2, "y": 0, "z": 0.1}}])"#
);
const NAME_EXAMPLE: &str = r#"{"name": "cart"}"#;

/// An object as the configuration says it.
#[utoipa::path(
    get, path = "/api/v1/configuration/objects/{name}", tag = "configuration",
    params(("name" = String, Path, description = "its configured name")),
    responses(
        (status = 200, description = "what is written there", body = v1::ObjectSetup),
        (status = 404, description = "no such object", body = ErrorBody),
        (status = 409, description = "clients may not", body = ErrorBody),
    ),
)]
pub async fn show(
    State(api): State<Arc<ApiState>>,
    name: Segment,
) -> Result<Json<v1::ObjectSetup>, ApiError> {
    written(&api, text_of(name)?).await.map(Json)
}

/// Adds an object while everything else goes on, and writes it into the configuration.
#[utoipa::path(
    post, path = "/api/v1/configuration/objects", tag = "configuration",
    request_body = v1::ObjectSetup,
    responses(
        (status = 200, description = "it is known from now on; if it was followed by its code, it is followed on", body = v1::ObjectChange),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 409, description = "the configuration cannot be written, or clients may not", body = ErrorBody),
    ),
)]
pub async fn add(
    State(api): State<Arc<ApiState>>,
    body: Result<Json<v1::ObjectSetup>, JsonRejection>,
) -> Result<Json<v1::ObjectChange>, ApiError> {
    add_object(&api, ApiError::body(body, EXAMPLE)?).await.map(Json)
}

/// Changes an object while everything else goes on, and writes that into the configuration.
///
/// What the body does not name stays as it is; null takes a key out. Under another name, or by another point, it is
/// followed on; with other roundels or another way to move it is followed anew.
#[utoipa::path(
    patch, path = "/api/v1/configuration/objects/{name}", tag = "configuration",
    params(("name" = String, Path, description = "its configured name")),
    request_body = v1::ObjectSetup,
    responses(
        (status = 200, description = "it is as wanted", body = v1::ObjectChange),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 404, description = "no such object", body = ErrorBody),
        (status = 409, description = "the configuration cannot be written, or clients may not", body = ErrorBody),
    ),
)]
pub async fn change(
    State(api): State<Arc<ApiState>>,
    name: Segment,
    body: Result<Json<Map<String, Value>>, JsonRejection>,
) -> Result<Json<v1::ObjectChange>, ApiError> {
    let (name, body) = (text_of(name)?, ApiError::body(body, EXAMPLE)?);
    let (object, fields) = ApiError::fields(body, EXAMPLE)?;
    let request = v1::ChangeObjectRequest { name, object: Some(object), fields };
    change_object(&api, request).await.map(Json)
}

/// Removes an object while everything else goes on, and takes it out of the configuration.
///
/// If it was known by its code, it is followed on without a name.
#[utoipa::path(
    delete, path = "/api/v1/configuration/objects/{name}", tag = "configuration",
    params(("name" = String, Path, description = "its configured name")),
    responses(
        (status = 200, description = "it is configured no more", body = v1::ObjectChange),
        (status = 400, description = "a camera rides on it", body = ErrorBody),
        (status = 404, description = "no such object", body = ErrorBody),
        (status = 409, description = "the configuration cannot be written, or clients may not", body = ErrorBody),
    ),
)]
pub async fn remove(
    State(api): State<Arc<ApiState>>,
    name: Segment,
) -> Result<Json<v1::ObjectChange>, ApiError> {
    remove_object(&api, text_of(name)?).await.map(Json)
}

/// What something is to be called.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Name {
    /// Unique among the objects.
    pub name: String,
}

/// Gives a name to an object that is seen, and writes that into the configuration.
///
/// A configured object gets another name; any other one is configured from now on, by its code, or by its kind of roundel
/// if it is the only one of it.
#[utoipa::path(
    put, path = "/api/v1/objects/{id}/name", tag = "configuration",
    params(("id" = u64, Path, description = "object_id")),
    request_body = Name,
    responses(
        (status = 200, description = "it goes by that name, and is followed on", body = v1::ObjectChange),
        (status = 400, description = "the name is taken, or none", body = ErrorBody),
        (status = 404, description = "no such object now or within the last minute", body = ErrorBody),
        (status = 409, description = "nothing tells it from others, the configuration cannot be written, or clients may not", body = ErrorBody),
    ),
)]
pub async fn name(
    State(api): State<Arc<ApiState>>,
    id: Segment,
    body: Result<Json<Name>, JsonRejection>,
) -> Result<Json<v1::ObjectChange>, ApiError> {
    let (object_id, Name { name }) = (object_number(id)?, ApiError::body(body, NAME_EXAMPLE)?);
    name_object(&api, v1::NameObjectRequest { object_id, name }).await.map(Json)
}

pub(super) async fn written(api: &ApiState, name: String) -> Result<v1::ObjectSetup, ApiError> {
    let camera_manager = manager_if_allowed(api)?;
    run_blocking(move || camera_manager.object_setup(&name)).await
}

pub(super) async fn add_object(
    api: &ApiState,
    object: v1::ObjectSetup,
) -> Result<v1::ObjectChange, ApiError> {
    let (camera_manager, name) = (manager_if_allowed(api)?, object.name.clone());
    let kept = run_blocking(move || camera_manager.add_object(&object)).await?;
    change_of(api, name, kept).await
}

pub(super) async fn change_object(
    api: &ApiState,
    request: v1::ChangeObjectRequest,
) -> Result<v1::ObjectChange, ApiError> {
    let v1::ChangeObjectRequest { name, object, mut fields } = request;
    fields
        .iter_mut()
        .filter(|field| *field == "roundels")
        .for_each(|field| "roundel".clone_into(field));
    let known = v1::ObjectSetup::KEYS;
    if let Some(unknown) = fields.iter().find(|field| !known.contains(&field.as_str())) {
        let expected = format!("any of {}, roundels", known.join(", "));
        return Err(ApiError::invalid("fields", expected, format!("{unknown:?}")));
    }
    let (camera_manager, object) = (manager_if_allowed(api)?, object.unwrap_or_default());
    let change = move || {
        let fields: Vec<&str> = fields.iter().map(String::as_str).collect();
        camera_manager.change_object(&name, &object, &fields)
    };
    let (name, kept) = run_blocking(change).await?;
    change_of(api, name, kept).await
}

pub(super) async fn remove_object(
    api: &ApiState,
    name: String,
) -> Result<v1::ObjectChange, ApiError> {
    let (camera_manager, object) = (manager_if_allowed(api)?, api.hub.object_by_name(&name));
    let kept = run_blocking(move || camera_manager.remove_object(&name)).await?;
    Ok(v1::ObjectChange { object: None, kept, object_id: object.map_or(0, |object| object.0) })
}

pub(super) async fn name_object(
    api: &ApiState,
    request: v1::NameObjectRequest,
) -> Result<v1::ObjectChange, ApiError> {
    let v1::NameObjectRequest { object_id, name } = request;
    let (camera_manager, fresh) = (manager_if_allowed(api)?, name.clone());
    let kept =
        run_blocking(move || camera_manager.name_object(ObjectId(object_id), &fresh)).await?;
    Ok(v1::ObjectChange { object_id, ..change_of(api, name, kept).await? })
}

async fn change_of(
    api: &ApiState,
    name: String,
    kept: String,
) -> Result<v1::ObjectChange, ApiError> {
    let object_id = api.hub.object_by_name(&name).map_or(0, |object| object.0);
    Ok(v1::ObjectChange { object: Some(written(api, name).await?), kept, object_id })
}
