//! Sign-in of browsers. The session is a cookie that scripts cannot read and other sites cannot send with changes.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use axum::{
    Extension, Json,
    extract::State,
    http::{HeaderMap, HeaderValue, header},
    response::{AppendHeaders, IntoResponse, Response},
};
use serde::{Deserialize, Serialize};
use tokio::{sync::Semaphore, time::timeout};
use utoipa::ToSchema;

use super::{
    credentials::{Entry, Valid},
    expiry::Expiry,
};
use crate::{
    api::{
        error::{ApiError, ErrorBody},
        handler::{Answer, Api, Body, Example, blocking},
        peer::Peer,
    },
    model::access::{Identity, TokenHash, new_token},
};

const COOKIE: &str = "roundel_session";
const LIFETIME: Duration = Duration::from_secs(12 * 3600);
/// Further sign-ins end the oldest session.
const MAX_SESSIONS: usize = 1000;
/// Passwords are checked one after another, which also limits guessing. A sign-in that waits longer is refused.
const MAX_WAIT: Duration = Duration::from_secs(5);
const MAX_TEXT_LEN: usize = 1024;

struct Session {
    entry: Arc<Entry>,
    ends: Instant,
}

pub(super) struct Sessions {
    open: Mutex<HashMap<TokenHash, Session>>,
    checking: Semaphore,
}

impl Default for Sessions {
    fn default() -> Self {
        Self { open: Mutex::default(), checking: Semaphore::new(1) }
    }
}

impl Sessions {
    fn lock(&self) -> std::sync::MutexGuard<'_, HashMap<TokenHash, Session>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The signed-in identity. A session that has ended counts as none: the browser still sends its cookie.
    pub(super) fn identity(&self, headers: &HeaderMap) -> Option<Valid> {
        let token = cookie(headers)?;
        let open = self.lock();
        let session = open.get(&TokenHash::of(token))?;
        let is_open = Instant::now() < session.ends;
        let (identity, expiry) = session.entry.valid_identity().ok().filter(|_| is_open)?;
        Some((identity, expiry.earlier(Expiry::at(session.ends.into()))))
    }

    /// Returns the cookie's value.
    fn begin(&self, entry: Arc<Entry>) -> String {
        let (token, now) = (new_token(), Instant::now());
        let mut open = self.lock();
        open.retain(|_, session| now < session.ends);
        if open.len() >= MAX_SESSIONS {
            let oldest = open.iter().min_by_key(|(_, session)| session.ends);
            let oldest = oldest.map(|(hash, _)| *hash);
            oldest.and_then(|hash| open.remove(&hash));
        }
        open.insert(TokenHash::of(&token), Session { entry, ends: now + LIFETIME });
        token
    }

    fn end(&self, headers: &HeaderMap) {
        if let Some(token) = cookie(headers) {
            self.lock().remove(&TokenHash::of(token));
        }
    }
}

fn cookie(headers: &HeaderMap) -> Option<&str> {
    let cookies = headers.get_all(header::COOKIE).iter().filter_map(|value| value.to_str().ok());
    let pairs =
        cookies.flat_map(|text| text.split(';')).filter_map(|pair| pair.trim().split_once('='));
    pairs.into_iter().find(|(name, _)| *name == COOKIE).map(|(_, value)| value)
}

/// `Set-Cookie`. An empty value with an age of 0 removes the cookie.
fn set_cookie(value: &str, age: Duration, is_tls: bool) -> Result<HeaderValue, ApiError> {
    let secure = if is_tls { "; Secure" } else { "" };
    let age_s = age.as_secs();
    let text = format!("{COOKIE}={value}; Path=/; Max-Age={age_s}; HttpOnly; SameSite=Lax{secure}");
    HeaderValue::from_str(&text).map_err(|error| ApiError::Internal(error.to_string()))
}

/// Who is signed in.
#[derive(Debug, Serialize, ToSchema)]
pub struct SessionInfo {
    /// Whether this server needs credentials. If not, each client has `role`.
    pub needs_credentials: bool,
    /// Null without valid credentials.
    pub name: Option<String>,
    /// `view`, `feed`, `operate` or `setup`.
    pub role: Option<&'static str>,
}

