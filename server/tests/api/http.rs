//! REST, its OpenAPI description, metrics, and the dashboard's files.

use std::collections::BTreeSet;

use axum::{
    body::Body,
    http::{Request, StatusCode},
};
use roundel_core::{
    id::CameraId,
    marker::Reject,
    world::{ClockEstimate, FusionCounts},
};
use roundel_proto::v1;
use roundel_server::model::hub::{CameraStatus, EventKind};
use serde_json::Value;

use super::rig::{Rig, objects};

#[tokio::test]
async fn rejects_a_body_that_is_too_long_with_an_error_body() {
    let rig = Rig::start().await;
    for (method, path, content_type) in [
        ("POST", "configuration/check", "application/toml"),
        ("PUT", "configuration", "application/json"),
        ("POST", "sources/test", "application/json"),
        ("POST", "simulation/drive", "application/json"),
    ] {
        let request = Request::builder().method(method).uri(format!("{}/api/v1/{path}", rig.url()));
        let request = request.header("content-type", content_type);
        let answer = rig.request(request.body(Body::from(vec![b' '; 262_145])).unwrap()).await;
        let (code, message) = answer.error();
        assert_eq!((answer.status, code.as_str()), (StatusCode::PAYLOAD_TOO_LARGE, "too_large"));
        assert!(message.contains("at most 262144 bytes"), "{path}: {message}");
    }
    rig.stop().await;
}

#[tokio::test]
async fn the_snapshot_in_json_equals_that_of_grpc() {
    let rig = Rig::start().await;
    rig.publish(objects(6));
    let json = rig.get("/api/v1/snapshot").await.json();
    assert_eq!(json["objects"][1]["name"], "cart \"one\"");
    assert_eq!(json["objects"][1]["stage"], "predicted");
    assert_eq!(json["objects"][1]["code"], serde_json::json!({"bits": 8, "number": 2}));
    assert_eq!(json["objects"][0]["code"], Value::Null);
    assert_eq!(json["objects"][0]["covariance"].as_array().unwrap().len(), 21);
    assert!(json["pose_time_ns"].is_string());
    let mut rest: v1::Snapshot = serde_json::from_value(json).unwrap();
    let mut grpc = super::grpc::connect(&rig)
        .await
        .get_snapshot(v1::GetSnapshotRequest::default())
        .await
        .unwrap()
        .into_inner();
    (rest.sent_time_ns, grpc.sent_time_ns) = (0, 0);
    assert_eq!(rest, grpc);

    let path =
        "/api/v1/snapshot?ids=5,2,1&min=1.5,-9,0&max=9,9,inf&horizon_ms=250&omit_covariance=true";
    let some: v1::Snapshot = serde_json::from_value(rig.get(path).await.json()).unwrap();
    let ids: Vec<u64> = some.objects.iter().map(|object| object.object_id).collect();
    assert_eq!(ids, [2, 5]);
    assert_eq!(some.objects[0].position, Some(v1::Vector3 { x: 2.25, y: -1.5, z: 1.0 }));
    assert!(some.objects[0].covariance.is_empty());
    assert_eq!(some.pose_time_ns - grpc.pose_time_ns, 250_000_000);
    rig.stop().await;
}

#[tokio::test]
async fn serves_lists_and_single_resources() {
    let rig = Rig::start().await;
    rig.publish(objects(2));
    rig.publish(objects(1));
    let (now, kind) = (rig.clock.now(), EventKind::CameraRunning);
    rig.hub.publish_camera_event(now, kind, CameraId(1), "camera runs".into());
    let objects = rig.get("/api/v1/objects").await.json();
    assert_eq!(objects["objects"].as_array().unwrap().len(), 2);
    assert_eq!(objects["objects"][1]["stage"], "lost");
    assert_eq!(objects["objects"][1]["code"]["number"], 2);
    let object = rig.get("/api/v1/objects/1").await.json();
    assert_eq!(object["object"]["object_id"], 1);
    assert_eq!(object["state"]["position"]["x"], 1.0);
    let lost = rig.get("/api/v1/objects/2").await.json();
    assert_eq!((&lost["object"]["stage"], lost["state"].is_null()), (&"lost".into(), true));
    let cameras = rig.get("/api/v1/cameras").await.json();
    assert_eq!(cameras["cameras"][1]["name"], "south side");
    let camera = rig.get("/api/v1/cameras/south%20side").await.json();
    assert_eq!(
        (&camera["status"], &camera["source"]),
        (&"starting".into(), &"sim:?of=south side".into())
    );
    let events = rig.get("/api/v1/events?backlog=5").await.json();
    assert_eq!(events["events"][0]["kind"], "camera_running");
    assert_eq!(rig.get("/api/v1/events?backlog=0").await.json()["events"], serde_json::json!([]));
    let info = rig.get("/api/v1/info").await.json();
    assert_eq!((&info["name"], &info["source_id"]), (&"lab".into(), &"run".into()));
    // The rig has no recorder, replay, history or set-up.
    for ability in ["records", "replays", "keeps_history", "allows_setup"] {
        assert_eq!(info[ability], false, "{ability}");
    }
    rig.stop().await;
}

