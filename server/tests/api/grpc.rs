//! The gRPC service, called with tonic's client.

use std::sync::Arc;

use roundel_core::{
    camera::PixelPoint,
    ellipse::Ellipse,
    id::{CameraId, ObjectId, TrackNumber},
    marker::{self, CodeReading, Ring},
    pose::Detection,
    world::FrameObservations,
};
use roundel_proto::v1::{self, roundel_client::RoundelClient};
use tokio::time::timeout;
use tonic::{
    Code, Streaming,
    transport::{Channel, Endpoint},
};
use tonic_types::StatusExt;

use super::rig::{Rig, TIMEOUT, objects};

pub async fn channel(rig: &Rig) -> Channel {
    Endpoint::from_shared(rig.url()).unwrap().connect().await.unwrap()
}

pub async fn connect(rig: &Rig) -> RoundelClient<Channel> {
    RoundelClient::new(channel(rig).await)
}

pub async fn next<T>(messages: &mut Streaming<T>) -> T {
    timeout(TIMEOUT, messages.message()).await.expect("no message arrives").unwrap().unwrap()
}

async fn subscribe(rig: &Rig, request: v1::SubscribeSnapshotsRequest) -> Streaming<v1::Snapshot> {
    connect(rig).await.subscribe_snapshots(request).await.unwrap().into_inner()
}

#[tokio::test]
async fn a_snapshot_arrives_with_every_field() {
    let rig = Rig::start().await;
    rig.publish(objects(2));
    let mut snapshots = subscribe(&rig, v1::SubscribeSnapshotsRequest::default()).await;
    let snapshot = next(&mut snapshots).await;

    assert_eq!((snapshot.sequence, snapshot.source_id.as_str(), snapshot.missed), (1, "run", 0));
    assert_eq!(snapshot.pose_time_ns - snapshot.capture_time_ns, 7);
    assert_eq!(snapshot.fused_time_ns, snapshot.pose_time_ns);
    assert!(snapshot.sent_time_ns >= snapshot.fused_time_ns);
    let [robot, cart] = &snapshot.objects[..] else { panic!("{snapshot:?}") };
    assert_eq!((robot.object_id, robot.name.as_str(), robot.roundel.as_str()), (1, "", "robot"));
    assert_eq!((cart.object_id, cart.name.as_str()), (2, "cart \"one\""));
    assert_eq!(robot.stage(), v1::LifeStage::Tracked);
    assert_eq!(cart.stage(), v1::LifeStage::Predicted);
    assert_eq!(cart.position, Some(v1::Vector3 { x: 2.0, y: -2.0, z: 1.0 }));
    assert_eq!(cart.velocity, Some(v1::Vector3 { x: 1.0, y: 2.0, z: 0.0 }));
    assert_eq!((robot.covariance.len(), robot.velocity_covariance.len()), (21, 6));
    assert_eq!((robot.covariance[0], robot.covariance[1], robot.covariance[6]), (1e-4, 1e-5, 1e-4));
    assert_eq!(robot.cameras, ["north", "south side"]);
    assert_eq!(robot.residual, 0.75);

    rig.publish(objects(1));
    assert_eq!(next(&mut snapshots).await.objects.len(), 1);
    let once = connect(&rig).await.get_snapshot(v1::GetSnapshotRequest::default()).await.unwrap();
    assert_eq!(once.into_inner().sequence, 2);
    rig.stop().await;
}

#[tokio::test]
async fn fails_before_the_first_snapshot() {
    let rig = Rig::start().await;
    let status =
        connect(&rig).await.get_snapshot(v1::GetSnapshotRequest::default()).await.unwrap_err();
    assert_eq!(status.code(), Code::Unavailable);
    assert!(status.message().contains("no snapshot yet"), "{status}");
    rig.stop().await;
}