/// Credentials: `name` and `password`, or a `token`.
#[derive(Default, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SignIn {
    pub name: String,
    pub password: String,
    pub token: String,
}

impl Example for SignIn {
    const EXAMPLE: &str = r#"{"name": "alice", "password": "…"} or {"token": "…"}"#;
}

/// Who sends this request, and with which role.
#[utoipa::path(
    get, path = "/api/v1/session", tag = "access",
    responses((status = 200, description = "the identity", body = SessionInfo)),
)]
pub async fn show(
    State(api): Api,
    identity: Option<Extension<Arc<Identity>>>,
) -> Answer<SessionInfo> {
    let identity = identity.as_ref().map(|Extension(identity)| &**identity);
    Ok(Json(info(!api.access.is_open(), identity)))
}

fn info(needs_credentials: bool, identity: Option<&Identity>) -> SessionInfo {
    SessionInfo {
        needs_credentials,
        name: identity.map(|identity| identity.name.clone()),
        role: identity.map(|identity| identity.role.word()),
    }
}

/// Signs a browser in for twelve hours, with a cookie.
///
/// Programs need no session: they send `authorization: Bearer TOKEN` with each request.
#[utoipa::path(
    post, path = "/api/v1/session", tag = "access",
    request_body = SignIn,
    responses(
        (status = 200, description = "signed in; sets the cookie", body = SessionInfo),
        (status = 401, description = "name, password or token is wrong, or has expired", body = ErrorBody),
        (status = 409, description = "this server needs no credentials", body = ErrorBody),
        (status = 503, description = "too many sign-ins at once", body = ErrorBody),
    ),
)]
pub async fn sign_in(
    State(api): Api,
    peer: Option<Extension<Peer>>,
    Body(SignIn { name, password, token }): Body<SignIn>,
) -> Result<Response, ApiError> {
    let access = api.access.clone();
    if access.is_open() {
        let message = "this server needs no credentials: its configuration has no [[access]]";
        return Err(ApiError::FailedPrecondition(message.to_owned()));
    }
    if [&name, &password, &token].iter().any(|text| text.len() > MAX_TEXT_LEN) {
        let expected = format!("texts of at most {MAX_TEXT_LEN} bytes");
        return Err(ApiError::invalid("body", expected, "a longer one"));
    }
    let entry = if token.is_empty() {
        let checking = timeout(MAX_WAIT, access.sessions.checking.acquire()).await;
        let Ok(Ok(_checking)) = checking else {
            let message = "too many sign-ins at once; try again in a few seconds";
            return Err(ApiError::ResourceExhausted(message.to_owned()));
        };
        let access = access.clone();
        blocking(move || access.credentials.check_password(&name, &password)).await?
    } else {
        access.credentials.check_token(&token)?
    };
    let (identity, _) = entry.valid_identity()?;
    tracing::info!(name = identity.name, "signed in");
    let is_tls = peer.is_some_and(|Extension(peer)| peer.is_tls);
    let cookie = set_cookie(&access.sessions.begin(entry), LIFETIME, is_tls)?;
    let body = Json(info(true, Some(&identity)));
    Ok((AppendHeaders([(header::SET_COOKIE, cookie)]), body).into_response())
}

/// Signs a browser out.
#[utoipa::path(
    delete, path = "/api/v1/session", tag = "access",
    responses((status = 200, description = "signed out", body = SessionInfo)),
)]
pub async fn sign_out(State(api): Api, headers: HeaderMap) -> Result<Response, ApiError> {
    api.access.sessions.end(&headers);
    let cookie = set_cookie("", Duration::ZERO, false)?;
    let body = Json(info(!api.access.is_open(), None));
    Ok((AppendHeaders([(header::SET_COOKIE, cookie)]), body).into_response())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cookie_is_found_among_others() {
        let mut headers = HeaderMap::new();
        assert_eq!(cookie(&headers), None);
        headers.append(header::COOKIE, HeaderValue::from_static("a=1; roundel_session2=x"));
        assert_eq!(cookie(&headers), None);
        headers.append(header::COOKIE, HeaderValue::from_static("b=2;roundel_session=abc; c=3"));
        assert_eq!(cookie(&headers), Some("abc"));
    }
}
