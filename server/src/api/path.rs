//! Variable segments of request paths.

use axum::extract::{Path, rejection::PathRejection};

use super::error::ApiError;

/// A path segment as axum extracts it.
pub(super) type Segment = Result<Path<String>, PathRejection>;

pub(super) fn text_of(segment: Segment) -> Result<String, ApiError> {
    match segment {
        Ok(Path(text)) => Ok(text),
        Err(error) => Err(ApiError::invalid("path", "percent-encoded UTF-8", error)),
    }
}

pub(super) fn object_number(id: Segment) -> Result<u64, ApiError> {
    let id = text_of(id)?;
    let expected = "the number of an object (object_id)";
    id.parse().map_err(|_| ApiError::invalid("id", expected, format!("{id:?}")))
}
