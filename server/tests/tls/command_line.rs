//! `roundel serve` with TLS, and commands that connect to it.

use std::{
    fs,
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, Stdio},
};

const CONFIG: &str = r#"name = "lab"
[server]
listen = "127.0.0.1:0"
tls = { certificate = "cert.pem", key = "key.pem", self_signed = true }
[[roundel]]
name = "robot"
outer_mm = 160.0
inner_mm = 64.0
[[camera]]
name = "north"
source = "sim:"
"#;

struct Server {
    child: Child,
    fingerprint: String,
    url: String,
}

impl Server {
    /// Starts `roundel serve` in this folder and reads its first lines.
    fn start(folder: &Path) -> Self {
        fs::write(folder.join("lab.toml"), CONFIG).unwrap();
        let mut child = Command::new(env!("CARGO_BIN_EXE_roundel"))
            .args(["serve", "--config"])
            .arg(folder.join("lab.toml"))
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let mut next = || lines.next().expect("the server ended").unwrap();
        let (certificate, listening) = (next(), next());
        let rest = certificate.strip_prefix("TLS certificate: SHA-256 fingerprint ").unwrap();
        let (fingerprint, expires) = rest.split_once(", expires ").unwrap();
        assert!(expires.len() == 10 && expires.starts_with("20"), "{certificate}");
        let url = listening.strip_prefix("listening on ").unwrap().to_owned();
        assert!(url.starts_with("https://127.0.0.1:"), "{listening}");
        Self { child, fingerprint: fingerprint.to_owned(), url }
    }

    /// `roundel watch` of one snapshot: standard output and error.
    fn watch(&self, options: &[&str], token: &str) -> (String, String) {
        let output = Command::new(env!("CARGO_BIN_EXE_roundel"))
            .args(["watch", "--format", "json", "--count", "1", "--server", &self.url])
            .args(options)
            .env("ROUNDEL_TOKEN", token)
            .output()
            .unwrap();
        [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap()).into()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn a_self_signed_server_prints_its_fingerprint_for_commands_to_pin() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(folder.path());
    let ca = folder.path().join("cert.pem").display().to_string();
    for options in [["--fingerprint", &server.fingerprint], ["--ca", &ca]] {
        let (snapshot, error) = server.watch(&options, "secret");
        assert!(snapshot.contains("\"objects\""), "{options:?}: {error}");
    }
    let (_, error) = server.watch(&["--fingerprint", &"ab".repeat(32)], "");
    assert!(error.contains(&server.fingerprint) && error.contains("expected abab"), "{error}");
    let (_, error) = server.watch(&[], "");
    assert!(error.contains("not trusted"), "{error}");
    let (_, error) = server.watch(&["--fingerprint", "12"], "");
    assert!(error.contains("64 hexadecimal digits"), "{error}");
    let (_, error) = server.watch(&["--ca", &ca], "two\nlines");
    assert!(error.contains("`token`") && !error.contains("lines\n"), "{error}");
}

#[test]
fn a_server_without_its_certificate_does_not_start() {
    let folder = tempfile::tempdir().unwrap();
    let config = CONFIG.replace(", self_signed = true", "");
    fs::write(folder.path().join("lab.toml"), config).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_roundel"))
        .args(["serve", "--config"])
        .arg(folder.path().join("lab.toml"))
        .output()
        .unwrap();
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success());
    assert!(error.contains("cert.pem") && error.contains("self_signed = true"), "{error}");
}