#[tokio::test]
async fn selects_objects_and_fields() {
    let rig = Rig::start().await;
    rig.publish(objects(6));
    let ids = |snapshot: &v1::Snapshot| -> Vec<u64> {
        snapshot.objects.iter().map(|object| object.object_id).collect()
    };
    let corner = |x, y, z| Some(v1::Vector3 { x, y, z });

    let request = v1::SubscribeSnapshotsRequest {
        object_ids: vec![5, 2, 5, 99],
        omit_covariance: true,
        ..Default::default()
    };
    let snapshot = next(&mut subscribe(&rig, request).await).await;
    assert_eq!(ids(&snapshot), [2, 5]);
    assert!(snapshot.objects.iter().all(|o| o.covariance.is_empty()));
    assert!(snapshot.objects.iter().all(|o| o.velocity_covariance.is_empty()));

    let request = v1::SubscribeSnapshotsRequest {
        object_ids: vec![1, 2, 4],
        roundels: vec!["cart".into()],
        ..Default::default()
    };
    assert_eq!(ids(&next(&mut subscribe(&rig, request).await).await), [2, 4]);

    // A region includes its faces, and a side may be infinite.
    let (min, max) = (corner(2.0, f64::NEG_INFINITY, 0.0), corner(4.0, 0.0, f64::INFINITY));
    let region = Some(v1::Box { min, max });
    let request = v1::SubscribeSnapshotsRequest { region, ..Default::default() };
    assert_eq!(ids(&next(&mut subscribe(&rig, request).await).await), [2, 3, 4]);

    // After half a second at 1 m/s along x, object 4 has left the region, and object 1 has not reached it.
    let request =
        v1::SubscribeSnapshotsRequest { region, horizon_ms: Some(500.0), ..Default::default() };
    let predicted = next(&mut subscribe(&rig, request).await).await;
    assert_eq!(ids(&predicted), [2, 3]);
    assert_eq!(predicted.objects[0].position, corner(2.5, -1.0, 1.0));
    let now = connect(&rig).await.get_snapshot(v1::GetSnapshotRequest::default()).await.unwrap();
    let now = now.into_inner();
    assert_eq!(predicted.pose_time_ns - now.pose_time_ns, 500_000_000);
    assert!(predicted.objects[0].covariance[0] > now.objects[1].covariance[0]);
    rig.stop().await;
}

#[tokio::test]
async fn snapshots_skipped_by_a_rate_limit_are_not_missed() {
    let rig = Rig::start().await;
    let start = rig.clock.now();
    let publish = |place: i32| {
        let time = start.plus_seconds(f64::from(place) / 60.0);
        rig.hub.publish_snapshot(roundel_core::world::Snapshot::default(), time);
    };
    publish(0);
    let mut all = subscribe(&rig, v1::SubscribeSnapshotsRequest::default()).await;
    let request = v1::SubscribeSnapshotsRequest { max_rate_hz: Some(20.0), ..Default::default() };
    let mut some = subscribe(&rig, request).await;
    let first = next(&mut some).await.sequence;
    assert_eq!((first, next(&mut all).await.sequence), (1, 1));
    for place in 1..=60 {
        publish(place);
        next(&mut all).await;
    }
    let mut wanted = 0;
    loop {
        let snapshot = next(&mut some).await;
        wanted += 1 + snapshot.missed;
        assert_eq!(snapshot.sequence % 3, 1, "every third snapshot is due");
        if snapshot.sequence == 61 {
            break;
        }
    }
    assert_eq!(wanted, 20);
    rig.stop().await;
}

#[tokio::test]
async fn a_slow_subscriber_skips_to_the_newest_and_counts_what_it_missed() {
    // The connection's window is as large as the stream's, or larger.
    for connection in [64 * 1024, 1024 * 1024] {
        a_slow_subscriber_skips(connection).await;
    }
}

async fn a_slow_subscriber_skips(connection_window: u32) {
    const LAST: u64 = 200;
    let rig = Rig::start().await;
    let channel = Endpoint::from_shared(rig.url())
        .unwrap()
        .initial_stream_window_size(64 * 1024)
        .initial_connection_window_size(connection_window)
        .connect()
        .await
        .unwrap();
    let request = v1::SubscribeSnapshotsRequest::default();
    let mut slow =
        RoundelClient::new(channel).subscribe_snapshots(request).await.unwrap().into_inner();
    let mut quick = subscribe(&rig, v1::SubscribeSnapshotsRequest::default()).await;
    for _ in 1..=LAST {
        rig.publish(objects(150));
        assert_eq!(next(&mut quick).await.missed, 0, "a slow subscriber must not affect another");
    }
    let (mut received, mut missed, mut before) = (0, 0, 0);
    while before < LAST {
        let snapshot = next(&mut slow).await;
        assert!(received == 0 || snapshot.sequence == before + 1 + snapshot.missed);
        if received == 0 {
            missed = snapshot.sequence - 1;
        }
        before = snapshot.sequence;
        received += 1;
        missed += snapshot.missed;
    }
    assert_eq!(received + missed, LAST);
    // A snapshot has about 60 kB, so that windows and buffers hold only a few.
    assert!(received < LAST / 4, "{received} were buffered");
    rig.stop().await;
}

