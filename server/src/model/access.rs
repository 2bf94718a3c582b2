//! Who may do what on a server: roles, identities, and the entries of `[[access]]`.

use std::{fmt, net::IpAddr, str::FromStr};

use base64::{Engine as _, engine::general_purpose::URL_SAFE_NO_PAD};
use data_encoding::{HEXLOWER, HEXLOWER_PERMISSIVE};
use sha2::{Digest, Sha256};

/// What an identity may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Read poses, cameras, pictures, events, history and metrics.
    View,
    /// Push frames and detections of named cameras; nothing else.
    Feed,
    /// View, and record, replay, calibrate and drive simulated robots.
    Operate,
    /// Everything: also cameras, objects and the configuration.
    Setup,
}

/// Roles by their words in the configuration.
pub const ROLES: [(&str, Role); 4] = [
    ("view", Role::View),
    ("feed", Role::Feed),
    ("operate", Role::Operate),
    ("setup", Role::Setup),
];

impl Role {
    pub fn word(self) -> &'static str {
        ROLES.iter().find(|(_, role)| *role == self).map_or("", |(word, _)| word)
    }

    /// Whether the role permits a request that needs `needed`.
    pub fn permits(self, needed: Role) -> bool {
        match self {
            Self::Setup => true,
            Self::Operate => matches!(needed, Self::Operate | Self::View),
            Self::View | Self::Feed => self == needed,
        }
    }
}

/// Who sends a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    pub name: String,
    pub role: Role,
    /// Cameras that this identity may feed. `None`: all.
    pub cameras: Option<Vec<String>>,
}

impl Identity {
    /// Whether an identity that may feed cameras may feed this one.
    pub fn may_feed(&self, camera: &str) -> bool {
        self.cameras.as_ref().is_none_or(|names| names.iter().any(|name| name == camera))
    }
}

/// SHA-256 of a token, in the configuration as `sha256:` and 64 hexadecimal digits. Tokens have 256 random bits, so that
/// their hash needs no salt.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TokenHash([u8; 32]);

impl TokenHash {
    const PREFIX: &str = "sha256:";

    pub fn of(token: &str) -> Self {
        Self(Sha256::digest(token).into())
    }
}

impl fmt::Display for TokenHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", Self::PREFIX, HEXLOWER.encode(&self.0))
    }
}

impl FromStr for TokenHash {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        let digits = text.strip_prefix(Self::PREFIX).ok_or(())?;
        let bytes = HEXLOWER_PERMISSIVE.decode(digits.as_bytes()).map_err(drop)?;
        bytes.try_into().map(Self).map_err(drop)
    }
}

/// A random token of 256 bits.
pub fn new_token() -> String {
    let mut bytes = [0; 32];
    getrandom::fill(&mut bytes).expect("the system has random bytes");
    format!("{TOKEN_PREFIX}{}", URL_SAFE_NO_PAD.encode(bytes))
}

/// Begins each token, so that scanners of repositories and logs recognize them.
const TOKEN_PREFIX: &str = "roundel_";

/// `[[access]]`: an identity and what proves it, at least one of the options.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AccessEntry {
    pub identity: Identity,
    pub token: Option<TokenHash>,
    /// Argon2 hash of a password, in PHC format.
    pub password: Option<String>,
    /// Common name of a client certificate.
    pub certificate: Option<String>,
    /// User name that a proxy of `trusted_proxies` forwards.
    pub forwarded: Option<String>,
    /// Unix time in seconds from which the entry is refused.
    pub expires_s: Option<i64>,
}

/// Who may reach a server, and under which names.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AccessConfig {
    /// `[[access]]`, names unique. Empty: clients need no credentials.
    pub entries: Vec<AccessEntry>,
    /// Further names of this server in the `Host` header.
    pub allow_hosts: Vec<String>,
    /// Proxies whose `X-Forwarded-User` header is believed.
    pub trusted_proxies: Vec<IpAddr>,
    /// Whether other computers may connect without TLS and without `[[access]]`.
    pub insecure: bool,
}
