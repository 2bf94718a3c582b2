//! Files that requests name: devices, files outside of the allowed folders, and content in errors.

use std::{
    fs,
    path::Path,
    time::{Duration, Instant},
};

use axum::http::Method;
use roundel_server::model::config::Config;
use serde_json::{Value, json};
use tokio::time::timeout;

use crate::setup::rig::{CONFIG, Rig, TIMEOUT, third_camera};

/// Copies of `check.json` and `hang.json` of the folder below.
const CHECK: &str = r#"{"toml":"[[roundel]]\nname=\"r\"\nouter_mm=160\ninner_mm=64\n[[camera]]\nname=\"z\"\nsource=\"push:\"\ncalibration=\"/dev/zero\"\npose={position_m=[0,0,1],orientation_xyzw=[1,0,0,0]}\n"}"#;
const SHARED: &str = "../../shared/data/hostile";
const SECRET: &str = "hunter2";
/// An answer within this time did not read a device, even on a machine under load.
const SOON: Duration = Duration::from_secs(20);

/// The configuration with these keys in `[server]`.
fn with_server_keys(keys: &str) -> String {
    CONFIG.replace("[server]\n", &format!("[server]\n{keys}\n"))
}

/// Messages of the problems of a configuration.
async fn problems(rig: &Rig, body: Value) -> Vec<String> {
    let answer = timeout(SOON, rig.accepted(Method::POST, "/configuration/check", Some(body)));
    let answer = answer.await.expect("the check hangs");
    let problems = answer["problems"].as_array().unwrap();
    problems.iter().map(|problem| problem["message"].as_str().unwrap().to_owned()).collect()
}

fn recorded_requests() -> Vec<Value> {
    let hang = CHECK.replace("/dev/zero", "/dev/ptmx");
    let mut requests = vec![CHECK.to_owned(), hang];
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(SHARED);
    if folder.is_dir() {
        let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap();
        requests.extend(["check.json", "hang.json"].map(read));
    } else {
        println!("skipped: the originals of check.json and hang.json are not in {SHARED}");
    }
    requests.iter().map(|text| serde_json::from_str(text).unwrap()).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn devices_are_refused_and_nothing_else_waits() {
    let rig = Rig::start().await;
    for request in recorded_requests() {
        let found = problems(&rig, request).await;
        let [message] = &found[..] else { panic!("{found:?}") };
        assert!(message.contains("is in no folder whose files clients may name"), "{message}");
    }
    rig.accepted(Method::GET, "/configuration", None).await;
    rig.server.shutdown().await;
}

/// Even where requests may name devices' folder, and in the operator's own file.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn only_regular_files_are_read() {
    let rig = Rig::start_with(&with_server_keys("source_folders = [\"/dev\"]")).await;
    let pipe = rig.folder.path().join("pipe");
    let status = std::process::Command::new("mkfifo").arg(&pipe).status();
    assert!(status.unwrap().success());
    for (file, kind) in [
        ("/dev/zero", "a character device"),
        ("/dev/ptmx", "a character device"),
        ("pipe", "a pipe"),
        (".", "a folder"),
    ] {
        let text = CONFIG.replacen("camera.yaml", file, 1);
        let expected = format!("it is not a regular file ({kind})");
        let found = problems(&rig, json!({ "toml": text })).await;
        assert!(found.len() == 1 && found[0].contains(&expected), "{file}: {found:?}");
        let loaded = Config::parse(&text, rig.folder.path()).unwrap_err();
        assert!(loaded[0].message.contains(&expected), "{file}: {loaded:?}");
        // Times and images of a source, and a video.
        for source in [format!("images:a/*.pgm?times={file}"), format!("file:{file}")] {
            let report = probe(&rig, &source).await;
            assert!(
                report.contains(&expected) || report.contains("built without GStreamer"),
                "{source}: {report}"
            );
        }
    }
    fs::File::create(rig.folder.path().join("large.yaml")).unwrap().set_len(1 << 40).unwrap();
    let text = CONFIG.replacen("camera.yaml", "large.yaml", 1);
    let found = problems(&rig, json!({ "toml": text })).await;
    assert!(found[0].contains("it is larger than 1 MB"), "{found:?}");
    rig.server.shutdown().await;
}

/// The error of a probed source.
async fn probe(rig: &Rig, source: &str) -> String {
    let request = rig.send(Method::POST, "/sources/test", Some(json!({ "source": source })));
    let (_, answer) = timeout(TIMEOUT, request).await.expect("the probe hangs");
    let error = answer["error"].as_str().or(answer["error"]["message"].as_str());
    error.unwrap_or_else(|| panic!("{source}: {answer}")).to_owned()
}