#[tokio::test]
async fn wrong_requests_name_what_was_expected() {
    let rig = Rig::start().await;
    let early = rig.get("/api/v1/snapshot").await;
    assert_eq!(early.status, StatusCode::SERVICE_UNAVAILABLE);
    assert_eq!(early.error().0, "unavailable");
    rig.publish(objects(1));
    for (path, status, message) in [
        (
            "/api/v1/snapshot?ids=1,x",
            400,
            "ids: expected ids with commas between, such as 1,2, found \"x\"",
        ),
        (
            "/api/v1/snapshot?ids=0",
            400,
            "ids: expected ids of objects, which count from 1, found 0",
        ),
        ("/api/v1/snapshot?ids=-1", 400, "found \"-1\""),
        (
            "/api/v1/snapshot?min=0,0,0",
            400,
            "max: expected a corner of the box, metres, found nothing",
        ),
        (
            "/api/v1/snapshot?min=0,0&max=1,1,1",
            400,
            "min: expected three numbers of metres, such as -1,0,2.5, found 2 numbers",
        ),
        (
            "/api/v1/snapshot?min=0,2,0&max=1,1,1",
            400,
            "max.y: expected at least 2 (min.y), found 1",
        ),
        ("/api/v1/snapshot?min=nan,2,0&max=1,1,1", 400, "min.x: expected metres, found NaN"),
        (
            "/api/v1/snapshot?horizon_ms=soon",
            400,
            "horizon_ms: expected a number of milliseconds, found \"soon\"",
        ),
        (
            "/api/v1/snapshot?horizon_ms=2000",
            400,
            "horizon_ms: expected milliseconds from 0 to 1000, found 2000",
        ),
        (
            "/api/v1/snapshot?omit_covariance=yes",
            400,
            "omit_covariance: expected true or false, found \"yes\"",
        ),
        (
            "/api/v1/snapshot?omit_covarianze=true",
            400,
            "(perhaps omit_covariance?), found \"omit_covarianze\"",
        ),
        ("/api/v1/snapshot?ids=1&ids=2", 400, "ids: expected one value"),
        ("/api/v1/events?backlog=1001", 400, "backlog: expected at most 1000 events, found 1001"),
        ("/api/v1/events?backlog=-1", 400, "backlog: expected a number of events, found \"-1\""),
        (
            "/api/v1/objects/seven",
            400,
            "id: expected the number of an object (object_id), found \"seven\"",
        ),
        ("/api/v1/objects/7", 404, "no object \"7\"; /api/v1/objects lists"),
        ("/api/v1/cameras/east", 404, "no camera \"east\"; there are: north, south side"),
        ("/api/v1/cameras/east/frame.jpg", 404, "no camera \"east\"; there are: north, south side"),
        ("/api/v1/cameras/%ff", 400, "path: expected percent-encoded UTF-8"),
        ("/api/v1/nothing", 404, "no path \"/api/v1/nothing\""),
        ("/nothing.html", 404, "described at /api and /openapi.json"),
        ("/../Cargo.toml", 404, "no path"),
        ("/api/v1/stream", 426, "expected a WebSocket handshake"),
        (
            "/api/v1/stream?include=all",
            400,
            "include: expected any of snapshots,cameras,events,observations, found \"all\"",
        ),
        ("/api/v1/stream?max_rate_hz=0", 400, "max_rate_hz: expected a rate above 0"),
        ("/api/v1/stream?rate=3", 400, "(perhaps max_rate_hz?), found \"rate\""),
    ] {
        let answer = rig.get(path).await;
        let (code, found) = answer.error();
        assert_eq!(answer.status.as_u16(), status, "{path}: {found}");
        assert!(found.contains(message), "{path}: {found}");
        let expected = match status {
            400 => "invalid_argument",
            404 => "not_found",
            _ => "upgrade_required",
        };
        assert_eq!(code, expected, "{path}");
    }
    for path in ["/api/v1/snapshot", "/api/v1/stream", "/"] {
        let request = Request::post(format!("{}{path}", rig.url())).body(Body::from("x")).unwrap();
        let answer = rig.request(request).await;
        assert_eq!(answer.status, StatusCode::METHOD_NOT_ALLOWED, "{path}");
        assert_eq!(answer.error().0, "method_not_allowed");
    }
    rig.stop().await;
}

