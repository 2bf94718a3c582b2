//! `[node]`: the server that fuses the cameras of this file.

use std::path::{Path, PathBuf};

use super::reader::Table;

/// `[node]`.
#[derive(Clone, PartialEq, Eq)]
pub struct NodeConfig {
    /// Address of the server, whose cameras of the same names have the poses.
    pub server: String,
    pub token: Option<String>,
    /// PEM file of the authority of the server's certificate. `None`: those of the system.
    pub ca: Option<PathBuf>,
    /// SHA-256 fingerprint of the server's certificate, instead of an authority.
    pub fingerprint: Option<String>,
    /// PEM files of the node's own certificate and key.
    pub certificate: Option<[PathBuf; 2]>,
}

impl std::fmt::Debug for NodeConfig {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // Without the token.
        f.debug_struct("NodeConfig").field("server", &self.server).finish_non_exhaustive()
    }
}

const KEYS: [&str; 6] = ["server", "token", "ca", "fingerprint", "certificate", "key"];

/// `None` without the table, or if it is wrong.
pub(super) fn node(root: &Table<'_, '_>, folder: &Path) -> Option<NodeConfig> {
    let table = root.table("node", "[node]", &KEYS)?;
    let server = table.required_text("server", "\"http://10.0.0.1:7670\"");
    let file = |key| table.text(key).map(|file| folder.join(file));
    let (ca, fingerprint) = (file("ca"), table.text("fingerprint").map(str::to_owned));
    if ca.is_some() && fingerprint.is_some() {
        let message = "`fingerprint` and `ca` exclude each other";
        table.fail("fingerprint", message, "keep one: a fingerprint trusts one certificate only");
    }
    let certificate = match (file("certificate"), file("key")) {
        (Some(certificate), Some(key)) => Some([certificate, key]),
        (Some(_), None) => {
            table.require("key", "\"node-key.pem\"");
            None
        }
        (None, Some(_)) => {
            table.require("certificate", "\"node.pem\"");
            None
        }
        (None, None) => None,
    };
    let token = table.text("token").map(str::to_owned);
    Some(NodeConfig { server: server?.to_owned(), token, ca, fingerprint, certificate })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::config::Config;

    fn parse(keys: &str) -> Result<NodeConfig, String> {
        let text = format!(
            "[[roundel]]\nname = \"robot\"\nouter_mm = 160.0\ninner_mm = 64.0\n\
             [[camera]]\nname = \"north\"\nsource = \"sim:\"\n[node]\nserver = \"https://arena:7670\"\n{keys}"
        );
        match Config::parse(&text, Path::new("/etc/roundel")) {
            Ok(config) => Ok(config.node.unwrap()),
            Err(problems) => Err(problems.into_iter().map(|it| it.message + "\n").collect()),
        }
    }

    #[test]
    fn files_begin_in_the_folder_and_the_token_is_not_shown() {
        let node = parse(
            "token = \"secret\"\nca = \"ca.pem\"\ncertificate = \"n.pem\"\nkey = \"k.pem\"\n",
        );
        let node = node.unwrap();
        assert_eq!(node.ca, Some("/etc/roundel/ca.pem".into()));
        assert_eq!(
            node.certificate,
            Some(["/etc/roundel/n.pem".into(), "/etc/roundel/k.pem".into()])
        );
        assert_eq!(node.token.as_deref(), Some("secret"));
        assert!(!format!("{node:?}").contains("secret"));
    }

    #[test]
    fn half_a_certificate_and_two_kinds_of_trust_are_reported() {
        for (keys, message) in [
            ("certificate = \"n.pem\"\n", "missing key `key` in [node]"),
            ("key = \"k.pem\"\n", "missing key `certificate` in [node]"),
            ("ca = \"ca.pem\"\nfingerprint = \"00\"\n", "exclude each other"),
            ("certifcate = \"n.pem\"\n", "did you mean `certificate`"),
        ] {
            let problems = parse(keys).unwrap_err();
            assert!(problems.contains(message), "{keys}: {problems}");
        }
    }
}
