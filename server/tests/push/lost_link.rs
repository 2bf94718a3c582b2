//! Nodes with a cut link, a restarted server or a failing camera: no frame is counted twice, and every loss is counted.

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

use super::{
    cuttable_proxy::Proxy,
    rig::{Rig, TestNode, wait_for},
};

const INTERVAL: Duration = Duration::from_millis(20);

/// Checks that the server acknowledged each frame of a node, or the node dropped it.
fn assert_counts_add_up(report: &NodeReport) {
    let pushed = &report.pushed;
    assert_eq!(pushed.captured, report.frames, "{report:#?}");
    assert_eq!(pushed.captured, pushed.acknowledged + pushed.dropped, "{report:#?}");
    assert_eq!(pushed.waiting, 0, "{report:#?}");
}

/// The sum of detections over all outcomes, which must equal the number handed to fusion. A gated detection starts a
/// new track or is contradicted.
fn sum_of_outcomes(counts: &FusionCounts) -> u64 {
    let FusionCounts { used, late, duplicate, jumped, no_camera_pose, held, .. } = *counts;
    let FusionCounts {
        carrier_detections,
        landmark_detections,
        no_pose,
        invalid,
        contradicted,
        ..
    } = *counts;
    let FusionCounts { outranked, over_max_objects, joined, left_out, .. } = *counts;
    let accepted = [used, joined, left_out, carrier_detections, landmark_detections];
    let rejected = [late, duplicate, jumped, no_camera_pose, held, no_pose, invalid];
    let removed_later = [contradicted, outranked, over_max_objects];
    accepted.iter().chain(&rejected).chain(&removed_later).sum()
}

