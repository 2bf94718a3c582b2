//! Sources that are tried through a running server.

use roundel_client::{Client, v1::TimeBase};

use crate::rig::Rig;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_source_is_tried_beside_what_runs() {
    let rig = Rig::start("push:").await;
    let client = Client::connect(&rig.server.local_addr().to_string()).await.unwrap();
    let trial = client.test_source("sim:?robots=6", None).await.unwrap();
    assert_eq!((trial.error.as_str(), trial.width, trial.height), ("", 1280, 720), "{trial:?}");
    assert!(trial.frames > 0 && trial.roundels > 0, "{trial:?}");
    assert_eq!(trial.capture_clock.unwrap().base(), TimeBase::Server);
    // Nothing of it was fused.
    assert_eq!(rig.server.hub().fusion_counts().frames, 0);

    let closed = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let trial = client.test_source(&format!("http://{closed}/stream"), None).await.unwrap();
    assert!(trial.error.contains("refused") && trial.frames == 0, "{trial:?}");
    for (source, expected) in [
        ("htp://10.0.0.2/", "source: no source begins with `htp:`"),
        ("push:", "source: a `push:` camera is fed by a program"),
    ] {
        let error = client.test_source(source, None).await.unwrap_err();
        assert!(error.to_string().contains(expected), "{error}");
    }
}

/// One that is open to a network has sources tried by nobody but its own people.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_server_that_is_open_tries_nothing_unless_it_is_told_to() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = crate::rig::config("push:", folder.path());
    assert!(config.server.setup, "on the loopback it may");
    config.server.setup = false;
    let server = roundel_server::app::serve::Server::start(config).await.unwrap();
    let client = Client::connect(&server.local_addr().to_string()).await.unwrap();
    let error = client.test_source("sim:", None).await.unwrap_err();
    assert!(error.to_string().contains("`setup = true` under [server] allows it"), "{error}");
}
