//! Who may do what: one check in front of every route and gRPC method.
//!
//! Where TLS is configured, other computers must use it. Each request passes three steps before it is routed; a request that fails one is answered in its own protocol.
//!
//! 1. [`names`]: the `Host` must be a name of this server (421 otherwise) and a page's `Origin` one that is allowed (403),
//!    so that a web page cannot use the server of the person who looks at it, also not by DNS rebinding.
//! 2. [`credentials`]: who sends the request. A bearer token, the session of a browser, a client certificate, or a user
//!    name that a trusted proxy forwards. Wrong or expired ones are 401 (UNAUTHENTICATED), even if the path
//!    needs none; a session that has ended counts as no credentials.
//! 3. [`roles`]: what the path needs. Too little is 403 (PERMISSION_DENIED); without credentials it is 401.
//!
//! Streams end when the credentials that opened them expire ([`expiry`]).
//!
//! Without `[[access]]`, clients need no credentials: on loopback they may do everything, else only view and feed, unless
//! `[server] setup` says otherwise.

mod credentials;
pub(super) mod expiry;
mod names;
mod roles;
pub mod session;

use std::{
    net::{IpAddr, SocketAddr},
    sync::Arc,
};

use axum::http::{HeaderMap, Method, Request};

use self::{
    credentials::{Credentials, Valid},
    expiry::Expiry,
    names::HostNames,
    session::Sessions,
};
use super::{AllowedOrigins, error::ApiError, peer::Peer};
use crate::model::access::{AccessConfig, Identity, Role};

pub use self::roles::{Need, need};

/// Name of the identity of clients without credentials, where none are needed.
const ANONYMOUS: &str = "anonymous";

/// The rules of one server.
pub struct AccessControl {
    hosts: HostNames,
    origins: AllowedOrigins,
    credentials: Credentials,
    /// Identity of each client, where no credentials are configured.
    anonymous: Option<Arc<Identity>>,
    /// Other computers must use TLS.
    tls_only: bool,
    trusted_proxies: Vec<IpAddr>,
    sessions: Sessions,
}

impl Default for AccessControl {
    /// On loopback, without credentials.
    fn default() -> Self {
        let listen = SocketAddr::from(([127, 0, 0, 1], 0));
        Self::new(&AccessConfig::default(), AllowedOrigins::default(), listen, true)
    }
}

impl AccessControl {
    /// `setup`: whether clients may change the configuration where no credentials are configured.
    pub fn new(
        config: &AccessConfig,
        origins: AllowedOrigins,
        listen: SocketAddr,
        setup: bool,
    ) -> Self {
        let role = if setup || listen.ip().is_loopback() { Role::Setup } else { Role::View };
        let anonymous = Identity { name: ANONYMOUS.to_owned(), role, cameras: None };
        Self {
            hosts: HostNames::new(listen.ip(), config.allow_hosts.clone()),
            origins,
            credentials: Credentials::new(config),
            anonymous: config.entries.is_empty().then(|| Arc::new(anonymous)),
            tls_only: false,
            trusted_proxies: config.trusted_proxies.clone(),
            sessions: Sessions::default(),
        }
    }

    /// Refuses requests of other computers, except trusted proxies, that are not encrypted.
    pub fn with_tls_only(mut self) -> Self {
        self.tls_only = true;
        self
    }

    pub fn origins(&self) -> &AllowedOrigins {
        &self.origins
    }

    /// Checks the names of the server and the page in a request.
    pub(super) fn check_names<B>(&self, request: &Request<B>) -> Result<(), ApiError> {
        let peer = request.extensions().get::<Peer>();
        if self.tls_only && peer.is_some_and(|peer| !self.may_be_plain(peer)) {
            return Err(ApiError::TlsRequired);
        }
        let host = names::host(request);
        host.map_or(Ok(()), |host| self.hosts.check(host))?;
        self.origins.check(request.headers(), host)
    }

    fn may_be_plain(&self, Peer { address, is_tls, .. }: &Peer) -> bool {
        let address = address.ip().to_canonical();
        *is_tls || address.is_loopback() || self.trusted_proxies.contains(&address)
    }

    /// Checks who sends a request and what it needs. The identity becomes an extension of the request.
    pub(super) fn check_identity<B>(&self, request: &mut Request<B>) -> Result<(), ApiError> {
        let valid = self.identity(request)?;
        if let Some((identity, expiry)) = &valid {
            request.extensions_mut().insert(identity.clone());
            request.extensions_mut().insert(*expiry);
        }
        let need = need(request.method(), request.uri().path());
        permit(need, valid.as_ref().map(|(identity, _)| &**identity), self.is_open())
    }

    /// `None`: the request has no credentials.
    fn identity<B>(&self, request: &Request<B>) -> Result<Option<Valid>, ApiError> {
        if let Some(anonymous) = &self.anonymous {
            return Ok(Some((anonymous.clone(), Expiry::default())));
        }
        let peer = request.extensions().get::<Peer>();
        if let Some(valid) = self.credentials.identity(request.headers(), peer)? {
            return Ok(Some(valid));
        }
        Ok(self.sessions.identity(request.headers()))
    }

    fn is_open(&self) -> bool {
        self.anonymous.is_some()
    }
}

/// Checks a need. `is_open`: no credentials are configured.
fn permit(need: Need, identity: Option<&Identity>, is_open: bool) -> Result<(), ApiError> {
    let (needed, Identity { name, role, .. }) = match (need, identity) {
        (Need::Nothing, _) | (Need::SignedIn, Some(_)) => return Ok(()),
        (_, None) => return Err(ApiError::Unauthenticated(missing())),
        (Need::Role(needed), Some(identity)) => (needed, identity),
    };
    // Nodes without credentials feed a server without credentials.
    if role.permits(needed) || is_open && needed == Role::Feed {
        return Ok(());
    }
    let (needed, role) = (needed.word(), role.word());
    Err(ApiError::PermissionDenied(match is_open {
        true => format!(
            "this request needs the role \"{needed}\", and clients without credentials have \"{role}\" because other \
             computers reach this server: add [[access]] entries to its configuration, or `setup = true` under [server]"
        ),
        false => format!("this request needs the role \"{needed}\", and \"{name}\" has \"{role}\""),
    }))
}

fn missing() -> String {
    "this server needs credentials: send `authorization: Bearer TOKEN`, or sign in on the dashboard"
        .to_owned()
}

fn header<'a>(headers: &'a HeaderMap, name: &str) -> Option<&'a str> {
    headers.get(name).and_then(|value| value.to_str().ok())
}

/// HEAD is answered like GET.
fn answered_method(method: &Method) -> &Method {
    if method == Method::HEAD { &Method::GET } else { method }
}
