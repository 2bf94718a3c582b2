//! Credentials in the headers of a request, and on its connection.

use std::{
    collections::HashMap,
    net::IpAddr,
    sync::Arc,
    time::{SystemTime, UNIX_EPOCH},
};

use argon2::{Argon2, PasswordHash, PasswordVerifier};
use axum::http::{HeaderMap, header::AUTHORIZATION};

use super::{expiry::Expiry, header};
use crate::{
    api::{error::ApiError, peer::Peer},
    model::access::{AccessConfig, Identity, TokenHash},
};

/// Header with the name of the user whom a proxy has authenticated.
const FORWARDED_USER: &str = "x-forwarded-user";
/// Verified in place of the hash of an unknown name, so that both take the same time.
const UNKNOWN_NAME: &str = "$argon2id$v=19$m=19456,t=2,p=1$c29tZSBvdGhlciBzYWx0$rsmc3kEaEPyYy0wjzqVnWqaDQwnqNFMYZSZPGmWMuU0";

/// An identity until the entry expires.
pub(super) struct Entry {
    pub(super) identity: Arc<Identity>,
    expires_s: Option<i64>,
}

/// Identity of a request, until its credentials expire.
pub(super) type Valid = (Arc<Identity>, Expiry);

impl Entry {
    pub(super) fn valid_identity(&self) -> Result<Valid, ApiError> {
        match self.expires_s {
            Some(expires_s) if now_s() >= expires_s => {
                let name = &self.identity.name;
                Err(ApiError::Unauthenticated(format!(
                    "the credentials of \"{name}\" have expired"
                )))
            }
            Some(expires_s) => Ok((self.identity.clone(), Expiry::at_unix(expires_s))),
            None => Ok((self.identity.clone(), Expiry::default())),
        }
    }
}

fn now_s() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs() as i64)
}

/// The entries of `[[access]]`, by what proves them.
pub(super) struct Credentials {
    by_token: HashMap<TokenHash, Arc<Entry>>,
    by_certificate: HashMap<String, Arc<Entry>>,
    by_forwarded: HashMap<String, Arc<Entry>>,
    /// Name, password hash, entry.
    by_password: HashMap<String, (String, Arc<Entry>)>,
    trusted_proxies: Vec<IpAddr>,
}

impl Credentials {
    pub(super) fn new(config: &AccessConfig) -> Self {
        let mut credentials = Self {
            by_token: HashMap::new(),
            by_certificate: HashMap::new(),
            by_forwarded: HashMap::new(),
            by_password: HashMap::new(),
            trusted_proxies: config.trusted_proxies.clone(),
        };
        for entry in &config.entries {
            let identity = Arc::new(entry.identity.clone());
            let proven = Arc::new(Entry { identity, expires_s: entry.expires_s });
            if let Some(hash) = entry.token {
                credentials.by_token.insert(hash, proven.clone());
            }
            if let Some(name) = &entry.certificate {
                credentials.by_certificate.insert(name.clone(), proven.clone());
            }
            if let Some(user) = &entry.forwarded {
                credentials.by_forwarded.insert(user.clone(), proven.clone());
            }
            if let Some(hash) = &entry.password {
                let name = entry.identity.name.clone();
                credentials.by_password.insert(name, (hash.clone(), proven));
            }
        }
        credentials
    }

    /// `None`: the request has none of these credentials.
    pub(super) fn identity(
        &self,
        headers: &HeaderMap,
        peer: Option<&Peer>,
    ) -> Result<Option<Valid>, ApiError> {
        if headers.contains_key(AUTHORIZATION) {
            return self.of_authorization(headers).map(Some);
        }
        let forwarded =
            peer.filter(|peer| self.trusted_proxies.contains(&peer.address.ip().to_canonical()));
        if let Some(user) = forwarded.and_then(|_| header(headers, FORWARDED_USER)) {
            let entry = self.by_forwarded.get(user).ok_or_else(|| {
                ApiError::Unauthenticated(format!(
                    "no entry of [[access]] has `forwarded = {user:?}`"
                ))
            })?;
            return entry.valid_identity().map(Some);
        }
        // A certificate that is valid, but of no entry, does not keep a person from signing in.
        let name = peer.and_then(|peer| peer.certificate_name.as_ref());
        let entry = name.and_then(|name| self.by_certificate.get(name));
        entry.map(|entry| entry.valid_identity()).transpose()
    }

    fn of_authorization(&self, headers: &HeaderMap) -> Result<Valid, ApiError> {
        let text = header(headers, AUTHORIZATION.as_str()).unwrap_or_default();
        let scheme = text.get(..7).filter(|scheme| scheme.eq_ignore_ascii_case("bearer "));
        let Some(token) = scheme.and_then(|_| text.get(7..)) else {
            let message = "expected `authorization: Bearer TOKEN`, found another scheme";
            return Err(ApiError::Unauthenticated(message.to_owned()));
        };
        self.check_token(token)?.valid_identity()
    }

    /// Takes tens of milliseconds.
    pub(super) fn check_password(
        &self,
        name: &str,
        password: &str,
    ) -> Result<Arc<Entry>, ApiError> {
        let known = self.by_password.get(name);
        let hash = known.map_or(UNKNOWN_NAME, |(hash, _)| hash);
        let is_right = PasswordHash::new(hash).is_ok_and(|hash| {
            Argon2::default().verify_password(password.as_bytes(), &hash).is_ok()
        });
        match known {
            Some((_, entry)) if is_right => Ok(entry.clone()),
            _ => Err(ApiError::Unauthenticated("name or password is wrong".to_owned())),
        }
    }

    pub(super) fn check_token(&self, token: &str) -> Result<Arc<Entry>, ApiError> {
        let entry = self.by_token.get(&TokenHash::of(token.trim()));
        let wrong = || {
            let message = "the token is not one of this server: `roundel token add` makes one";
            ApiError::Unauthenticated(message.to_owned())
        };
        entry.cloned().ok_or_else(wrong)
    }
}
