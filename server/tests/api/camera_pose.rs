//! Poses of fixed and mounted cameras, and the reason while a pose is unknown, in REST, metrics and events.

use nalgebra::{UnitQuaternion, Vector3};
use roundel_core::{
    id::CameraId,
    rigid::{Covariance6, Rigid},
    time::Timestamp,
    world::CameraPlacement,
};
use roundel_server::{
    api::ApiLimits,
    model::hub::{CameraInfo, CameraPoseState, EventKind, Hub, MountInfo, PoseStatus},
};
use serde_json::{Value, json};

use super::rig::{Rig, hub};

/// The second camera is mounted on the object "carrier" and looks down.
fn hub_with_mounted_camera() -> std::sync::Arc<Hub> {
    let hub = hub("run");
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let mut info = CameraInfo::clone(&hub.installation().cameras[&CameraId(1)]);
    info.ride = Some(MountInfo {
        carrier: "carrier".into(),
        object_from_camera: Rigid::from_parts(Vector3::new(0.0, 0.0, -0.1).into(), down),
        localizes: true,
    });
    hub.set_camera(CameraId(1), info);
    hub
}

fn placement(x_m: f64, variance: f64) -> CameraPlacement {
    CameraPlacement {
        world_from_camera: Rigid::translation(x_m, 2.0, 3.0),
        covariance: Covariance6::from_diagonal_element(variance),
    }
}

async fn cameras(rig: &Rig) -> [Value; 2] {
    let all = rig.get("/api/v1/cameras").await.json();
    [0, 1].map(|index| all["cameras"][index].clone())
}

#[tokio::test]
async fn each_camera_reports_its_pose_or_why_it_is_unknown() {
    let rig = Rig::start_with(hub_with_mounted_camera(), ApiLimits::default(), "127.0.0.1:0").await;
    let place = |camera: u32, place: CameraPoseState| {
        rig.hub.update_camera(CameraId(camera), |state| state.pose = place);
    };
    place(0, CameraPoseState::searching("it sees two references"));
    let reason = "\"carrier\" is not followed".to_owned();
    let status = PoseStatus::CarrierUnseen;
    place(1, CameraPoseState { status, reason, ..CameraPoseState::default() });
    let [fixed, mounted] = cameras(&rig).await;
    assert_eq!((&fixed["pose"], &fixed["mount"]), (&Value::Null, &Value::Null));
    assert_eq!((&fixed["pose_status"], &fixed["carrier"]), (&json!("searching"), &json!("")));
    assert_eq!(fixed["pose_reason"], "it sees two references");
    assert_eq!(mounted["pose_status"], "carrier_unseen");
    assert_eq!(mounted["pose_reason"], "\"carrier\" is not followed");
    assert_eq!((&mounted["carrier"], &mounted["localizes"]), (&json!("carrier"), &json!(true)));
    assert_eq!(
        (&mounted["mount"]["position"]["z"], &mounted["pose_time_ns"]),
        (&json!(-0.1), &json!("0"))
    );
    assert_eq!(mounted["pose_covariance"], json!([]));
    let metrics = rig.get("/metrics").await;
    assert!(metrics.text().contains("roundel_camera_placed{camera=\"south side\"} 0\n"));

    place(0, CameraPoseState::fixed(PoseStatus::Found, placement(1.0, 0.0)));
    let time = Some(Timestamp::from_ns(1_700_000_000_123_456_789));
    let placement = Some(placement(4.0, 1e-6));
    let status = PoseStatus::Riding;
    place(1, CameraPoseState { status, placement, time, reason: String::new() });
    let [fixed, mounted] = cameras(&rig).await;
    assert_eq!((&fixed["pose_status"], &fixed["pose_time_ns"]), (&json!("found"), &json!("0")));
    assert_eq!((&fixed["pose"]["position"]["x"], &fixed["pose_reason"]), (&json!(1.0), &json!("")));
    assert_eq!(mounted["pose_status"], "riding");
    assert_eq!(mounted["pose_time_ns"], "1700000000123456789");
    let covariance: Vec<f64> = serde_json::from_value(mounted["pose_covariance"].clone()).unwrap();
    assert_eq!((covariance.len(), covariance[0], covariance[1]), (21, 1e-6, 0.0));
    let metrics = rig.get("/metrics").await;
    assert!(metrics.text().contains("roundel_camera_placed{camera=\"south side\"} 1\n"));
    rig.stop().await;
}

#[tokio::test]
async fn gained_and_lost_poses_are_events() {
    let rig = Rig::start_with(hub_with_mounted_camera(), ApiLimits::default(), "127.0.0.1:0").await;
    for kind in [EventKind::CameraPlaced, EventKind::CameraUnplaced] {
        rig.hub.publish_camera_event(rig.clock.now(), kind, CameraId(1), "so it is".into());
    }
    let events = rig.get("/api/v1/events?backlog=5").await.json();
    let reported = [0, 1].map(|index| {
        let event = &events["events"][index];
        (event["kind"].clone(), event["camera"].clone(), event["object_id"].clone())
    });
    let of_camera = |kind: &str| (json!(kind), json!("south side"), json!(0));
    assert_eq!(reported, [of_camera("camera_placed"), of_camera("camera_unplaced")]);
    rig.stop().await;
}
