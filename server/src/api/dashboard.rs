//! The dashboard and the API's page (`/api`): the files of `client/dashboard`, embedded in the binary. A debug build reads
//! them from the disk at each request, so that pages can be edited while the server runs.

use axum::{
    extract::State,
    http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, Uri, header},
    response::{IntoResponse, Response},
};
use rust_embed::{EmbeddedFile, RustEmbed};

use super::{error::ApiError, handler::Api};

#[derive(RustEmbed)]
#[folder = "../client/dashboard"]
#[allow_missing = true]
struct Files;

/// Keeps other pages from using responses, also as pictures.
const CROSS_ORIGIN_RESOURCE_POLICY: HeaderName =
    HeaderName::from_static("cross-origin-resource-policy");

/// Allows only the page's own files and requests to this server, including WebSockets; `blob:` allows fetched pictures. The
/// page must not be framed.
const CONTENT_SECURITY_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; \
    img-src 'self' blob:; connect-src 'self'; worker-src 'self'; form-action 'self'; \
    frame-ancestors 'none'; base-uri 'none'";

/// A file of the dashboard, or an error as JSON.
pub async fn file(method: Method, uri: Uri, headers: HeaderMap) -> Result<Response, ApiError> {
    let path = uri.path();
    let name = match path.trim_start_matches('/') {
        "" => "index.html",
        "api" => "api.html",
        name => name,
    };
    let file = Files::get(name).ok_or_else(|| {
        let known = match path {
            "/" => "this build has no dashboard: client/dashboard/index.html was missing when it was built",
            _ => "the dashboard is at /, the APIs under /api/v1 are described at /api and /openapi.json",
        };
        ApiError::NotFound { what: "path", name: path.to_owned(), known: known.to_owned() }
    })?;
    if method != Method::GET && method != Method::HEAD {
        return Err(ApiError::MethodNotAllowed);
    }
    Ok(file_response(&file, &headers))
}

fn file_response(file: &EmbeddedFile, headers: &HeaderMap) -> Response {
    let hash = file.metadata.sha256_hash();
    let tag: String = hash.iter().take(16).map(|byte| format!("{byte:02x}")).collect();
    let tag = format!("\"{tag}\"");
    let known = headers.get_all(header::IF_NONE_MATCH);
    let is_known = known.iter().filter_map(|value| value.to_str().ok()).any(|value| {
        value == "*" || value.split(',').any(|one| one.trim().trim_start_matches("W/") == tag)
    });
    let status = if is_known { StatusCode::NOT_MODIFIED } else { StatusCode::OK };
    let body = if is_known { Vec::new() } else { file.data.to_vec() };
    let mut mime = file.metadata.mimetype().to_owned();
    if mime.starts_with("text/") {
        mime.push_str("; charset=utf-8");
    }
    // Contents change with the version under the same names, so browsers must revalidate.
    let headers = [
        (header::CONTENT_TYPE, mime),
        (header::CACHE_CONTROL, "no-cache".into()),
        (header::ETAG, tag),
    ];
    (status, headers, body).into_response()
}

/// Restricts what browsers do with a response.
pub async fn with_security_headers(State(api): Api, mut response: Response) -> Response {
    const HEADERS: [(HeaderName, &str); 3] = [
        (header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
    ];
    for (name, value) in HEADERS {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    // Requests for pictures and scripts have no `Origin` that could be checked.
    if api.access.origins().is_empty() {
        let same_origin = HeaderValue::from_static("same-origin");
        response.headers_mut().insert(CROSS_ORIGIN_RESOURCE_POLICY, same_origin);
    }
    response
}
