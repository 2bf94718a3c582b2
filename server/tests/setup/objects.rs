//! Naming, changing and removing objects while they are tracked.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use axum::http::Method;
use roundel_client::{Client, Error};
use roundel_core::world::LifeStage;
use roundel_proto::v1;
use roundel_server::model::hub::ObjectRecord;
use serde_json::{Value, json};
use tokio::time::sleep;

use super::rig::{CONFIG, Rig, TIMEOUT, wait_for};

/// Coded roundels and two objects that are identified by them, one of which carries a camera.
const CODED: &str = r#"
[[roundel]]
name = "shuttle"
outer_mm = 122.0
code = { bits = 8, min_distance = 2 }

# Carries the camera.
[[object]]
name = "bee"
roundel = "shuttle"
code = 2

[[object]]
name = "cart" # red
roundel = "shuttle"
code = 3

[[camera]]
name = "eye"
source = "images:c/*.pgm?fps=25&loop=true"
calibration = "camera.yaml"
pose = { position_m = [0.0, 0.0, 0.0], orientation_xyzw = [0.0, 0.0, 0.0, 1.0], object = "bee" }
"#;

/// A configuration with only camera `a`, which sees one roundel.
fn with_one_camera() -> String {
    let from = CONFIG.find("\n[[camera]]\nname = \"b\"").unwrap();
    CONFIG[..from].to_owned()
}

/// Waits until the only object is tracked and accepted by `is_reached`.
async fn followed(rig: &Rig, what: &str, is_reached: impl Fn(&Value) -> bool) -> Value {
    let begin = Instant::now();
    loop {
        let snapshot = rig.send(Method::GET, "/snapshot", None).await.1;
        let objects = snapshot["objects"].as_array().cloned().unwrap_or_default();
        if let [object] = &objects[..]
            && object["stage"] == "tracked"
            && is_reached(object)
        {
            return object.clone();
        }
        assert!(begin.elapsed() < TIMEOUT, "{what} did not happen: {snapshot}");
        sleep(Duration::from_millis(5)).await;
    }
}

