//! Reading, checking and applying the whole configuration.

use axum::http::Method;
use roundel_client::Client;
use roundel_proto::v1;
use serde_json::json;

use super::rig::{CONFIG, Rig, THIRD_CAMERA_TOML, wait_for};

const OBJECT: &str = "\n[[object]]\nname = \"cart\" # red\nroundel = \"robot\"\n";

fn without_b(text: &str) -> String {
    let from = text.find("[[camera]]\nname = \"b\"").unwrap();
    let to = text.find("# ---- The end ----").unwrap();
    [&text[..from], &text[to..]].concat()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn applying_a_configuration_keeps_unchanged_cameras_running() {
    let rig = Rig::start().await;
    let before = rig.running("a").await;
    let client = Client::connect(&rig.url()).await.unwrap();
    let in_force = client.configuration().await.unwrap();
    assert_eq!((in_force.toml.as_str(), in_force.name.as_str()), (CONFIG, "lab"));
    assert!(in_force.kept.ends_with("lab.toml"));
    let names: Vec<&str> = in_force.cameras.iter().map(|camera| camera.name.as_str()).collect();
    assert_eq!(names, ["a", "b"]);
    assert_eq!((in_force.roundels[0].outer_mm, in_force.roundels[0].inner_mm), (160.0, 64.0));
    assert_eq!(in_force.limits.unwrap().max_objects, 1000);
    assert_eq!(in_force.detection.unwrap().mode, "precise");

    let limits = "\n[limits]\nmax_objects = 7\n[fusion]\nlost_after_ms = 3000\n";
    let text = format!("{}{THIRD_CAMERA_TOML}{OBJECT}{limits}", without_b(CONFIG));
    let check = client.check_configuration(&text).await.unwrap();
    let changes = [
        "camera \"c\" is new",
        "camera \"b\" is gone",
        "object \"cart\" is new",
        "[fusion] or [limits] max_objects",
    ];
    assert_eq!((check.problems.len(), check.needs_restart.len()), (0, 0), "{check:?}");
    assert_eq!(check.changes, changes);
    assert_eq!(rig.file(), CONFIG, "a check must change nothing");

    let since = rig.newest_event();
    let applied = client.apply_configuration(&text, &in_force.version).await.unwrap();
    assert_eq!(applied.changes, changes);
    assert_eq!(rig.file(), text);
    assert_ne!(applied.version, in_force.version);
    assert!(rig.camera("b").is_none());
    rig.running("c").await;
    let after = rig.running("a").await;
    assert!(after.frames > before.frames && after.restarts == 0, "{after:?}");
    let named = || rig.server.hub().object_by_name("cart");
    wait_for("an object with that name", named, || rig.server.hub().objects()).await;
    let messages = rig.events_since(since);
    for words in ["Camera b was removed; ", "Object \"cart\" was added; ", "Camera c was added; "] {
        assert!(messages.iter().any(|text| text.starts_with(words)), "{words}: {messages:?}");
    }

    // Rejects a change based on a version that is no longer in force.
    let error = client.apply_configuration(CONFIG, &in_force.version).await.unwrap_err();
    assert!(error.to_string().contains("read it again"), "{error}");
    // A JSON body with the text, as sent by curl.
    let fast = text.replacen("[[roundel]]", "[detection]\nmode = \"fast\"\n\n[[roundel]]", 1);
    let answer = rig.accepted(Method::PUT, "/configuration", Some(json!({ "toml": fast }))).await;
    let changes = ["camera \"a\": mode", "camera \"c\": mode", "[detection] mode"];
    assert_eq!(answer["changes"], json!(changes));
    rig.running("a").await;
    let again = rig.accepted(Method::PUT, "/configuration", Some(json!({ "toml": fast }))).await;
    assert_eq!((&again["changes"], &again["version"]), (&json!([]), &answer["version"]));
    // Cameras can still be changed individually, and are found in the new file.
    rig.accepted(Method::PATCH, "/cameras/c", Some(json!({"name": "west"}))).await;
    rig.accepted(Method::DELETE, "/cameras/west", None).await;
    assert_eq!(rig.file(), fast.replace(THIRD_CAMERA_TOML, ""));
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn problems_and_needed_restarts_are_reported_and_nothing_changes() {
    let rig = Rig::start().await;
    let client = Client::connect(&rig.url()).await.unwrap();
    let wrong = CONFIG
        .replace("rate_hz", "rate")
        .replace("outer_mm = 160.0", "outer_mm = -1")
        .replace("source = \"images:b", "surce = \"images:b");
    let check = client.check_configuration(&wrong).await.unwrap();
    let [first, second, ..] = &check.problems[..] else { panic!("{check:?}") };
    assert_eq!((first.line, first.text.as_str()), (9, "outer_mm = -1"));
    assert_eq!((second.column, second.width), (1, 5), "{second:?}");
    assert!(
        second.message.contains("`surce`") && second.message.contains("`source`"),
        "{second:?}"
    );
    let (status, message) =
        rig.rejected(Method::PUT, "/configuration", Some(json!({ "toml": wrong }))).await;
    assert!(status == 400 && message.starts_with("toml: line 9, column "), "{status} {message}");

    let other = CONFIG.replace("outer_mm = 160.0", "outer_mm = 150.0").replace(
        "listen = \"127.0.0.1:0\" # any",
        "listen = \"127.0.0.1:0\" # any\nsnapshot_rate_hz = 30",
    );
    let check = client.check_configuration(&other).await.unwrap();
    assert_eq!(check.needs_restart, ["[server] snapshot_rate_hz", "[[roundel]]"]);
    let error = client.apply_configuration(&other, "").await.unwrap_err().to_string();
    assert!(error.contains("[server] snapshot_rate_hz, [[roundel]] need a restart"), "{error}");
    let (status, message) =
        rig.rejected(Method::PUT, "/configuration", Some(json!({"tml": ""}))).await;
    assert!(status == 400 && message.contains("application/toml"), "{status} {message}");
    assert_eq!(rig.file(), CONFIG);

    let path = rig.folder.path().join("lab.toml");
    std::fs::write(&path, format!("{CONFIG}# mine\n")).unwrap();
    let object = format!("{CONFIG}{OBJECT}");
    let error = client.apply_configuration(&object, "").await.unwrap_err().to_string();
    assert!(error.contains("has changed since this server read it"), "{error}");
    assert!(rig.server.hub().installation().object_names.is_empty());
    rig.server.shutdown().await;
}

/// A configuration that is read contains no passwords, and writing it back does not lose them.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn passwords_are_neither_shown_nor_lost() {
    let secret = CONFIG.replace("images:b/*.pgm?fps=25&loop=true", "http://eve:pw@127.0.0.1:9/x");
    let rig = Rig::start_with(&secret).await;
    let client = Client::connect(&rig.url()).await.unwrap();
    let in_force: v1::Configuration = client.configuration().await.unwrap();
    let all = format!("{in_force:?}");
    assert!(!all.contains("pw") && all.contains("http://127.0.0.1:9/x"), "{all}");
    let text = format!("{}{OBJECT}", in_force.toml);
    let check = client.check_configuration(&text).await.unwrap();
    assert_eq!(check.changes, ["object \"cart\" is new"]);
    client.apply_configuration(&text, &in_force.version).await.unwrap();
    assert_eq!(rig.file(), format!("{secret}{OBJECT}"));
    rig.server.shutdown().await;
}
