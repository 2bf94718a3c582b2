//! Names, adds, changes and removes objects of the running system.

use axum::{Json, extract::State};
use roundel_core::id::ObjectId;
use roundel_proto::v1;
use serde::Deserialize;
use utoipa::ToSchema;

use super::{
    ApiState,
    error::{ApiError, ErrorBody},
    handler::{Answer, Api, Body, Changes, Example, Segment, blocking},
    setup::manager_if_allowed,
};
use crate::model::config::edit::Message;

impl Example for v1::ObjectSetup {
    const EXAMPLE: &str = concat!(
        r#"{"name": "cart", "roundel": "robot", "code": 3, "offset_m": {"x": 0, "y": 0, "z": -0.3}} "#,
        r#"(or "roundels": [{"kind": "robot", "code": 3, "position_m": {"x": 0.2, "y": 0, "z": 0.1}}])"#
    );
}

/// An object's configuration.
#[utoipa::path(
    get, path = "/api/v1/configuration/objects/{name}", tag = "configuration",
    params(("name" = String, Path, description = "its configured name")),
    responses(
        (status = 200, description = "the configuration", body = v1::ObjectSetup),
        (status = 404, description = "no such object", body = ErrorBody),
        (status = 409, description = "clients must not change the configuration", body = ErrorBody),
    ),
)]
pub async fn show(State(api): Api, Segment(name): Segment) -> Answer<v1::ObjectSetup> {
    configured(&api, name).await.map(Json)
}

/// Adds an object to the running system and the configuration file.
#[utoipa::path(
    post, path = "/api/v1/configuration/objects", tag = "configuration",
    request_body = v1::ObjectSetup,
    responses(
        (status = 200, description = "the object was added; a track with its code continues", body = v1::ObjectChange),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 409, description = "the configuration cannot be written, or clients must not change the configuration", body = ErrorBody),
    ),
)]
pub async fn add(State(api): Api, Body(object): Body<v1::ObjectSetup>) -> Answer<v1::ObjectChange> {
    let (manager, name) = (manager_if_allowed(&api)?, object.name.clone());
    let kept = blocking(move || manager.add_object(&object)).await?;
    change_of(&api, name, kept).await
}

/// Changes an object of the running system and the configuration file.
///
/// Keys that the body does not name keep their values; null removes a key. Another name or another tracked point
/// continues the track; other roundels or another motion class begin a new one.
#[utoipa::path(
    patch, path = "/api/v1/configuration/objects/{name}", tag = "configuration",
    params(("name" = String, Path, description = "its configured name")),
    request_body = v1::ObjectSetup,
    responses(
        (status = 200, description = "the object was changed", body = v1::ObjectChange),
        (status = 400, description = "names the wrong field", body = ErrorBody),
        (status = 404, description = "no such object", body = ErrorBody),
        (status = 409, description = "the configuration cannot be written, or clients must not change the configuration", body = ErrorBody),
    ),
)]
pub async fn change(
    State(api): Api,
    Segment(name): Segment,
    changes: Changes<v1::ObjectSetup>,
) -> Answer<v1::ObjectChange> {
    changes.check(&[v1::ObjectSetup::KEYS, &["roundels"]].concat())?;
    let manager = manager_if_allowed(&api)?;
    let change = move || {
        let fields = changes.fields.iter().map(String::as_str);
        let keys: Vec<&str> =
            fields.map(|field| if field == "roundels" { "roundel" } else { field }).collect();
        manager.change_object(&name, &changes.values, &keys)
    };
    let (name, kept) = blocking(change).await?;
    change_of(&api, name, kept).await
}

/// Removes an object from the running system and the configuration file.
///
/// If it has a code, its track continues without a name.
#[utoipa::path(
    delete, path = "/api/v1/configuration/objects/{name}", tag = "configuration",
    params(("name" = String, Path, description = "its configured name")),
    responses(
        (status = 200, description = "the object was removed", body = v1::ObjectChange),
        (status = 400, description = "a camera is mounted on it", body = ErrorBody),
        (status = 404, description = "no such object", body = ErrorBody),
        (status = 409, description = "the configuration cannot be written, or clients must not change the configuration", body = ErrorBody),
    ),
)]
pub async fn remove(State(api): Api, Segment(name): Segment) -> Answer<v1::ObjectChange> {
    let (manager, object) = (manager_if_allowed(&api)?, api.hub.object_by_name(&name));
    let kept = blocking(move || manager.remove_object(&name)).await?;
    let object_id = object.map_or(0, |object| object.0);
    Ok(Json(v1::ObjectChange { object: None, kept, object_id }))
}

/// A new name for an object.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Name {
    /// Unique among the objects.
    pub name: String,
}

impl Example for Name {
    const EXAMPLE: &str = r#"{"name": "cart"}"#;
}

/// Names an observed object and writes the name into the configuration file.
///
/// A configured object is renamed. Any other object is configured with its code, or with its kind of roundel if it is the
/// only one of that kind.
#[utoipa::path(
    put, path = "/api/v1/objects/{id}/name", tag = "configuration",
    params(("id" = u64, Path, description = "object_id")),
    request_body = Name,
    responses(
        (status = 200, description = "the object was named; its track continues", body = v1::ObjectChange),
        (status = 400, description = "the name is taken or empty", body = ErrorBody),
        (status = 404, description = "no such object now or within the last minute", body = ErrorBody),
        (status = 409, description = "the object cannot be distinguished from others, the configuration cannot be written, or clients must not change the configuration", body = ErrorBody),
    ),
)]
pub async fn name(
    State(api): Api,
    id: Segment,
    Body(Name { name }): Body<Name>,
) -> Answer<v1::ObjectChange> {
    let object_id = id.object_id()?;
    let (manager, fresh) = (manager_if_allowed(&api)?, name.clone());
    let kept = blocking(move || manager.name_object(ObjectId(object_id), &fresh)).await?;
    let Json(change) = change_of(&api, name, kept).await?;
    Ok(Json(v1::ObjectChange { object_id, ..change }))
}

async fn configured(api: &ApiState, name: String) -> Result<v1::ObjectSetup, ApiError> {
    let manager = manager_if_allowed(api)?;
    blocking(move || manager.object_setup(&name)).await
}

async fn change_of(api: &ApiState, name: String, kept: String) -> Answer<v1::ObjectChange> {
    let object_id = api.hub.object_by_name(&name).map_or(0, |object| object.0);
    let object = Some(configured(api, name).await?);
    Ok(Json(v1::ObjectChange { object, kept, object_id }))
}