fn events_since(rig: &Rig, sequence: u64) -> Vec<v1::Event> {
    let (events, _) = rig.server.hub().events(1000);
    let new = events.into_iter().filter(|event| event.sequence > sequence);
    new.map(Arc::unwrap_or_clone).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_tracked_object_is_named_offset_and_unnamed_without_losing_its_track() {
    let text = with_one_camera();
    let rig = Rig::start_with(&text).await;
    let before = followed(&rig, "a roundel", |_| true).await;
    let id = before["object_id"].as_u64().unwrap();
    assert_eq!(before["name"], "");
    let since = rig.newest_event();

    let answer = rig
        .accepted(Method::PUT, &format!("/objects/{id}/name"), Some(json!({"name": "cart"})))
        .await;
    assert_eq!(
        (answer["object_id"].as_u64(), &answer["object"]["roundel"]),
        (Some(id), &json!("robot"))
    );
    assert!(answer["kept"].as_str().unwrap().ends_with("lab.toml"), "{answer}");
    let written = "\n[[object]]\nname = \"cart\"\nroundel = \"robot\"\n";
    assert_eq!(
        rig.file(),
        format!("{}{written}", text.trim_end_matches("\n# ---- The end ----\n"))
    );
    followed(&rig, "its name", |object| object["name"] == "cart" && object["object_id"] == id)
        .await;

    // Moves the reference point 5 cm above the roundel, which faces up.
    let path = "/configuration/objects/cart";
    let offset = json!({"offset_m": {"x": 0, "y": 0, "z": 0.05}});
    rig.accepted(Method::PATCH, path, Some(offset)).await;
    let z = |object: &Value| object["position"]["z"].as_f64().unwrap();
    let moved = |object: &Value| (z(object) - z(&before) - 0.05).abs() < 0.005;
    followed(&rig, "the offset position", |object| moved(object) && object["object_id"] == id)
        .await;
    assert!(
        rig.file().contains("roundel = \"robot\"\noffset_m = [0.0, 0.0, 0.05]\n"),
        "{}",
        rig.file()
    );

    // Renames the configured object over gRPC, then removes its offset.
    let client = Client::connect(&rig.url()).await.unwrap();
    let change = client.name_object(id, "wagon").await.unwrap();
    assert_eq!(change.object.unwrap().name, "wagon");
    let setup = client.object_setup("wagon").await.unwrap();
    assert_eq!(setup.offset_m.unwrap().z, 0.05);
    let nothing = v1::ObjectSetup::default();
    client.change_object("wagon", nothing, &["offset_m"]).await.unwrap();
    followed(&rig, "the position without offset", |object| {
        object["name"] == "wagon" && (z(object) - z(&before)).abs() < 0.005
    })
    .await;
    assert_eq!(client.remove_object("wagon").await.unwrap().object_id, id);
    assert_eq!(rig.file(), text.trim_end_matches("\n# ---- The end ----\n"));
    followed(&rig, "no name", |object| object["name"] == "" && object["object_id"] == id).await;

    let events = events_since(&rig, since);
    let kinds: Vec<v1::EventKind> = events.iter().map(v1::Event::kind).collect();
    let changed = v1::EventKind::ObjectChanged;
    let expected =
        [v1::EventKind::ObjectAdded, changed, changed, changed, v1::EventKind::ObjectRemoved];
    assert_eq!(kinds, expected, "the track must not be lost: {events:?}");
    assert!(events.iter().all(|event| event.object_id == id), "{events:?}");
    assert!(events[2].message.starts_with("Object \"cart\" was changed (name); saved in "));
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn invalid_objects_name_the_field_and_change_nothing() {
    let text = format!("{CONFIG}{CODED}");
    let rig = Rig::start_with(&text).await;
    let objects = "/configuration/objects";
    let wrong = [
        (
            json!({"name": "cart", "roundel": "shuttle", "code": 4}),
            "name: two objects are named \"cart\"",
        ),
        (json!({"name": "x", "roundel": "shutle"}), "roundel: "),
        (
            json!({"name": "x", "roundel": "shuttle", "code": 3}),
            "code: objects \"cart\" and \"x\" carry code 3",
        ),
        (
            json!({"name": "x", "roundel": "shuttle", "code": 99}),
            "code: `code` must be 1 to 16, found 99",
        ),
        (json!({"name": "x", "roundel": "robot", "height_m": 1}), "height_m: "),
        (json!({"name": "x"}), "roundel: "),
        (json!({"nam": "x"}), "body: expected JSON such as {\"name\": \"cart\""),
    ];
    for (body, expected) in wrong {
        let (status, message) = rig.rejected(Method::POST, objects, Some(body.clone())).await;
        assert_eq!(status, 400, "{body}: {message}");
        assert!(message.starts_with(expected), "{body}: {message}");
    }
    let (status, message) = rig.rejected(Method::DELETE, &format!("{objects}/bee"), None).await;
    assert!(
        status == 400 && message.contains("no [[object]] is named \"bee\""),
        "{status} {message}"
    );
    for (method, path) in [(Method::DELETE, "/cow"), (Method::GET, "/cow"), (Method::PATCH, "/cow")]
    {
        let body = (method == Method::PATCH).then(|| json!({}));
        let (status, message) = rig.rejected(method, &format!("{objects}{path}"), body).await;
        assert!(status == 404 && message.starts_with("no object \"cow\""), "{status} {message}");
    }
    let named = Some(json!({"name": "x"}));
    let (status, message) = rig.rejected(Method::PUT, "/objects/77/name", named.clone()).await;
    assert!(status == 404 && message.starts_with("no object \"77\""), "{status} {message}");
    // Each camera sees a plain roundel, so two objects are indistinguishable.
    let seen = || {
        rig.server
            .hub()
            .objects()
            .first()
            .map(|object| object.id.0)
            .filter(|_| rig.server.hub().objects().len() == 2)
    };
    let id = wait_for("two objects", seen, || rig.server.hub().objects()).await;
    let (status, message) = rig.rejected(Method::PUT, &format!("/objects/{id}/name"), named).await;
    assert!(status == 409 && message.contains("nothing tells it from them"), "{status} {message}");
    assert_eq!(rig.file(), text);
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_lost_object_does_not_prevent_naming_another_of_its_kind() {
    let rig = Rig::start().await;
    let objects = || rig.server.hub().objects();
    wait_for("two objects", || (objects().len() == 2).then_some(()), objects).await;
    rig.accepted(Method::DELETE, "/cameras/b", None).await;
    let (is_lost, id) = (LifeStage::Lost, |object: &ObjectRecord| object.id.0);
    let apart = || {
        let all = objects();
        let lost = all.iter().find(|object| object.stage == is_lost).map(id);
        lost.zip(all.iter().find(|object| object.stage != is_lost).map(id))
    };
    let (lost, followed) = wait_for("a lost object", apart, objects).await;
    let body = || Some(json!({"name": "cart"}));
    // Its kind would identify the object that is still tracked.
    let (status, message) =
        rig.rejected(Method::PUT, &format!("/objects/{lost}/name"), body()).await;
    assert!(status == 409 && message.contains("nothing tells it from them"), "{status} {message}");
    let answer = rig.accepted(Method::PUT, &format!("/objects/{followed}/name"), body()).await;
    assert_eq!(answer["object"]["name"], "cart", "{answer}");
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_object_that_carries_a_camera_can_be_renamed_and_codes_reassigned() {
    let text = format!("{CONFIG}{CODED}");
    let rig = Rig::start_with(&text).await;
    let body = json!({"name": "drone", "roundels": [
        {"kind": "shuttle", "code": 2, "position_m": {"x": 0.1, "y": 0, "z": 0}},
        {"kind": "shuttle", "code": 4, "position_m": {"x": -0.1, "y": 0, "z": 0}, "yaw_deg": 90},
    ]});
    let path = "/configuration/objects/bee";
    let (status, message) = rig.rejected(Method::PATCH, path, Some(body.clone())).await;
    assert!(
        status == 400 && message.starts_with("code: "),
        "a code and a list of roundels exclude each other: {message}"
    );
    let mut whole = body.clone();
    whole["code"] = Value::Null;
    let answer = rig.accepted(Method::PATCH, path, Some(whole)).await;
    assert_eq!(answer["object"]["roundels"][1]["yaw_deg"], 90.0, "{answer}");
    assert!(rig.file().contains("object = \"drone\" }"), "{}", rig.file());
    let camera = rig.accepted(Method::GET, "/cameras/eye", None).await;
    assert_eq!(camera["carrier"], "drone");
    // The comment of another object is kept, and its code can be reused after it was changed.
    let cart = "/configuration/objects/cart";
    rig.accepted(Method::PATCH, cart, Some(json!({"code": 5}))).await;
    rig.accepted(
        Method::POST,
        "/configuration/objects",
        Some(json!({"name": "van", "roundel": "shuttle", "code": 3})),
    )
    .await;
    assert!(rig.file().contains("name = \"cart\" # red\nroundel = \"shuttle\"\ncode = 5\n"));
    // Cameras and objects can still be removed and changed after the edits.
    rig.accepted(Method::DELETE, "/cameras/a", None).await;
    rig.accepted(Method::DELETE, cart, None).await;
    let camera = rig.accepted(Method::GET, "/cameras/eye", None).await;
    assert_eq!(camera["carrier"], "drone");
    rig.accepted(Method::PATCH, "/cameras/eye", Some(json!({"rate_hz": 25}))).await;
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn rejects_changes_if_the_file_was_edited_or_setup_is_off() {
    let rig = Rig::start().await;
    let object = || json!({"name": "cart", "roundel": "robot"});
    let path = rig.folder.path().join("lab.toml");
    std::fs::write(&path, format!("{CONFIG}# mine\n")).unwrap();
    let rejected = rig.rejected(Method::POST, "/configuration/objects", Some(object())).await;
    assert!(
        rejected.0 == 409 && rejected.1.contains("has changed since this server read it"),
        "{rejected:?}"
    );
    assert_eq!(rig.server.hub().installation().object_names.len(), 0);
    rig.server.shutdown().await;

    let closed = CONFIG.replace("listen =", "setup = false\nlisten =");
    let rig = Rig::start_with(&closed).await;
    let client = Client::connect(&rig.url()).await.unwrap();
    let error = client.remove_object("cart").await.unwrap_err();
    assert!(
        matches!(&error, Error::Refused { .. }) && error.to_string().contains("setup = true"),
        "{error}"
    );
    assert_eq!(rig.file(), closed);
    rig.server.shutdown().await;
}