#[tokio::test]
async fn invalid_requests_name_the_field() {
    let rig = Rig::start().await;
    rig.publish(objects(1));
    let mut client = connect(&rig).await;
    let corner = |x: f64| Some(v1::Vector3 { x, y: 0.0, z: 0.0 });
    let ok = v1::SubscribeSnapshotsRequest::default;
    let region =
        |min, max| v1::SubscribeSnapshotsRequest { region: Some(v1::Box { min, max }), ..ok() };
    let rate = |hz| v1::SubscribeSnapshotsRequest { max_rate_hz: Some(hz), ..ok() };
    let horizon = |ms| v1::SubscribeSnapshotsRequest { horizon_ms: Some(ms), ..ok() };
    for (request, message) in [
        (
            rate(0.0),
            "max_rate_hz: expected a rate above 0 (leave it out for every snapshot), found 0",
        ),
        (rate(-5.0), "found -5"),
        (
            rate(f64::NAN),
            "max_rate_hz: expected a rate above 0 (leave it out for every snapshot), found NaN",
        ),
        (rate(f64::INFINITY), "found inf"),
        (horizon(-1.0), "horizon_ms: expected milliseconds from 0 to 1000, found -1"),
        (horizon(1000.5), "found 1000.5"),
        (horizon(f64::NAN), "horizon_ms: expected milliseconds from 0 to 1000, found NaN"),
        (
            region(None, corner(1.0)),
            "region.min: expected a corner of the box, metres, found nothing",
        ),
        (
            region(corner(1.0), None),
            "region.max: expected a corner of the box, metres, found nothing",
        ),
        (region(corner(f64::NAN), corner(1.0)), "region.min.x: expected metres, found NaN"),
        (
            region(corner(2.0), corner(1.0)),
            "region.max.x: expected at least 2 (region.min.x), found 1",
        ),
        (
            v1::SubscribeSnapshotsRequest { object_ids: vec![1, 0], ..ok() },
            "object_ids: expected ids of objects, which count from 1, found 0",
        ),
    ] {
        let status = client.subscribe_snapshots(request.clone()).await.unwrap_err();
        assert_eq!(status.code(), Code::InvalidArgument, "{request:?}");
        assert!(status.message().contains(message), "{request:?}: {}", status.message());
        // Programs read the field from the status metadata.
        let violations = status.get_details_bad_request().unwrap().field_violations;
        let (field, expected) = status.message().split_once(": ").unwrap();
        assert_eq!(
            (violations[0].field.as_str(), violations[0].description.as_str()),
            (field, expected)
        );
        assert_eq!(status.get_details_error_info().unwrap().metadata["code"], "invalid_argument");
    }

    let request = v1::SubscribeObservationsRequest { cameras: vec!["nort".into()] };
    let status = client.subscribe_observations(request).await.unwrap_err();
    assert_eq!(status.code(), Code::NotFound);
    assert_eq!(status.message(), "no camera \"nort\"; there are: north, south side");
    let missing = status.get_details_resource_info().unwrap();
    assert_eq!(
        (missing.resource_type.as_str(), missing.resource_name.as_str()),
        ("camera", "nort")
    );
    let request = v1::SubscribeEventsRequest { backlog: 1001 };
    let status = client.subscribe_events(request).await.unwrap_err();
    assert_eq!(status.code(), Code::InvalidArgument);
    assert_eq!(status.message(), "backlog: expected at most 1000 events, found 1001");

    let many = v1::SubscribeSnapshotsRequest { object_ids: vec![u64::MAX; 50_000], ..ok() };
    let status = client.subscribe_snapshots(many).await.unwrap_err();
    assert_eq!(status.code(), Code::OutOfRange, "{status}");
    rig.stop().await;
}

