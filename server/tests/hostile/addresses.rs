//! Addresses that requests name: networks, ports, redirects, and pipelines.

use std::{io::Write, net::TcpListener};

use axum::http::Method;
use serde_json::json;

use crate::{
    setup::rig::{CONFIG, Rig, third_camera},
    source::fake_camera::FakeCamera,
};

const PIPELINE: &str =
    "gst:videotestsrc is-live=true ! video/x-raw,width=160,height=120,framerate=10/1";

fn with_server_keys(keys: &str) -> String {
    CONFIG.replace("[server]\n", &format!("[server]\n{keys}\n"))
}

/// The error of a probed source, whether it was opened or refused.
async fn probe(rig: &Rig, source: &str) -> String {
    let request = Some(json!({ "source": source }));
    loop {
        let (_, answer) = rig.send(Method::POST, "/sources/test", request.clone()).await;
        let error = answer["error"].as_str().or(answer["error"]["message"].as_str());
        let error = error.unwrap_or_else(|| panic!("{source}: {answer}"));
        // Every timeout of a source is shorter than that of the trial, unless the machine stands still.
        if !error.contains("the trial timed out") {
            return error.to_owned();
        }
    }
}

/// Errors of every request that can name a source.
async fn errors(rig: &Rig, source: &str) -> Vec<String> {
    let mut errors = vec![probe(rig, source).await];
    let lens = Some(json!({ "source": source }));
    errors.push(rig.rejected(Method::POST, "/lens", lens.clone()).await.1);
    errors.push(rig.rejected(Method::PATCH, "/cameras/b", lens).await.1);
    let mut camera = third_camera();
    camera["source"] = json!(source);
    errors.push(rig.rejected(Method::POST, "/cameras", Some(camera)).await.1);
    let toml = CONFIG.replace("images:b/*.pgm?fps=25&loop=true", source);
    let check =
        rig.accepted(Method::POST, "/configuration/check", Some(json!({ "toml": toml }))).await;
    errors.push(check["problems"][0]["message"].as_str().unwrap_or_default().to_owned());
    errors.push(rig.rejected(Method::PUT, "/configuration", Some(json!({ "toml": toml }))).await.1);
    errors
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn requests_set_neither_pipelines_nor_foreign_addresses_nor_other_devices() {
    let rig = Rig::start().await;
    for (source, expected) in [
        (PIPELINE, "`gst:` can run any pipeline"),
        (
            "http://203.0.113.7/stream",
            "203.0.113.7 is in no network whose cameras clients may name",
        ),
        (
            "rtsp://203.0.113.7/stream",
            "203.0.113.7 is in no network whose cameras clients may name",
        ),
        ("http://[2001:db8::7]/stream", "2001:db8::7 is in no network"),
        ("v4l2:/dev/ptmx", "/dev/ptmx is no camera that clients may name"),
        ("v4l2:/etc/passwd", "/etc/passwd is no camera that clients may name"),
    ] {
        let errors = errors(&rig, source).await;
        assert!(errors.iter().all(|it| it.contains(expected)), "{source}: {errors:#?}");
    }
    assert_eq!(rig.file(), CONFIG);
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_pipeline_of_the_configuration_file_stays() {
    let config = CONFIG.replace("images:b/*.pgm?fps=25&loop=true", PIPELINE);
    let rig = Rig::start_with(&config).await;
    rig.accepted(Method::PATCH, "/cameras/b", Some(json!({ "name": "west" }))).await;
    rig.accepted(Method::PATCH, "/cameras/west", Some(json!({ "line_time_us": 1 }))).await;
    let text = format!("{}\n[[object]]\nname = \"cart\"\nroundel = \"robot\"\n", rig.file());
    rig.accepted(Method::PUT, "/configuration", Some(json!({ "toml": text }))).await;
    let other = Some(json!({ "source": format!("{PIPELINE} ! identity") }));
    let (_, error) = rig.rejected(Method::PATCH, "/cameras/west", other).await;
    assert!(error.contains("write this source into the configuration file"), "{error}");
    rig.server.shutdown().await;
}

/// A port that is closed, one that does not answer, and one of another protocol have the same error.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn errors_do_not_tell_which_ports_are_open() {
    let rig = Rig::start().await;
    let closed = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let ends = FakeCamera::start(|_, _, _| Ok(()));
    let other = FakeCamera::start(|_, _, socket| socket.write_all(b"SSH-2.0-OpenSSH_9.2\r\n\r\n"));
    let ports = [closed, silent.local_addr().unwrap(), ends.address(), other.address()];
    let schemes: &[&str] = if cfg!(feature = "gst") { &["http", "rtsp"] } else { &["http"] };
    for scheme in schemes {
        for address in ports {
            let error = probe(&rig, &format!("{scheme}://{address}/stream")).await;
            let error = error.replace(&address.to_string(), "HOST:PORT");
            assert!(error.starts_with("no camera answers at "), "{scheme} {address}: {error}");
            assert!(!error.contains("efused") && !error.contains("timed out"), "{error}");
        }
    }
    // The worker of a camera that a client added says no more.
    let mut camera = third_camera();
    camera["source"] = json!(format!("http://{closed}/stream"));
    rig.accepted(Method::POST, "/cameras", Some(camera)).await;
    let state = rig.until("a failure", "c", |state| !state.error.is_empty()).await;
    assert!(state.error.contains("no camera answers at "), "{}", state.error);
    // It stays bound when something else changes.
    rig.accepted(Method::PATCH, "/cameras/c", Some(json!({ "name": "west" }))).await;
    let state = rig.until("a failure", "west", |state| !state.error.is_empty()).await;
    assert!(state.error.contains("no camera answers at "), "{}", state.error);
    rig.server.shutdown().await;
}

/// A name is resolved when the source connects, and the address that was checked is the one that is used.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_name_that_resolves_to_a_foreign_address_is_not_connected_to() {
    let camera =
        FakeCamera::start(|_, _, socket| socket.write_all(b"HTTP/1.1 204 No Content\r\n\r\n"));
    let port = camera.address().port();
    let rig =
        Rig::start_with(&with_server_keys("source_networks = [\"10.0.0.0/8\", \"192.168.1.7\"]"))
            .await;
    let schemes: &[&str] = if cfg!(feature = "gst") { &["http", "rtsp"] } else { &["http"] };
    for scheme in schemes {
        let error = probe(&rig, &format!("{scheme}://localhost:{port}/stream")).await;
        assert!(error.contains("localhost is in no network"), "{error}");
        let error = probe(&rig, &format!("{scheme}://127.0.0.1:{port}/stream")).await;
        assert!(error.contains("127.0.0.1 is in no network"), "{error}");
    }
    assert_eq!(camera.served(), 0);
    rig.server.shutdown().await;

    let rig = Rig::start_with(&with_server_keys("source_networks = [\"127.0.0.1\"]")).await;
    let error = probe(&rig, &format!("http://localhost:{port}/stream")).await;
    assert!(camera.served() > 0 && !error.contains("is in no network"), "{error}");
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn redirects_are_not_followed() {
    let target = FakeCamera::start(|_, _, _| Ok(()));
    let to = target.address();
    let camera = FakeCamera::start(move |_, _, socket| {
        let head =
            format!("HTTP/1.1 302 Found\r\nLocation: http://{to}/\r\nContent-Length: 0\r\n\r\n");
        socket.write_all(head.as_bytes())
    });
    let rig = Rig::start().await;
    let error = probe(&rig, &format!("http://{}/stream", camera.address())).await;
    assert!(error.contains("redirects are not followed"), "{error}");
    assert_eq!(target.served(), 0);
    rig.server.shutdown().await;
}

/// GStreamer follows redirects; it connects, and must send nothing.
#[cfg(feature = "gst")]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_is_sent_after_a_redirect_of_rtsp() {
    let target = TcpListener::bind("127.0.0.1:0").unwrap();
    let to = target.local_addr().unwrap();
    use std::{
        io::Read,
        sync::{
            Arc,
            atomic::{AtomicUsize, Ordering},
        },
        thread::{self, sleep},
        time::Duration,
    };

    let received = Arc::<AtomicUsize>::default();
    let count = received.clone();
    thread::spawn(move || {
        for socket in target.incoming() {
            let Ok(mut socket) = socket else { return };
            let count = count.clone();
            thread::spawn(move || {
                let mut bytes = [0; 1000];
                while let Ok(read @ 1..) = socket.read(&mut bytes) {
                    count.fetch_add(read, Ordering::SeqCst);
                }
            });
        }
    });
    let camera = FakeCamera::start(move |_, request, socket| {
        let sequence = request.lines().find(|line| line.starts_with("CSeq")).unwrap_or_default();
        let head =
            format!("RTSP/1.0 302 Moved\r\n{sequence}\r\nLocation: rtsp://{to}/other\r\n\r\n");
        socket.write_all(head.as_bytes())?;
        sleep(Duration::from_millis(200));
        Ok(())
    });
    let rig = Rig::start().await;
    let error = probe(&rig, &format!("rtsp://{}/stream", camera.address())).await;
    assert!(camera.served() > 0 && !error.is_empty(), "{error}");
    assert_eq!(received.load(Ordering::SeqCst), 0, "{error}");
    rig.server.shutdown().await;
}
