//! Nodes whose link is cut, whose server is started anew, whose camera fails: nothing is counted twice, and what is
//! lost is known.

use std::time::Duration;

use roundel_core::{
    id::CameraId,
    rigid::{Covariance6, Rigid},
    world::{CameraPlacement, FusionCounts},
};
use roundel_server::{
    app::serve::node::NodeReport,
    capture::worker::{PoseSource, calibration_update::CalibrationUpdate},
    model::hub::{CameraState, CameraStatus, EventKind, PoseStatus},
};
use tokio::time::sleep;

use crate::{
    proxy::Proxy,
    rig::{Fed, Rig, come_about},
};

const INTERVAL: Duration = Duration::from_millis(20);

/// Each frame of a node was taken by the server or dropped by the node.
fn adds_up(report: &NodeReport) {
    let pushed = &report.pushed;
    assert_eq!(pushed.captured, report.frames, "{report:#?}");
    assert_eq!(pushed.captured, pushed.acknowledged + pushed.dropped, "{report:#?}");
    assert_eq!(pushed.waiting, 0, "{report:#?}");
}

/// What became of detections in fusion's table: it adds up to all that were handed to it. What was gated began a track of
/// its own, or was contradicted.
fn detections_by_fate(counts: &FusionCounts) -> u64 {
    let FusionCounts { used, late, duplicate, jumped, no_camera_pose, held, .. } = *counts;
    let FusionCounts { of_carriers, of_landmarks, no_pose, invalid, contradicted, .. } = *counts;
    let FusionCounts { over_max_objects, joined, left_out, .. } = *counts;
    let taken = [used, joined, left_out, of_carriers, of_landmarks];
    let refused = [late, duplicate, jumped, no_camera_pose, held, no_pose, invalid];
    let in_the_end = [contradicted, over_max_objects];
    taken.iter().chain(&refused).chain(&in_the_end).sum()
}