#[tokio::test]
async fn observations_are_filtered_and_gaps_are_counted() {
    let rig = Rig::start().await;
    let publish = |camera, frame| {
        let time = rig.clock.now();
        rig.hub.publish_observations(Arc::new(FrameObservations {
            camera: CameraId(camera),
            frame,
            capture_time: time,
            received_time: time,
            calibration_version: 3,
            detections: Vec::new(),
        }));
    };
    let mut client = connect(&rig).await;
    let request = v1::SubscribeObservationsRequest { cameras: vec!["south side".into()] };
    let mut south = client.subscribe_observations(request).await.unwrap().into_inner();
    let mut all = client
        .subscribe_observations(v1::SubscribeObservationsRequest::default())
        .await
        .unwrap()
        .into_inner();
    for (camera, frame) in [(0, 7), (1, 3), (1, 4), (0, 9), (1, 8)] {
        publish(camera, frame);
    }
    let mut seen = Vec::new();
    for _ in 0..3 {
        let message = next(&mut south).await;
        seen.push((message.camera, message.frame, message.missed));
    }
    let name = "south side".to_owned();
    assert_eq!(seen, [(name.clone(), 3, 0), (name.clone(), 4, 0), (name, 8, 3)]);
    let mut missed = Vec::new();
    for _ in 0..5 {
        missed.push(next(&mut all).await.missed);
    }
    assert_eq!(missed, [0, 0, 0, 1, 3]);

    // The buffer holds 256 frames: a client that does not read loses the oldest, and receives their count.
    for frame in 9..2000 {
        publish(1, frame);
    }
    let mut total = 0;
    loop {
        let message = next(&mut south).await;
        total += 1 + message.missed;
        if message.frame == 1999 {
            break;
        }
    }
    assert_eq!(total, 1991);
    rig.stop().await;
}

#[tokio::test]
async fn detections_include_code_readings_and_levels() {
    let rig = Rig::start().await;
    let mut client = connect(&rig).await;
    let everything = v1::SubscribeObservationsRequest::default();
    let mut stream = client.subscribe_observations(everything).await.unwrap().into_inner();
    let rim = |semi_px| Ellipse {
        center: PixelPoint { u: 30.0, v: 20.0 },
        semi_major_px: semi_px,
        semi_minor_px: semi_px,
        angle_rad: 0.0,
    };
    let plain = Ring::of_rims(rim(10.0), rim(6.0));
    let reading = CodeReading {
        confidence: 0.97,
        corrected: 1,
        ..CodeReading::certain(
            marker::Code { bits: 8, number: 12 },
            PixelPoint { u: 36.0, v: 20.0 },
        )
    };
    let time = rig.clock.now();
    let seen = [plain, Ring { code: Some(reading), ..plain }];
    let detections = (1..).zip(seen).map(|(number, ring)| Detection {
        track: TrackNumber(number),
        ring,
        capture_time: time,
        pose: None,
    });
    rig.hub.publish_observations(Arc::new(FrameObservations {
        camera: CameraId(0),
        frame: 1,
        capture_time: time,
        received_time: time,
        calibration_version: 1,
        detections: detections.collect(),
    }));
    let message = next(&mut stream).await;
    assert_eq!(message.detections[0].code, None);
    assert_eq!((message.detections[0].black, message.detections[0].white), (20.0, 220.0));
    assert_eq!(
        message.detections[1].code,
        Some(v1::CodeReading {
            bits: 8,
            number: 12,
            confidence: 0.97,
            corrected_bits: 1,
            zero: Some(v1::PixelPoint { u: 36.0, v: 20.0 }),
        })
    );
    rig.stop().await;
}

#[tokio::test]
async fn events_start_with_the_backlog() {
    let rig = Rig::start().await;
    let appear = |id| {
        let (now, message) = (rig.clock.now(), format!("object {id} appeared"));
        let kind = v1::EventKind::ObjectAppeared;
        rig.hub.publish_object_event(now, kind, Some(ObjectId(id)), message);
    };
    (1..=3).for_each(appear);
    let request = v1::SubscribeEventsRequest { backlog: 2 };
    let mut events = connect(&rig).await.subscribe_events(request).await.unwrap().into_inner();
    let (now, kind) = (rig.clock.now(), v1::EventKind::CameraFailed);
    rig.hub.publish_camera_event(now, kind, CameraId(1), "no such file".into());
    let mut seen = Vec::new();
    for _ in 0..3 {
        let event = next(&mut events).await;
        seen.push((event.sequence, event.kind(), event.object_id, event.camera));
    }
    assert_eq!(
        seen,
        [
            (2, v1::EventKind::ObjectAppeared, 2, String::new()),
            (3, v1::EventKind::ObjectAppeared, 3, String::new()),
            (4, v1::EventKind::CameraFailed, 0, "south side".to_owned()),
        ]
    );
    rig.stop().await;
}
