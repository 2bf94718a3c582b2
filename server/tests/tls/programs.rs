//! openssl, curl and Chromium against a server with TLS.

use std::process::{Command, Output, Stdio};

use super::rig::Rig;

/// Runs a program; `None`, with a note, if it is not installed.
async fn run(program: &str, arguments: &[&str]) -> Option<String> {
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::null());
    let output = tokio::task::spawn_blocking(move || command.output()).await.unwrap();
    let Ok(Output { stdout, stderr, .. }) = output else {
        eprintln!("skipped: {program} is not installed");
        return None;
    };
    Some(String::from_utf8_lossy(&[stdout, stderr].concat()).into_owned())
}

#[tokio::test(flavor = "multi_thread")]
async fn openssl_verifies_the_server_and_negotiates_http_2() {
    let rig = Rig::start().await;
    let ca = rig.ca().display().to_string();
    for version in ["-tls1_2", "-tls1_3"] {
        let arguments = [
            "s_client",
            "-connect",
            &rig.address,
            "-CAfile",
            &ca,
            "-verify_return_error",
            "-verify_ip",
            "127.0.0.1",
            "-alpn",
            "h2,http/1.1",
            version,
        ];
        let Some(text) = run("openssl", &arguments).await else { return };
        assert!(text.contains("Verify return code: 0 (ok)"), "{text}");
        assert!(text.contains("ALPN protocol: h2"), "{text}");
    }
    let Some(text) = run("openssl", &["s_client", "-connect", &rig.address, "-tls1_1"]).await
    else {
        return;
    };
    assert!(!text.contains("Cipher is ECDHE"), "TLS 1.1 was accepted: {text}");
    rig.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn curl_gets_pages_by_http_1_and_http_2() {
    let rig = Rig::start().await;
    let (ca, url) = (rig.ca().display().to_string(), rig.url() + "/healthz");
    for (option, version) in [("--http1.1", "1.1 200"), ("--http2", "2 200")] {
        let format = "%{http_version} %{http_code}";
        let arguments = ["-sS", option, "--cacert", &ca, "-o", "/dev/null", "-w", format, &url];
        let Some(text) = run("curl", &arguments).await else { return };
        assert_eq!(text, version);
    }
    // The authority is unknown to the system.
    let text = run("curl", &["-sS", &url]).await.unwrap_or_default();
    assert!(text.contains("certificate"), "{text}");
    rig.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn chromium_shows_pages() {
    let rig = Rig::start().await;
    let profile = format!("--user-data-dir={}", rig.folder.path().join("profile").display());
    let url = rig.url() + "/openapi.json";
    let options = ["--headless", "--no-sandbox", "--disable-gpu", "--ignore-certificate-errors"];
    let arguments = [&options[..], &[&profile, "--dump-dom", &url]].concat();
    let Some(text) = run("chromium", &arguments).await else { return };
    assert!(text.contains("/api/v1/snapshot"), "{text}");
    rig.stop().await;
}
