//! Verification of the server's certificate: by certificate authorities or by a pinned fingerprint.

use std::{
    fmt, fs, io,
    path::{Path, PathBuf},
    sync::Arc,
};

use sha2::{Digest, Sha256};
use tokio_rustls::rustls::{
    self, AlertDescription, CertificateError, ClientConfig, DigitallySignedStruct, OtherError,
    RootCertStore, SignatureScheme,
    client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier},
    crypto::{WebPkiSupportedAlgorithms, ring, verify_tls12_signature, verify_tls13_signature},
    pki_types::{CertificateDer, PrivateKeyDer, ServerName, UnixTime, pem::PemObject},
};

use crate::{ConnectOptions, Error};

const HTTP2: &[u8] = b"h2";

/// Why no encrypted connection was made. In the chain of causes of tonic's errors.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum TlsFailure {
    #[error(
        "the certificate of the server has the SHA-256 fingerprint {found}, expected {expected}"
    )]
    Fingerprint { expected: String, found: String },
    #[error("{0}")]
    Untrusted(String),
    #[error("{0}; perhaps this server has no TLS: then the address begins with http://")]
    NoTls(String),
}

/// Converts the error of a handshake.
pub(crate) fn handshake_error(error: io::Error) -> Box<dyn std::error::Error + Send + Sync> {
    let cause = error.get_ref().and_then(|cause| cause.downcast_ref::<rustls::Error>());
    let failure = match cause {
        Some(rustls::Error::InvalidCertificate(CertificateError::Other(OtherError(other)))) => {
            let failure = other.downcast_ref::<TlsFailure>().cloned();
            failure.unwrap_or_else(|| TlsFailure::Untrusted(other.to_string()))
        }
        Some(rustls::Error::InvalidCertificate(invalid)) => {
            TlsFailure::Untrusted(invalid.to_string())
        }
        Some(
            rustls::Error::AlertReceived(AlertDescription::AccessDenied)
            | rustls::Error::InvalidMessage(_),
        ) => TlsFailure::NoTls(error.to_string()),
        _ => return error.into(),
    };
    failure.into()
}

/// Reads the files of the options.
pub(crate) fn client_config(options: &ConnectOptions) -> Result<Arc<ClientConfig>, Error> {
    let provider = Arc::new(ring::default_provider());
    let algorithms = provider.signature_verification_algorithms;
    let builder =
        ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions();
    let builder = builder.map_err(|error| invalid("ca", error))?;
    let builder = match (&options.fingerprint, &options.ca) {
        (Some(_), Some(_)) => return Err(invalid("fingerprint", "cannot be combined with `ca`")),
        (Some(fingerprint), None) => {
            let pinned = Pinned { fingerprint: parse(fingerprint)?, algorithms };
            builder.dangerous().with_custom_certificate_verifier(Arc::new(pinned))
        }
        (None, ca) => builder.with_root_certificates(roots(ca.as_deref())?),
    };
    let mut config = match &options.certificate {
        None => builder.with_no_client_auth(),
        Some([certificate, key]) => {
            let chain = certificates("certificate", certificate)?;
            let key = PrivateKeyDer::from_pem_slice(&read("certificate", key)?)
                .map_err(|error| invalid_file("certificate", key, error))?;
            let config = builder.with_client_auth_cert(chain, key);
            config.map_err(|error| invalid_file("certificate", certificate, error))?
        }
    };
    config.alpn_protocols = vec![HTTP2.to_vec()];
    Ok(Arc::new(config))
}

fn invalid(option: &'static str, reason: impl fmt::Display) -> Error {
    Error::InvalidOption { option, reason: reason.to_string() }
}

fn invalid_file(option: &'static str, path: &Path, error: impl fmt::Display) -> Error {
    invalid(option, format_args!("{}: {error}", path.display()))
}

fn read(option: &'static str, path: &PathBuf) -> Result<Vec<u8>, Error> {
    fs::read(path).map_err(|error| invalid_file(option, path, error))
}

