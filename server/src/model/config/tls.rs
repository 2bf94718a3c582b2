//! `[server] tls`: files of the server's certificate and of the authority of client certificates.

use std::path::{Path, PathBuf};

use super::reader::Table;

/// `[server] tls`. The files are read at start and whenever they change.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TlsConfig {
    /// PEM: the server's certificate, then those of its issuers up to a root.
    pub certificate: PathBuf,
    /// PEM: the certificate's key, not encrypted.
    pub key: PathBuf,
    /// PEM: certificates of the authorities that issue client certificates. `None`: clients are not asked for one.
    pub client_ca: Option<PathBuf>,
    /// Whether a self-signed certificate is made if neither file exists at start.
    pub self_signed: bool,
}

const KEYS: [&str; 4] = ["certificate", "key", "client_ca", "self_signed"];

/// `None` without the table, or if it is wrong.
pub(super) fn tls(server: &Table<'_, '_>, folder: &Path) -> Option<TlsConfig> {
    let table = server.table("tls", "[server.tls]", &KEYS)?;
    let certificate = table.required_text("certificate", "\"certificate.pem\"");
    let key = table.required_text("key", "\"key.pem\"");
    let client_ca = table.text("client_ca").map(|file| folder.join(file));
    let self_signed = table.flag("self_signed").unwrap_or(false);
    Some(TlsConfig {
        certificate: folder.join(certificate?),
        key: folder.join(key?),
        client_ca,
        self_signed,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::config::Config;

    const REST: &str = "[[roundel]]\nname = \"robot\"\nouter_mm = 160.0\ninner_mm = 64.0\n[[camera]]\nname = \"north\"\nsource = \"sim:\"\n";

    fn parse(tls: &str) -> Result<Option<TlsConfig>, String> {
        let text = format!("[server]\ntls = {tls}\n{REST}");
        match Config::parse(&text, Path::new("/etc/roundel")) {
            Ok(config) => Ok(config.server.tls),
            Err(problems) => Err(problems.into_iter().map(|it| it.message + "\n").collect()),
        }
    }

    #[test]
    fn relative_files_begin_in_the_configuration_s_folder() {
        let text = r#"{ certificate = "cert.pem", key = "/run/key.pem", client_ca = "ca.pem", self_signed = true }"#;
        let expected = TlsConfig {
            certificate: "/etc/roundel/cert.pem".into(),
            key: "/run/key.pem".into(),
            client_ca: Some("/etc/roundel/ca.pem".into()),
            self_signed: true,
        };
        assert_eq!(parse(text), Ok(Some(expected)));
        let short = parse(r#"{ certificate = "cert.pem", key = "key.pem" }"#).unwrap().unwrap();
        assert_eq!((short.client_ca, short.self_signed), (None, false));
    }

    #[test]
    fn incomplete_and_unknown_keys_are_reported() {
        for (text, message) in [
            (r#"{ certificate = "cert.pem" }"#, "missing key `key` in [server.tls]"),
            (r#"{ certificate = "a", key = "b", ca = "c" }"#, "unknown key `ca` in [server.tls]"),
            (r#"{ certificate = "a", key = "b", self_signed = 1 }"#, "`self_signed` must be true"),
            ("true", "`tls` must be a table"),
        ] {
            let problems = parse(text).unwrap_err();
            assert!(problems.contains(message), "{text}: {problems}");
        }
    }
}
