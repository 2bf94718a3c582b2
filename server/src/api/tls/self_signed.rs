//! Makes a self-signed certificate. Clients trust it by its fingerprint, or by the certificate's file as their CA.

use std::{
    fs::{File, OpenOptions},
    io::{self, Write as _},
    net::IpAddr,
    path::Path,
    time::Duration,
};

use rcgen::{
    CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, KeyPair, KeyUsagePurpose,
};
use x509_parser::time::ASN1Time;

use super::files::TlsError;
use crate::model::config::TlsConfig;

const DAY: Duration = Duration::from_secs(86_400);
/// Clients that pin a certificate must be changed when it is replaced.
const VALIDITY: Duration = Duration::from_secs(10 * 365 * 86_400);

/// Makes certificate and key if neither file exists.
pub(super) fn create_missing(files: &TlsConfig, listen: IpAddr) -> Result<(), TlsError> {
    let TlsConfig { certificate, key, .. } = files;
    match (certificate.exists(), key.exists()) {
        (true, true) => return Ok(()),
        (false, false) => {}
        (true, false) => {
            return Err(TlsError::Half { found: certificate.clone(), missing: key.clone() });
        }
        (false, true) => {
            return Err(TlsError::Half { found: key.clone(), missing: certificate.clone() });
        }
    }
    let failed = |path: &Path, reason: String| TlsError::Write { path: path.to_owned(), reason };
    let made = make(&host_name(), listen);
    let (made, made_key) = made.map_err(|error| failed(certificate, error.to_string()))?;
    write(key, &made_key, 0o600).map_err(|error| failed(key, error.to_string()))?;
    write(certificate, &made, 0o644).map_err(|error| failed(certificate, error.to_string()))?;
    tracing::info!(certificate = %certificate.display(), "made a self-signed TLS certificate");
    Ok(())
}

/// Certificate and key in PEM.
fn make(host: &str, listen: IpAddr) -> Result<(String, String), rcgen::Error> {
    let mut names = vec!["localhost".to_owned(), "127.0.0.1".to_owned(), "::1".to_owned()];
    let listen = Some(listen).filter(|it| !it.is_unspecified()).map(|it| it.to_string());
    for name in [Some(host.to_owned()).filter(|it| !it.is_empty()), listen].into_iter().flatten() {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let mut params = CertificateParams::new(names)?;
    let now = ASN1Time::now().to_datetime();
    // The clock of a robot may be behind.
    (params.not_before, params.not_after) = (now - DAY, now + VALIDITY);
    params.distinguished_name = DistinguishedName::new();
    let subject = if host.is_empty() { "roundel" } else { host };
    params.distinguished_name.push(DnType::CommonName, subject);
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
    let key = KeyPair::generate()?;
    Ok((params.self_signed(&key)?.pem(), key.serialize_pem()))
}

/// Empty if the system does not report it.
fn host_name() -> String {
    gethostname::gethostname().to_string_lossy().into_owned()
}

/// Writes a new file with these permissions; an existing one is an error.
fn write(path: &Path, text: &str, mode: u32) -> io::Result<()> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, mode);
    let mut file = options.open(path)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()?;
    // Syncs the name too, where the system can.
    if let Some(folder) = path.parent().and_then(|folder| File::open(folder).ok()) {
        let _ = folder.sync_all();
    }
    Ok(())
}
