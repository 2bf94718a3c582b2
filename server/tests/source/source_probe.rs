//! Probing a source through a running server (`TestSource`).

use roundel_client::{Client, v1::TimeBase};

use super::rig::Rig;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn probes_a_source_beside_the_running_cameras() {
    let rig = Rig::start("push:").await;
    let client = Client::connect(&rig.server.local_addr().to_string()).await.unwrap();
    let report = client.test_source("sim:?robots=6", None).await.unwrap();
    assert_eq!((report.error.as_str(), report.width, report.height), ("", 1280, 720), "{report:?}");
    assert!(report.frames > 0 && report.roundels > 0, "{report:?}");
    assert_eq!(report.capture_clock.unwrap().base(), TimeBase::Server);
    // No detection of a probe reaches fusion.
    assert_eq!(rig.server.hub().fusion_counts().frames, 0);

    let closed = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let report = client.test_source(&format!("http://{closed}/stream"), None).await.unwrap();
    assert!(report.error.contains("no camera answers") && report.frames == 0, "{report:?}");
    for (source, expected) in [
        ("htp://10.0.0.2/", "source: no source begins with `htp:`"),
        ("push:", "source: a `push:` camera is fed by a program"),
    ] {
        let error = client.test_source(source, None).await.unwrap_err();
        assert!(error.to_string().contains(expected), "{error}");
    }
}

/// Probing needs `setup`, which is off by default on a server that is open to a network.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_server_without_setup_rejects_probes() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = super::rig::config("push:", folder.path());
    assert!(config.server.setup, "setup must be on by default on loopback");
    config.server.setup = false;
    let server = roundel_server::app::serve::Server::start(config).await.unwrap();
    let client = Client::connect(&server.local_addr().to_string()).await.unwrap();
    let error = client.test_source("sim:", None).await.unwrap_err();
    assert!(error.to_string().contains("`setup = true` under [server] allows it"), "{error}");
}