/// Two nodes; the link of the first is cut for more than 10 s, twice the longest timeout involved.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_survives_a_cut_link_and_the_counts_add_up() {
    let rig = Rig::start().await;
    let proxy = Proxy::to(rig.server.local_addr()).await;
    let (north, south) = (
        TestNode::start("north", &proxy.url(), INTERVAL),
        TestNode::start("south", &rig.url(), INTERVAL),
    );
    for node in [&north, &south] {
        node.connected().await;
        node.switch.set(true);
    }
    rig.until("frames of north", 0, |state| state.frames > 20).await;

    proxy.set_cut(true);
    let failed = rig.until("a stall", 0, |state| state.status == CameraStatus::Failed).await;
    assert!(failed.error.contains("nothing from node roundel"), "{}", failed.error);
    assert!(failed.error.contains("the network is interrupted"), "{}", failed.error);
    let before = north.report();
    sleep(Duration::from_secs(11)).await;
    let during = north.report();
    assert!(!during.pushed.connected, "{during:#?}");
    assert!(during.pushed.error.contains("check the address"), "{}", during.pushed.error);
    assert!(during.frames > before.frames + 300, "detection must continue: {during:#?}");
    assert!(during.pushed.waiting < 100, "outdated frames must not be kept: {during:#?}");
    assert!(during.pushed.dropped > 250, "{during:#?}");
    assert_eq!(
        rig.camera(1).status,
        CameraStatus::Running,
        "the other camera must not be disturbed"
    );

    proxy.set_cut(false);
    let frames = rig.camera(0).frames;
    // Data delayed by the cut may arrive first, over the old connection.
    north.connected().await;
    rig.until("frames after the cut", 0, |state| {
        let knows_clock = state.link.as_ref().is_some_and(|link| link.clock_deviation_ms > 0.0);
        state.frames > frames + 120 && state.status == CameraStatus::Running && knows_clock
    })
    .await;
    let reports = [north, south].map(|sender| {
        sender.switch.set(false);
        sender.node.shutdown()
    });
    let [north, south] = reports;
    let (north, south) = (north.await.remove(0), south.await.remove(0));
    assert_counts_add_up(&north);
    assert_counts_add_up(&south);
    assert!(
        north.pushed.connections >= 2 && south.pushed.connections == 1,
        "{north:#?} {south:#?}"
    );
    assert_eq!(south.pushed.dropped, 0, "{south:#?}");

    // Compares the server's counts, as soon as fusion has processed everything.
    let sent = north.pushed.acknowledged + south.pushed.acknowledged;
    let counts = || rig.server.hub().fusion_counts();
    wait_for("all frames in fusion", || Some(()).filter(|()| counts().frames >= sent), counts)
        .await;
    let is_disconnected = |state: &CameraState| {
        let link = state.link.as_ref();
        link.is_some_and(|link| !link.connected && state.dropped == link.missing)
    };
    let states = [
        rig.until("the end", 0, is_disconnected).await,
        rig.until("the end", 1, is_disconnected).await,
    ];
    for (state, report) in states.iter().zip([&north, &south]) {
        let link = state.link.clone().unwrap();
        assert_eq!(link.received, report.pushed.acknowledged, "{link:?} {report:#?}");
        assert_eq!(link.missing, report.pushed.dropped, "{link:?} {report:#?}");
        assert_eq!(state.frames, link.received, "{link:?}");
        assert!(link.clock_deviation_ms > 0.0 && link.round_trip_ms > 0.0, "{link:?}");
    }
    // Each loss after the first frames counts as a restart; the initial wait does not.
    let restarts = [states[0].restarts, states[1].restarts];
    assert!((1..=2).contains(&restarts[0]) && restarts[1] == 0, "{restarts:?}");
    let counts = counts();
    // sent = used or late + dropped, exactly; each frame contains one roundel.
    assert_eq!(counts.frames, sent, "{counts:#?}");
    assert_eq!(counts.duplicate_frames + counts.jumped_frames, 0, "{counts:#?}");
    assert_eq!(counts.detections, sent, "{counts:#?}");
    assert_eq!(sum_of_outcomes(&counts), sent, "{counts:#?}");
    let captured = north.pushed.captured + south.pushed.captured;
    let dropped = north.pushed.dropped + south.pushed.dropped;
    assert_eq!(captured, counts.frames + dropped);
    println!(
        "captured {captured}: in time {}, late {}, dropped {dropped}; sent twice {}",
        counts.frames - counts.late_frames,
        counts.late_frames,
        states[0].link.as_ref().unwrap().repeated
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_continues_with_a_restarted_server() {
    let rig = Rig::start().await;
    let address = rig.server.local_addr().to_string();
    let sender = TestNode::start("north", &rig.url(), INTERVAL);
    sender.connected().await;
    sender.switch.set(true);
    rig.until("frames", 0, |state| state.frames > 20).await;
    rig.server.shutdown().await;
    let lost = || Some(sender.report()).filter(|report| !report.pushed.connected);
    let lost = wait_for("the loss", lost, || sender.report()).await;
    assert!(!lost.pushed.refused, "{lost:#?}");

    let rig = Rig::start_at(&address).await;
    let state = rig.until("frames", 0, |state| state.frames > 20).await;
    assert_eq!(state.link.unwrap().repeated, 0);
    sender.switch.set(false);
    let report = sender.node.shutdown().await.remove(0);
    assert_counts_add_up(&report);
    let link = rig.camera(0).link.unwrap();
    assert!(
        link.received < report.pushed.acknowledged,
        "the old server must have received some frames: {link:?}"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_server_reports_why_a_nodes_camera_is_down() {
    let rig = Rig::start().await;
    let state = rig.until("a failure", 0, |state| state.status == CameraStatus::Failed).await;
    assert!(
        state.error.contains("start `roundel node` with a camera of this name"),
        "{}",
        state.error
    );
    let sender = TestNode::start("north", &rig.url(), INTERVAL);
    // The node's camera is off from the start.
    let error = "at node roundel: unplugged: plug it in";
    rig.until("the reason", 0, |state| state.error == error).await;
    sender.switch.set(true);
    rig.until("frames", 0, |state| state.status == CameraStatus::Running).await;
    sender.switch.set(false);
    rig.until("the reason", 0, |state| state.error == error).await;
    let report = sender.node.shutdown().await.remove(0);
    assert_counts_add_up(&report);
    let state = rig.until("the end", 0, |state| state.error.contains("has disconnected")).await;
    assert!(state.error.contains("node roundel (127.0.0.1:"), "{}", state.error);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn reports_a_camera_that_sends_fewer_frames_than_promised() {
    let rig = Rig::start_with_rate("127.0.0.1:0", Some(200.0)).await;
    let sender = TestNode::start("north", &rig.url(), INTERVAL);
    sender.switch.set(true);
    let state = rig.until("the low rate", 0, |state| !state.rate_reason.is_empty()).await;
    assert!(state.rate_reason.contains("frames a second where 200.0 were promised"), "{state:#?}");
    assert_eq!(state.status, CameraStatus::Running, "the camera must still be used");
    let client = roundel_client::Client::connect(&rig.url()).await.unwrap();
    let cameras = client.cameras().await.unwrap();
    assert_eq!((cameras[0].promised_rate_hz, &cameras[0].rate_reason), (200.0, &state.rate_reason));
    let (events, _) = rig.server.hub().events(100);
    let low_rates = events.iter().filter(|event| event.kind() == EventKind::CameraRateOff);
    let messages: Vec<&str> = low_rates.map(|event| event.message.as_str()).collect();
    assert_eq!(messages, [format!("Camera north {}.", state.rate_reason)]);
    sender.node.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_calibration_reaches_the_node_between_two_frames() {
    let rig = Rig::start().await;
    let sender = TestNode::start("north", &rig.url(), INTERVAL);
    sender.connected().await;
    sender.switch.set(true);
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
    let new_m = wait_for("poses with the new lens", || depth_m(7), || rig.camera(0)).await;
    // 160 mm appear as 40 px at 330 px focal length.
    assert!((new_m - 330.0 * 0.16 / 40.0).abs() < 0.02, "{new_m} m");
    let state = rig.camera(0);
    assert_eq!((state.pose.status, state.calibration_version), (PoseStatus::Calibrated, 7));
    sender.node.shutdown().await;
}
