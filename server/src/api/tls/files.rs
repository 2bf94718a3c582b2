//! Reads the PEM files of `[server] tls`.

use std::{
    fmt::{self, Write as _},
    fs, io,
    path::{Path, PathBuf},
    sync::Arc,
    time::SystemTime,
};

use sha2::{Digest, Sha256};
use thiserror::Error;
use tokio_rustls::rustls::{
    ConfigBuilder, Error as RustlsError, RootCertStore, ServerConfig, WantsVerifier,
    crypto::ring,
    pki_types::{CertificateDer, PrivateKeyDer, pem, pem::PemObject},
    server::{WebPkiClientVerifier, danger::ClientCertVerifier},
    version::{TLS12, TLS13},
};
use x509_parser::{certificate::X509Certificate, prelude::FromDer, time::ASN1Time};

use crate::model::{config::TlsConfig, regular_file};

/// A longer file is not a certificate chain.
const MAX_BYTES: u64 = 1 << 20;
/// In order of preference.
const ALPN_PROTOCOLS: [&[u8]; 2] = [b"h2", b"http/1.1"];
/// Remaining validity below which a warning is logged.
const EXPIRY_WARNING_DAYS: i64 = 14;

#[derive(Debug, Error)]
pub enum TlsError {
    #[error("[server] tls: cannot read {}: {source}; {}", path.display(), remedy(source))]
    Read { path: PathBuf, source: io::Error },
    #[error("[server] tls: expected {expected} in {}, found {found}", path.display())]
    Content { path: PathBuf, expected: &'static str, found: String },
    #[error(
        "[server] tls: the key {} does not belong to the certificate {}: name the two files of one pair",
        key.display(),
        certificate.display()
    )]
    Mismatch { certificate: PathBuf, key: PathBuf },
    #[error("[server] tls: {} cannot be used: {reason}", path.display())]
    Unusable { path: PathBuf, reason: String },
    #[error(
        "[server] tls: {} exists and {} does not: restore the missing file, or delete the other one to have both made",
        found.display(),
        missing.display()
    )]
    Half { found: PathBuf, missing: PathBuf },
    #[error("[server] tls: cannot write the self-signed certificate to {}: {reason}", path.display())]
    Write { path: PathBuf, reason: String },
}

fn remedy(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::NotFound => {
            "correct the path, which begins in the configuration's folder, or add `self_signed = true` to have certificate \
             and key made"
        }
        io::ErrorKind::PermissionDenied => "let the server's user read it",
        io::ErrorKind::InvalidData => {
            "expected a PEM text file, which begins with -----BEGIN; convert DER with `openssl x509 -inform der`"
        }
        _ => "expected a PEM text file",
    }
}

/// A server certificate, as shown to users.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CertificateSummary {
    /// SHA-256 of the certificate in DER, in hexadecimal digits. Clients may pin it.
    pub fingerprint: String,
    /// Last day of its validity, in UTC.
    pub expires: String,
}

impl fmt::Display for CertificateSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SHA-256 fingerprint {}, expires {}", self.fingerprint, self.expires)
    }
}

/// The files in use.
#[derive(Clone)]
pub(super) struct Loaded {
    pub(super) server: Arc<ServerConfig>,
    pub(super) certificate: Option<CertificateSummary>,
}

/// Reads and checks the files. An expired certificate is only a warning: clients decide whether they accept it.
pub(super) fn load(files: &TlsConfig) -> Result<Loaded, TlsError> {
    let chain = certificates(&files.certificate)?;
    let key = private_key(&files.key)?;
    let certificate = Some(summary(&files.certificate, &chain[0])?);
    let builder = server_config_builder();
    let builder = match &files.client_ca {
        None => builder.with_no_client_auth(),
        Some(path) => builder.with_client_cert_verifier(client_verifier(path)?),
    };
    let mut server = builder.with_single_cert(chain, key).map_err(|error| match error {
        RustlsError::InconsistentKeys(_) => {
            TlsError::Mismatch { certificate: files.certificate.clone(), key: files.key.clone() }
        }
        RustlsError::InvalidCertificate(_) => unusable(&files.certificate, &error),
        _ => unusable(&files.key, &error),
    })?;
    server.ignore_client_order = true;
    server.alpn_protocols = ALPN_PROTOCOLS.map(<[u8]>::to_vec).into();
    Ok(Loaded { server: Arc::new(server), certificate })
}