/// Two nodes; the link of the first is cut for more than 10 s, twice as long as anything here waits for an answer.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_outlives_a_cut_link_and_the_counts_add_up() {
    let rig = Rig::start().await;
    let proxy = Proxy::to(rig.server.local_addr()).await;
    let (north, south) =
        (Fed::start("north", &proxy.url(), INTERVAL), Fed::start("south", &rig.url(), INTERVAL));
    for node in [&north, &south] {
        node.connected().await;
        node.switch.set(true);
    }
    rig.until("frames of north", 0, |state| state.frames > 20).await;

    proxy.set_cut(true);
    let failed = rig.until("a stall", 0, |state| state.status == CameraStatus::Failed).await;
    assert!(failed.error.contains("nothing from node roundel"), "{}", failed.error);
    assert!(failed.error.contains("the network between is cut"), "{}", failed.error);
    let before = north.report();
    sleep(Duration::from_secs(11)).await;
    let during = north.report();
    assert!(!during.pushed.connected, "{during:#?}");
    assert!(during.pushed.error.contains("check the address"), "{}", during.pushed.error);
    assert!(during.frames > before.frames + 300, "it goes on searching: {during:#?}");
    assert!(during.pushed.waiting < 100, "what nobody could use is not kept: {during:#?}");
    assert!(during.pushed.dropped > 250, "{during:#?}");
    assert_eq!(rig.camera(1).status, CameraStatus::Running, "the other one is not disturbed");

    proxy.set_cut(false);
    let frames = rig.camera(0).frames;
    // What was on its way through the cut may come first, over the old connection.
    north.connected().await;
    rig.until("frames after the cut", 0, |state| {
        let knows_clock = state.link.as_ref().is_some_and(|link| link.clock_deviation_ms > 0.0);
        state.frames > frames + 120 && state.status == CameraStatus::Running && knows_clock
    })
    .await;
    let reports = [north, south].map(|fed| {
        fed.switch.set(false);
        fed.node.shutdown()
    });
    let [north, south] = reports;
    let (north, south) = (north.await.remove(0), south.await.remove(0));
    adds_up(&north);
    adds_up(&south);
    assert!(
        north.pushed.connections >= 2 && south.pushed.connections == 1,
        "{north:#?} {south:#?}"
    );
    assert_eq!(south.pushed.dropped, 0, "{south:#?}");

    // The server's side of it. Handing over and fusing take a moment.
    let sent = north.pushed.acknowledged + south.pushed.acknowledged;
    let counts = || rig.server.hub().fusion_counts();
    come_about("all in fusion", || Some(()).filter(|()| counts().frames >= sent), counts).await;
    let gone = |state: &CameraState| {
        let link = state.link.as_ref();
        link.is_some_and(|link| !link.connected && state.dropped == link.missing)
    };
    let states = [rig.until("the end", 0, gone).await, rig.until("the end", 1, gone).await];
    for (state, report) in states.iter().zip([&north, &south]) {
        let link = state.link.clone().unwrap();
        assert_eq!(link.received, report.pushed.acknowledged, "{link:?} {report:#?}");
        assert_eq!(link.missing, report.pushed.dropped, "{link:?} {report:#?}");
        assert_eq!(state.frames, link.received, "{link:?}");
        assert!(link.clock_deviation_ms > 0.0 && link.round_trip_ms > 0.0, "{link:?}");
    }
    // One for each time that it was gone after it had given frames; the wait for the first ones is none.
    let restarts = [states[0].restarts, states[1].restarts];
    assert!((1..=2).contains(&restarts[0]) && restarts[1] == 0, "{restarts:?}");
    let counts = counts();
    // sent = taken (used, or late) + dropped, exactly; each frame holds one roundel.
    assert_eq!(counts.frames, sent, "{counts:#?}");
    assert_eq!(counts.duplicate_frames + counts.jumped_frames, 0, "{counts:#?}");
    assert_eq!(counts.detections, sent, "{counts:#?}");
    assert_eq!(detections_by_fate(&counts), sent, "{counts:#?}");
    let captured = north.pushed.captured + south.pushed.captured;
    let dropped = north.pushed.dropped + south.pushed.dropped;
    assert_eq!(captured, counts.frames + dropped);
    println!(
        "captured {captured}: in time {}, late {}, dropped {dropped}; twice on the way {}",
        counts.frames - counts.late_frames,
        counts.late_frames,
        states[0].link.as_ref().unwrap().repeated
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_goes_on_with_a_server_that_was_started_anew() {
    let rig = Rig::start().await;
    let address = rig.server.local_addr().to_string();
    let fed = Fed::start("north", &rig.url(), INTERVAL);
    fed.connected().await;
    fed.switch.set(true);
    rig.until("frames", 0, |state| state.frames > 20).await;
    rig.server.shutdown().await;
    let lost = || Some(fed.report()).filter(|report| !report.pushed.connected);
    let lost = come_about("the loss", lost, || fed.report()).await;
    assert!(!lost.pushed.refused, "{lost:#?}");

    let rig = Rig::start_at(&address).await;
    let state = rig.until("frames", 0, |state| state.frames > 20).await;
    assert_eq!(state.link.unwrap().repeated, 0);
    fed.switch.set(false);
    let report = fed.node.shutdown().await.remove(0);
    adds_up(&report);
    let link = rig.camera(0).link.unwrap();
    assert!(link.received < report.pushed.acknowledged, "the old server took some: {link:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn why_a_nodes_camera_is_down_is_told_at_the_server() {
    let rig = Rig::start().await;
    let state = rig.until("a failure", 0, |state| state.status == CameraStatus::Failed).await;
    assert!(
        state.error.contains("start `roundel node` with a camera of this name"),
        "{}",
        state.error
    );
    let fed = Fed::start("north", &rig.url(), INTERVAL);
    // Off from the start.
    let told = "at node roundel: unplugged: plug it in";
    rig.until("the reason", 0, |state| state.error == told).await;
    fed.switch.set(true);
    rig.until("frames", 0, |state| state.status == CameraStatus::Running).await;
    fed.switch.set(false);
    rig.until("the reason", 0, |state| state.error == told).await;
    let report = fed.node.shutdown().await.remove(0);
    adds_up(&report);
    let state = rig.until("the end", 0, |state| state.error.contains("has gone")).await;
    assert!(state.error.contains("node roundel (127.0.0.1:"), "{}", state.error);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_camera_that_gives_fewer_frames_than_promised_is_told() {
    let rig = Rig::start_promised("127.0.0.1:0", Some(200.0)).await;
    let fed = Fed::start("north", &rig.url(), INTERVAL);
    fed.switch.set(true);
    let state = rig.until("the lie", 0, |state| !state.rate_reason.is_empty()).await;
    assert!(state.rate_reason.contains("frames a second where 200.0 were promised"), "{state:#?}");
    assert_eq!(state.status, CameraStatus::Running, "it is used all the same");
    let client = roundel_client::Client::connect(&rig.url()).await.unwrap();
    let cameras = client.cameras().await.unwrap();
    assert_eq!((cameras[0].promised_rate_hz, &cameras[0].rate_reason), (200.0, &state.rate_reason));
    let (events, _) = rig.server.hub().events(100);
    let told = events.iter().filter(|event| event.kind == EventKind::CameraRateOff(CameraId(0)));
    let messages: Vec<&str> = told.map(|event| event.message.as_str()).collect();
    assert_eq!(messages, [format!("Camera north {}.", state.rate_reason)]);
    fed.node.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_calibration_reaches_the_node_between_two_frames() {
    let rig = Rig::start().await;
    let fed = Fed::start("north", &rig.url(), INTERVAL);
    fed.connected().await;
    fed.switch.set(true);
    let state = rig.until("frames", 0, |state| state.frames > 5).await;
    let mut seen = rig.server.hub().observations();
    let longer = roundel_core::camera::Intrinsics {
        fx_px: 330.0,
        fy_px: 330.0,
        ..state.camera.unwrap().intrinsics().clone()
    };
    let placement = CameraPlacement {
        world_from_camera: Rigid::translation(0.0, 0.0, 3.0),
        covariance: Covariance6::zeros(),
    };
    let lens = roundel_core::camera::Camera::new(longer).unwrap();
    rig.server.calibrator().mailbox(CameraId(0)).put(CalibrationUpdate {
        lens,
        pose: PoseSource::Fixed(PoseStatus::Calibrated, Box::new(placement)),
        version: 7,
    });
    let depth_m = |version| {
        let mut depth_m = None;
        while let Ok(frame) = seen.try_recv() {
            if frame.calibration_version == version {
                depth_m =
                    frame.detections.first().and_then(|it| Some(it.pose.as_ref()?.position_m.z));
            }
        }
        depth_m
    };
    let mut depth_m = depth_m;
    let new_m = come_about("poses by the new lens", || depth_m(7), || rig.camera(0)).await;
    // 330 px focal length, 160 mm over 40 px.
    assert!((new_m - 330.0 * 0.16 / 40.0).abs() < 0.02, "{new_m} m");
    let state = rig.camera(0);
    assert_eq!((state.pose.status, state.calibration_version), (PoseStatus::Calibrated, 7));
    fed.node.shutdown().await;
}