async fn lens_error(rig: &Rig, source: &str) -> String {
    rig.rejected(Method::POST, "/lens", Some(json!({ "source": source }))).await.1
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_request_names_a_file_outside_of_the_folders() {
    let rig = Rig::start().await;
    let elsewhere = tempfile::tempdir().unwrap();
    fs::write(elsewhere.path().join("secret"), SECRET).unwrap();
    std::os::unix::fs::symlink(elsewhere.path(), rig.folder.path().join("link")).unwrap();
    let refusal = "is in no folder whose files clients may name";
    for name in ["secret", "missing"] {
        let outside = elsewhere.path().join(name).display().to_string();
        for path in [outside.as_str(), &format!("link/{name}"), &format!("a/../../{name}")] {
            for source in [
                format!("images:{path}"),
                format!("images:{path}/*.png"),
                format!("images:a/*.pgm?times={path}"),
                format!("file:{path}"),
            ] {
                let mut errors = vec![probe(&rig, &source).await, lens_error(&rig, &source).await];
                let camera = json!({ "source": source });
                errors.push(rig.rejected(Method::PATCH, "/cameras/b", Some(camera)).await.1);
                let mut camera = third_camera();
                camera["source"] = json!(source);
                errors.push(rig.rejected(Method::POST, "/cameras", Some(camera)).await.1);
                let text = CONFIG.replace("images:b/*.pgm?fps=25&loop=true", &source);
                errors.extend(problems(&rig, json!({ "toml": text })).await);
                let apply = Some(json!({ "toml": text }));
                errors.push(rig.rejected(Method::PUT, "/configuration", apply).await.1);
                assert_eq!(errors.len(), 6);
                assert!(errors.iter().all(|it| it.contains(refusal)), "{source}: {errors:?}");
            }
            let camera = json!({ "calibration": path });
            let (_, error) = rig.rejected(Method::PATCH, "/cameras/b", Some(camera)).await;
            assert!(error.contains(refusal), "{path}: {error}");
        }
    }
    assert_eq!(rig.file(), CONFIG);
    rig.server.shutdown().await;
}

/// A camera whose files are elsewhere was written by the operator, and stays when something else changes.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_the_running_configuration_names_stays_allowed() {
    let elsewhere = tempfile::tempdir().unwrap();
    fs::create_dir(elsewhere.path().join("frames")).unwrap();
    crate::setup::rig::write_lens(elsewhere.path(), "lens.yaml", 290.0);
    let outside = elsewhere.path().display().to_string();
    let config = CONFIG
        .replace("images:b/*.pgm", &format!("images:{outside}/frames/*.pgm"))
        .replacen("camera.yaml", &format!("{outside}/lens.yaml"), 1);
    let rig = Rig::start_with(&config).await;
    rig.accepted(Method::PATCH, "/cameras/b", Some(json!({ "line_time_us": 10 }))).await;
    rig.accepted(Method::PATCH, "/cameras/b", Some(json!({ "name": "west" }))).await;
    rig.accepted(Method::PATCH, "/cameras/a", Some(json!({ "mode": "fast" }))).await;
    let text = format!("{}\n[[object]]\nname = \"cart\"\nroundel = \"robot\"\n", rig.file());
    rig.accepted(Method::PUT, "/configuration", Some(json!({ "toml": text }))).await;
    // Another file in the same folder.
    let other = json!({ "calibration": format!("{outside}/other.yaml") });
    let (_, error) = rig.rejected(Method::PATCH, "/cameras/a", Some(other)).await;
    assert!(error.contains("is in no folder"), "{error}");
    rig.server.shutdown().await;

    let keys = format!("source_folders = [{outside:?}]");
    let rig = Rig::start_with(&with_server_keys(&keys)).await;
    let camera = json!({ "calibration": format!("{outside}/lens.yaml") });
    rig.accepted(Method::PATCH, "/cameras/a", Some(camera)).await;
    let (_, error) =
        rig.rejected(Method::PUT, "/configuration", Some(json!({ "toml": CONFIG }))).await;
    assert!(error.contains("source_folders need a restart"), "{error}");
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn errors_do_not_quote_files() {
    let rig = Rig::start().await;
    let write = |name: &str, text: &str| fs::write(rig.folder.path().join(name), text).unwrap();
    write("secret.txt", SECRET);
    let good = fs::read_to_string(rig.folder.path().join("camera.yaml")).unwrap();
    for (name, text) in [
        ("0.yaml", format!("password: {SECRET}\n")),
        ("1.yaml", good.replace("plumb_bob", SECRET)),
        ("2.yaml", good.replace("160", SECRET)),
        ("3.yaml", format!("{SECRET}: [")),
        ("4.yaml", good.replace("300.0", "-42424242.0")),
        (
            "5.yaml",
            format!("{good}parameter_names: [{SECRET}]\nparameter_covariance:\n  data: [1]\n"),
        ),
    ] {
        write(name, &text);
        let camera = json!({ "calibration": name });
        let (_, error) = rig.rejected(Method::PATCH, "/cameras/b", Some(camera)).await;
        assert!(error.contains(name) && error.contains(".yaml:"), "{name}: {error}");
        assert!(!error.contains(SECRET) && !error.contains("42424242"), "{name}: {error}");
    }
    for (source, expected) in [
        ("images:secret.txt", "expected a PNG, JPEG, PGM or BMP image, found text"),
        ("images:a/*.pgm?times=secret.txt", "secret.txt:1: expected a whole number of nanoseconds"),
    ] {
        let error = probe(&rig, source).await;
        assert!(error.contains(expected) && !error.contains(SECRET), "{source}: {error}");
        rig.accepted(Method::PATCH, "/cameras/b", Some(json!({ "source": source }))).await;
        let state = rig.until("a failure", "b", |state| state.error.contains(expected)).await;
        assert!(!state.error.contains(SECRET), "{}", state.error);
    }
    let events = rig.events_since(0);
    assert!(!format!("{events:?}").contains(SECRET), "{events:?}");
    rig.server.shutdown().await;
}

/// Listing all files of the machine ends with the shutdown.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_pattern_that_spans_the_disk_holds_up_nothing() {
    let config = CONFIG.replace("images:b/*.pgm", "images:/**/*.none");
    let rig = Rig::start_with(&config).await;
    rig.running("a").await;
    // Stops the worker that lists.
    rig.accepted(Method::PATCH, "/cameras/b", Some(json!({ "line_time_us": 10 }))).await;
    let begun = Instant::now();
    timeout(TIMEOUT, rig.server.shutdown()).await.expect("the shutdown hangs");
    assert!(begun.elapsed() < SOON, "{:?}", begun.elapsed());
}