/// A builder with rustls' default cipher suites on ring.
pub(super) fn server_config_builder() -> ConfigBuilder<ServerConfig, WantsVerifier> {
    let provider = Arc::new(ring::default_provider());
    let builder = ServerConfig::builder_with_provider(provider);
    builder.with_protocol_versions(&[&TLS13, &TLS12]).expect("ring supports TLS 1.2 and 1.3")
}

fn unusable(path: &Path, error: &dyn fmt::Display) -> TlsError {
    TlsError::Unusable { path: path.to_owned(), reason: error.to_string() }
}

fn read(path: &Path) -> Result<String, TlsError> {
    regular_file::read_text(path, MAX_BYTES)
        .map_err(|source| TlsError::Read { path: path.to_owned(), source })
}

/// The certificates of a file; at least one.
fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    let text = read(path)?;
    let parsed: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(text.as_bytes()).collect();
    let expected = "a certificate in PEM (-----BEGIN CERTIFICATE-----)";
    match parsed {
        Ok(parsed) if !parsed.is_empty() => Ok(parsed),
        Ok(_) => Err(content(path, expected, &text)),
        Err(error) => Err(unusable(path, &error)),
    }
}

fn private_key(path: &Path) -> Result<PrivateKeyDer<'static>, TlsError> {
    let text = read(path)?;
    PrivateKeyDer::from_pem_slice(text.as_bytes()).map_err(|error| match error {
        pem::Error::NoItemsFound => {
            content(path, "an unencrypted private key in PEM (-----BEGIN PRIVATE KEY-----)", &text)
        }
        error => unusable(path, &error),
    })
}

/// What a file contains instead; never a part of a key.
fn content(path: &Path, expected: &'static str, text: &str) -> TlsError {
    let labels = text.lines().filter_map(|line| line.trim().strip_prefix("-----BEGIN "));
    let labels: Vec<String> =
        labels.map(|label| label.trim_end_matches('-').chars().take(40).collect()).collect();
    let found = match labels.as_slice() {
        [] if text.trim().is_empty() => "an empty file".to_owned(),
        [] => "no PEM block".to_owned(),
        labels => labels.join(", "),
    };
    TlsError::Content { path: path.to_owned(), expected, found }
}

fn client_verifier(path: &Path) -> Result<Arc<dyn ClientCertVerifier>, TlsError> {
    let mut roots = RootCertStore::empty();
    for authority in certificates(path)? {
        roots.add(authority).map_err(|error| unusable(path, &error))?;
    }
    let provider = Arc::new(ring::default_provider());
    let builder = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider);
    builder.allow_unauthenticated().build().map_err(|error| unusable(path, &error))
}

fn summary(path: &Path, der: &CertificateDer<'_>) -> Result<CertificateSummary, TlsError> {
    let (_, parsed) = X509Certificate::from_der(der).map_err(|error| unusable(path, &error))?;
    let (validity, now) = (parsed.validity(), ASN1Time::now());
    let left_days = (validity.not_after.timestamp() - now.timestamp()).div_euclid(86_400);
    let expires = validity.not_after.to_datetime().date().to_string();
    let file = path.display();
    if validity.not_before > now {
        let begins = validity.not_before.to_datetime().date();
        tracing::warn!(%file, %begins, "the TLS certificate is not valid yet: clients will reject it");
    } else if left_days < 0 {
        tracing::warn!(%file, expires, "the TLS certificate has expired: clients will reject it");
    } else if left_days < EXPIRY_WARNING_DAYS {
        tracing::warn!(%file, expires, "the TLS certificate expires soon: renew it");
    }
    Ok(CertificateSummary { fingerprint: fingerprint(der), expires })
}

fn fingerprint(der: &[u8]) -> String {
    Sha256::digest(der).iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}

/// The common name of a certificate; `None` unless it has exactly one.
pub(super) fn common_name(der: &[u8]) -> Option<String> {
    let (_, parsed) = X509Certificate::from_der(der).ok()?;
    let mut names = parsed.subject().iter_common_name();
    let name = names.next()?.as_str().ok()?;
    (names.next().is_none() && !name.trim().is_empty()).then(|| name.to_owned())
}

/// Modification times and sizes, which differ after a file was changed.
pub(super) fn stamps(files: &TlsConfig) -> Vec<Option<(SystemTime, u64)>> {
    let stamp = |path: &PathBuf| {
        let metadata = fs::metadata(path).ok()?;
        Some((metadata.modified().ok()?, metadata.len()))
    };
    let all = [Some(&files.certificate), Some(&files.key), files.client_ca.as_ref()];
    all.into_iter().flatten().map(stamp).collect()
}