#[tokio::test]
async fn openapi_describes_every_route() {
    let rig = Rig::start().await;
    rig.publish(objects(1));
    let document = rig.get("/openapi.json").await.json();
    let described: BTreeSet<&str> =
        document["paths"].as_object().unwrap().keys().map(String::as_str).collect();
    let expected = BTreeSet::from([
        "/api/v1/calibration",
        "/api/v1/calibration/applied",
        "/api/v1/cameras",
        "/api/v1/cameras/{name}",
        "/api/v1/cameras/{name}/frame.jpg",
        "/api/v1/cameras/{name}/setup",
        "/api/v1/codes",
        "/api/v1/configuration",
        "/api/v1/configuration.toml",
        "/api/v1/configuration/check",
        "/api/v1/configuration/objects",
        "/api/v1/configuration/objects/{name}",
        "/api/v1/events",
        "/api/v1/history",
        "/api/v1/history.csv",
        "/api/v1/history.parquet",
        "/api/v1/info",
        "/api/v1/lens",
        "/api/v1/lens/applied",
        "/api/v1/lens/file",
        "/api/v1/lens/finished",
        "/api/v1/lens/picture.jpg",
        "/api/v1/objects",
        "/api/v1/objects/{id}",
        "/api/v1/objects/{id}/name",
        "/api/v1/print-sizes",
        "/api/v1/observations",
        "/api/v1/plan",
        "/api/v1/print",
        "/api/v1/recording",
        "/api/v1/recordings",
        "/api/v1/replay",
        "/api/v1/session",
        "/api/v1/simulation/drive",
        "/api/v1/simulation/push",
        "/api/v1/snapshot",
        "/api/v1/sources/test",
        "/api/v1/stream",
        "/api/v1/time",
        "/healthz",
        "/metrics",
        "/openapi.json",
        "/readyz",
    ]);
    assert_eq!(described, expected);
    let schemas = document["components"]["schemas"].as_object().unwrap();
    for name in ["Snapshot", "ObjectState", "Camera", "Event", "ServerInfo", "ErrorBody"] {
        assert!(schemas.contains_key(name), "{name} is not described");
    }
    assert_eq!(schemas["Snapshot"]["properties"]["pose_time_ns"]["type"], "string");
    for path in described {
        let answer = rig.get(&path.replace("{name}", "north").replace("{id}", "1")).await;
        let responses = &document["paths"][path]["get"]["responses"];
        let status = answer.status.as_u16().to_string();
        if responses.is_null() {
            assert_eq!(status, "405", "{path} is not described for GET");
            continue;
        }
        assert!(
            responses.get(&status).is_some(),
            "{path} answered {status}, which is not described"
        );
        assert_ne!(status, "404", "{path}");
    }
    rig.stop().await;
}

#[tokio::test]
async fn readiness_reports_what_is_missing() {
    let rig = Rig::start().await;
    assert_eq!(rig.get("/healthz").await.status, StatusCode::OK);
    let answer = rig.get("/readyz").await;
    assert_eq!(answer.status, StatusCode::SERVICE_UNAVAILABLE);
    let missing = answer.json()["missing"].clone();
    assert_eq!(missing[0], "fusion has not published a snapshot yet");
    assert_eq!(missing[1], "no camera runs: north is starting, south side is starting");

    rig.set_camera_status(CameraStatus::Running);
    let stale = rig.clock.now().plus_seconds(-60.0);
    rig.hub.publish_snapshot(roundel_core::world::Snapshot::default(), stale);
    let missing = rig.get("/readyz").await.json()["missing"].clone();
    assert!(missing[0].as_str().unwrap().starts_with("fusion's newest snapshot is 6"), "{missing}");
    assert_eq!(missing.as_array().unwrap().len(), 1);

    // A task publishes continuously, so that the newest snapshot is never stale on a slow machine.
    let (hub, clock) = (rig.hub.clone(), rig.clock);
    let fusion = tokio::spawn(async move {
        loop {
            hub.publish_snapshot(roundel_core::world::Snapshot::default(), clock.now());
            tokio::time::sleep(std::time::Duration::from_millis(10)).await;
        }
    });
    let ready = async { while rig.get("/readyz").await.status != StatusCode::OK {} };
    tokio::time::timeout(super::rig::TIMEOUT, ready).await.expect("the server never becomes ready");
    rig.hub.set_fusion_ended();
    let answer = rig.get("/readyz").await;
    assert_eq!(answer.status, StatusCode::SERVICE_UNAVAILABLE);
    assert_eq!(answer.json()["missing"], serde_json::json!(["fusion has ended"]));
    fusion.abort();
    rig.stop().await;
}