/// The certificates of a PEM file; at least one.
fn certificates(
    option: &'static str,
    path: &PathBuf,
) -> Result<Vec<CertificateDer<'static>>, Error> {
    let text = read(option, path)?;
    let parsed: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&text).collect();
    let parsed = parsed.map_err(|error| invalid_file(option, path, error))?;
    if parsed.is_empty() {
        return Err(invalid_file(option, path, "expected a certificate in PEM, found none"));
    }
    Ok(parsed)
}

/// The authorities of a file, or those of the system.
fn roots(ca: Option<&Path>) -> Result<RootCertStore, Error> {
    let mut roots = RootCertStore::empty();
    match ca {
        Some(path) => {
            for authority in certificates("ca", &path.to_owned())? {
                roots.add(authority).map_err(|error| invalid_file("ca", path, error))?;
            }
        }
        None => {
            let system = rustls_native_certs::load_native_certs();
            roots.add_parsable_certificates(system.certs);
            if roots.is_empty() {
                let reason =
                    "this system has no certificate authorities: give a file, or a `fingerprint`";
                return Err(invalid("ca", reason));
            }
        }
    }
    Ok(roots)
}

/// 64 hexadecimal digits, with colons as `openssl x509 -fingerprint` prints them or without.
fn parse(fingerprint: &str) -> Result<[u8; 32], Error> {
    let digits: String = fingerprint.trim().chars().filter(|&letter| letter != ':').collect();
    let byte = |index: usize| u8::from_str_radix(digits.get(2 * index..2 * index + 2)?, 16).ok();
    let bytes: Option<Vec<u8>> = (0..32).map(byte).collect();
    let is_hexadecimal = digits.len() == 64 && digits.bytes().all(|it| it.is_ascii_hexdigit());
    let bytes = bytes.filter(|_| is_hexadecimal).and_then(|bytes| bytes.try_into().ok());
    let expected = "expected the 64 hexadecimal digits of a SHA-256 fingerprint";
    bytes.ok_or_else(|| invalid("fingerprint", format_args!("{expected}, found {fingerprint:?}")))
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[derive(Debug)]
struct Pinned {
    fingerprint: [u8; 32],
    algorithms: WebPkiSupportedAlgorithms,
}

impl ServerCertVerifier for Pinned {
    fn verify_server_cert(
        &self,
        certificate: &CertificateDer<'_>,
        _issuers: &[CertificateDer<'_>],
        _name: &ServerName<'_>,
        _ocsp_response: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, rustls::Error> {
        let found = Sha256::digest(certificate);
        if found.as_slice() == self.fingerprint {
            return Ok(ServerCertVerified::assertion());
        }
        let failure = TlsFailure::Fingerprint {
            expected: hexadecimal(&self.fingerprint),
            found: hexadecimal(&found),
        };
        Err(CertificateError::Other(OtherError(Arc::new(failure))).into())
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        verify_tls12_signature(message, certificate, signature, &self.algorithms)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        verify_tls13_signature(message, certificate, signature, &self.algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.algorithms.supported_schemes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fingerprints_have_32_bytes_with_or_without_colons() {
        let plain = "00ff".repeat(16);
        let colons = ["00:FF"; 16].join(":");
        let expected = [0, 0xff].repeat(16);
        for text in [plain.as_str(), &colons, &format!(" {plain}\n")] {
            assert_eq!(parse(text).unwrap().as_slice(), expected);
        }
        for wrong in ["", "00ff", &"0".repeat(63), &"0g".repeat(32), &"é".repeat(32)] {
            let error = parse(wrong).unwrap_err().to_string();
            assert!(error.contains("64 hexadecimal digits"), "{error}");
        }
    }

    #[test]
    fn options_that_exclude_each_other_and_unreadable_files_are_named() {
        let pinned = ConnectOptions::default().fingerprint("00".repeat(32));
        client_config(&pinned).unwrap();
        for (options, text) in [
            (pinned.clone().ca("ca.pem"), "cannot be combined with `ca`"),
            (ConnectOptions::default().ca("/no/ca.pem"), "`ca`: /no/ca.pem: No such file"),
            (pinned.certificate("/no/c.pem", "/no/k.pem"), "`certificate`: /no/c.pem"),
        ] {
            let error = client_config(&options).unwrap_err().to_string();
            assert!(error.contains(text), "{error}");
        }
    }
}
