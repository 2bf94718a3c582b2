//! Certificate files at start: self-signed ones, and errors.

use std::{fs, path::Path};

use roundel_server::{
    api::{
        ApiLimits,
        tls::{Tls, TlsError},
    },
    model::config::TlsConfig,
};
use tempfile::TempDir;

use super::{
    authority::Authority,
    rig::{client_config, connect, serve},
};

fn files(folder: &Path, self_signed: bool) -> TlsConfig {
    let (certificate, key) = (folder.join("cert.pem"), folder.join("key.pem"));
    TlsConfig { certificate, key, client_ca: None, self_signed }
}

fn load(files: &TlsConfig) -> Result<Tls, TlsError> {
    Tls::load(files, [127, 0, 0, 1].into())
}

fn error(files: &TlsConfig) -> String {
    load(files).err().expect("expected an error").to_string()
}

#[tokio::test]
async fn a_self_signed_certificate_is_made_once_and_verifies_as_its_own_authority() {
    let folder = tempfile::tempdir().unwrap();
    let files = files(folder.path(), true);
    let made = load(&files).unwrap().certificate().unwrap();
    assert_eq!(made.fingerprint.len(), 64);
    let again = load(&files).unwrap();
    assert_eq!(again.certificate().unwrap(), made, "the files are used again");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = fs::metadata(&files.key).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
    }
    let (address, cancel, server) = serve(again, ApiLimits::default()).await;
    let own = fs::read_to_string(&files.certificate).unwrap();
    connect(&address, client_config(&own, None, &[])).await.unwrap();
    cancel.cancel();
    server.await.unwrap();
}

#[test]
fn missing_and_mismatched_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let plain = files(folder.path(), false);
    let text = error(&plain);
    assert!(text.contains("cert.pem") && text.contains("self_signed = true"), "{text}");
    let authority = Authority::new("test authority");
    let (one, other) = (authority.server(), authority.server());
    fs::write(&plain.certificate, &one.certificate).unwrap();
    let half = files(folder.path(), true);
    let text = error(&half);
    assert!(text.contains("cert.pem exists and") && text.contains("key.pem does not"), "{text}");
    fs::write(&plain.key, &other.key).unwrap();
    let text = error(&plain);
    assert!(text.contains("key.pem does not belong to the certificate"), "{text}");
    fs::write(&plain.key, &one.key).unwrap();
    load(&plain).unwrap();
}

#[test]
fn files_with_other_contents_are_described() {
    let folder: TempDir = tempfile::tempdir().unwrap();
    let plain = files(folder.path(), false);
    let issued = Authority::new("test authority").server();
    let encrypted =
        "-----BEGIN ENCRYPTED PRIVATE KEY-----\nAAAA\n-----END ENCRYPTED PRIVATE KEY-----\n";
    for (certificate, key, expected) in [
        ("", issued.key.as_str(), "found an empty file"),
        ("hello", &issued.key, "found no PEM block"),
        (&issued.key, &issued.key, "found PRIVATE KEY"),
        (&issued.certificate, &issued.certificate, "found CERTIFICATE"),
        (&issued.certificate, encrypted, "found ENCRYPTED PRIVATE KEY"),
        (
            "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n",
            &issued.key,
            "cert.pem cannot be used",
        ),
    ] {
        fs::write(&plain.certificate, certificate).unwrap();
        fs::write(&plain.key, key).unwrap();
        let text = error(&plain);
        assert!(text.contains(expected), "{text}");
    }
    fs::write(&plain.certificate, [0x30, 0x82, 0xff, 0xfe]).unwrap();
    let text = error(&plain);
    assert!(text.contains("PEM"), "{text}");
    let with_ca = TlsConfig { client_ca: Some(folder.path().join("ca.pem")), ..plain };
    fs::write(&with_ca.certificate, &issued.certificate).unwrap();
    fs::write(&with_ca.key, &issued.key).unwrap();
    let text = error(&with_ca);
    assert!(text.contains("ca.pem"), "{text}");
}

#[tokio::test]
async fn an_expired_certificate_is_served_and_rejected_by_clients() {
    let folder = tempfile::tempdir().unwrap();
    let (files, authority) = (files(folder.path(), false), Authority::new("test authority"));
    let issued = authority.expired_server();
    fs::write(&files.certificate, &issued.certificate).unwrap();
    fs::write(&files.key, &issued.key).unwrap();
    let tls = load(&files).unwrap();
    assert_eq!(tls.certificate().unwrap().expires, "2021-01-01");
    let (address, cancel, server) = serve(tls, ApiLimits::default()).await;
    let error = connect(&address, client_config(&authority.pem(), None, &[])).await.unwrap_err();
    assert!(error.to_string().contains("expired"), "{error}");
    cancel.cancel();
    server.await.unwrap();
}