#[tokio::test]
async fn metrics_cover_cameras_objects_and_clients() {
    let rig = Rig::start().await;
    rig.publish(objects(3));
    rig.hub.update_camera(CameraId(0), |camera| {
        camera.status = CameraStatus::Running;
        camera.frames = 1234;
        camera.detect_ms = 2.5;
        (camera.find_ms, camera.locate_ms) = (2.0, 0.5);
        (camera.blur_px, camera.noise) = (0.75, 2.25);
        camera.reprojection_px = 0.125;
        camera.clock = Some(ClockEstimate {
            offset_s: -0.0125,
            skew: 2e-5,
            deviation_s: 5e-5,
            skew_deviation: 1e-6,
        });
        (camera.counts.precise, camera.counts.fast, camera.counts.unlocated) = (900, 30, 1);
        (camera.counts.deferred, camera.budget_used) = (50, 0.25);
        camera.counts.rejects[Reject::FrameEdge as usize] = 44;
    });
    rig.hub.set_fusion_counts(FusionCounts {
        frames: 10,
        late_frames: 3,
        missing_frames: 6,
        used: 70,
        gated: 2,
        contradicted: 1,
        joined: 40,
        left_out: 4,
        held: 7,
        held_frames: 2,
        retracted: 9,
        clock_steps: 5,
        ..Default::default()
    });
    let mut client = super::grpc::connect(&rig).await;
    let request = v1::SubscribeSnapshotsRequest::default();
    let mut snapshots = client.subscribe_snapshots(request).await.unwrap().into_inner();
    super::grpc::next(&mut snapshots).await;

    let answer = rig.get("/metrics").await;
    assert!(answer.header("content-type").starts_with("text/plain; version=0.0.4"));
    let text = answer.text();
    for line in [
        "# TYPE roundel_camera_frames_total counter",
        "roundel_camera_frames_total{camera=\"north\"} 1234",
        "roundel_camera_frames_total{camera=\"south side\"} 0",
        "roundel_camera_up{camera=\"north\"} 1",
        "roundel_camera_up{camera=\"south side\"} 0",
        "roundel_camera_detect_seconds{camera=\"north\"} 0.0025",
        "roundel_camera_blur_pixels{camera=\"north\"} 0.75",
        "roundel_camera_noise_levels{camera=\"north\"} 2.25",
        "roundel_camera_reprojection_pixels{camera=\"north\"} 0.125",
        "roundel_camera_reprojection_pixels{camera=\"south side\"} 0",
        "roundel_camera_clock_offset_seconds{camera=\"north\"} -0.0125",
        "roundel_camera_clock_skew_ratio{camera=\"north\"} 0.00002",
        "roundel_camera_clock_deviation_seconds{camera=\"north\"} 0.00005",
        "roundel_camera_clock_deviation_seconds{camera=\"south side\"} 0",
        "roundel_camera_stage_seconds{camera=\"north\",stage=\"find\"} 0.002",
        "roundel_camera_stage_seconds{camera=\"north\",stage=\"locate\"} 0.0005",
        "roundel_camera_located_total{camera=\"north\",by=\"precise\"} 900",
        "roundel_camera_located_total{camera=\"north\",by=\"fast\"} 30",
        "roundel_camera_located_total{camera=\"north\",by=\"deferred\"} 50",
        "roundel_camera_located_total{camera=\"north\",by=\"none\"} 1",
        "roundel_camera_budget_ratio{camera=\"north\"} 0.25",
        "roundel_camera_located_total{camera=\"south side\",by=\"precise\"} 0",
        "roundel_camera_rejects_total{camera=\"north\",reason=\"frame_edge\"} 44",
        "roundel_camera_rejects_total{camera=\"north\",reason=\"tilt\"} 0",
        "roundel_fusion_clock_steps_total 5",
        "roundel_fusion_missing_frames_total 6",
        "roundel_objects{stage=\"tracked\"} 2",
        "roundel_objects{stage=\"predicted\"} 1",
        "roundel_objects{stage=\"lost\"} 0",
        "roundel_fusion_frames_total{outcome=\"taken\"} 7",
        "roundel_fusion_frames_total{outcome=\"late\"} 3",
        "roundel_fusion_detections_total{outcome=\"used\"} 70",
        "roundel_fusion_gated_total 2",
        "roundel_fusion_detections_total{outcome=\"contradicted\"} 1",
        "roundel_fusion_detections_total{outcome=\"joined\"} 40",
        "roundel_fusion_detections_total{outcome=\"left_out\"} 4",
        "roundel_fusion_detections_total{outcome=\"held_back\"} 7",
        "roundel_fusion_held_frames_total 2",
        "roundel_fusion_taken_back_total 9",
        "roundel_snapshots_total 1",
        "roundel_subscribers 1",
        "roundel_snapshots_sent_total 1",
        "roundel_snapshots_missed_total 0",
        "roundel_connections_refused_total 0",
        "roundel_info{version=\"0.1.0\",name=\"lab\",source_id=\"run\"} 1",
    ] {
        assert!(text.lines().any(|found| found == line), "{line} is not in\n{text}");
    }
    // Each metric family is declared once, before its samples.
    for line in text.lines().filter(|line| !line.starts_with('#')) {
        let name = line.split(['{', ' ']).next().unwrap();
        assert_eq!(text.matches(&format!("# TYPE {name} ")).count(), 1, "{name}");
        assert!(line.rsplit(' ').next().unwrap().parse::<f64>().is_ok(), "{line}");
    }
    drop(snapshots);
    let gone =
        async { while !rig.get("/metrics").await.text().contains("\nroundel_subscribers 0\n") {} };
    tokio::time::timeout(super::rig::TIMEOUT, gone)
        .await
        .expect("a disconnected subscriber is still counted");
    rig.stop().await;
}

#[tokio::test]
async fn the_dashboard_is_served_with_a_strict_policy_and_an_etag() {
    let rig = Rig::start().await;
    let page = rig.get("/").await;
    assert_eq!(page.status, StatusCode::OK);
    assert_eq!(page.header("content-type"), "text/html; charset=utf-8");
    assert_eq!(
        page.header("content-security-policy"),
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; worker-src 'self'; form-action 'self'; frame-ancestors 'none'; base-uri 'none'"
    );
    assert_eq!(page.header("x-content-type-options"), "nosniff");
    assert_eq!(page.header("cache-control"), "no-cache");
    let api = rig.get("/api").await;
    assert_eq!(api.header("content-type"), "text/html; charset=utf-8");
    assert!(api.text().contains("js/api.js"), "{}", api.text());
    let script = rig.get("/js/main.js").await;
    assert_eq!(script.header("content-type"), "text/javascript; charset=utf-8");
    assert_eq!(rig.get("/app.css").await.header("content-type"), "text/css; charset=utf-8");

    let tag = page.header("etag").to_owned();
    let ask = |tag: &str| {
        let request = Request::get(rig.url()).header("if-none-match", tag);
        rig.request(request.body(Body::empty()).unwrap())
    };
    let known = ask(&tag).await;
    assert_eq!((known.status, known.body.len()), (StatusCode::NOT_MODIFIED, 0));
    assert_eq!(ask("\"other\"").await.status, StatusCode::OK);
    rig.stop().await;
}

#[tokio::test]
async fn a_calibration_starts_only_with_json() {
    let rig = Rig::start().await;
    let url = format!("{}/api/v1/calibration", rig.url());
    let send = async |kind: &'static str, body: &'static str| {
        let request = Request::post(&url).header("content-type", kind).body(Body::from(body));
        rig.request(request.unwrap()).await
    };
    // A content type that a page of another origin can send without a CORS preflight.
    let answer = send("text/plain", "{}").await;
    assert_eq!(answer.status, StatusCode::UNSUPPORTED_MEDIA_TYPE);
    assert!(answer.error().1.contains("expected application/json"), "{:?}", answer.error());
    for (body, expected) in [
        ("{\"second\": 5}", "unknown field `second`"),
        ("{\"apply\": \"perhaps\"}", "unknown calibration_apply"),
        ("{\"seconds\": 5", "EOF"),
    ] {
        let answer = send("application/json", body).await;
        assert_eq!(answer.status, StatusCode::BAD_REQUEST, "{body}");
        assert!(answer.error().1.contains(expected), "{:?}", answer.error());
    }
    // This rig has no running cameras.
    let answer = send("application/json", "{}").await;
    assert_eq!(
        (answer.status, answer.error().0),
        (StatusCode::CONFLICT, "failed_precondition".into())
    );
    assert!(answer.error().1.contains("no fixed camera"), "{:?}", answer.error());
    let shown = rig.get("/api/v1/calibration").await.json();
    assert_eq!((&shown["stage"], &shown["version"]), (&"idle".into(), &0.into()));
    rig.stop().await;
}
