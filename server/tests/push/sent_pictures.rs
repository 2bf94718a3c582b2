//! Programs that send pictures, with each kind of clock.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use jpeg_encoder::{ColorType, Encoder};
use roundel_client::{Client, Picture, PushOptions, Pusher, v1};
use roundel_server::model::{
    capture_clock::{CaptureClock, TimeBase},
    hub::CameraStatus,
};

use super::rig::{Rig, SIZE, picture, wait_for};

fn unix_ns() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_nanos() as i64
}

fn grey() -> Picture {
    Picture::Grey(picture(), [SIZE.0 as u32, SIZE.1 as u32])
}

async fn connected(pusher: &Pusher) {
    let look = || Some(()).filter(|()| pusher.status().clock_offset.is_some());
    wait_for("a connection", look, || pusher.status()).await;
}

/// Sends pictures, each after the previous one was acknowledged.
async fn send(pusher: &Pusher, pictures: usize, now_ns: impl Fn() -> i64) {
    for _ in 0..pictures {
        let jpeg = |pixels: &[u8]| {
            let mut file = Vec::new();
            let (width, height) = (SIZE.0 as u16, SIZE.1 as u16);
            Encoder::new(&mut file, 95).encode(pixels, width, height, ColorType::Luma).unwrap();
            Picture::Jpeg(file)
        };
        let even = pusher.status().captured.is_multiple_of(2);
        pusher.frame(if even { grey() } else { jpeg(&picture()) }, now_ns(), None);
        let look = || Some(()).filter(|()| pusher.status().waiting == 0);
        wait_for("an acknowledgement", look, || pusher.status()).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn detects_in_sent_pictures_and_converts_the_senders_clock() {
    const AHEAD_NS: i64 = 5_000_000_000;
    let rig = Rig::start().await;
    let client = Client::connect(&rig.url()).await.unwrap();
    // The program's clock is 5 s ahead of the server's.
    let options = PushOptions::new("north").sender("robot 7").clock(|| unix_ns() + AHEAD_NS);
    let pusher = client.push(options).unwrap();
    connected(&pusher).await;
    let mut seen = rig.server.hub().observations();
    send(&pusher, 20, || unix_ns() + AHEAD_NS).await;
    let state = rig
        .until("frames", 0, |state| state.frames >= 1 && state.frames + state.dropped >= 20)
        .await;
    assert_eq!((state.status, state.detections), (CameraStatus::Running, 1), "{state:#?}");
    assert!(state.decode_ms >= 0.0 && state.detect_ms > 0.0);
    let clock = state.capture_clock.unwrap();
    assert_eq!(clock.base, TimeBase::Driver);
    let offset = pusher.status().clock_offset.unwrap();
    let unix_of_server_ns = rig.server.clock().now().as_ns() - unix_ns();
    let error_ns = offset.offset_ns + AHEAD_NS - unix_of_server_ns;
    assert!(error_ns.abs() < 5_000_000, "{offset:?}: off by {error_ns} ns");
    while let Ok(frame) = seen.try_recv() {
        let late_s = frame.received_time.seconds_since(frame.capture_time);
        assert!((-0.005..1.0).contains(&late_s), "captured {late_s} s before it arrived");
    }
    let link = state.link.unwrap();
    assert_eq!((link.sender.as_str(), link.connected, link.repeated), ("robot 7", true, 0));
    assert!(link.address.starts_with("127.0.0.1:"), "{}", link.address);
    let cameras = client.cameras().await.unwrap();
    assert_eq!(cameras[0].link.as_ref().unwrap().sender, "robot 7");
    assert_eq!(cameras[1].link, None);
    let status = pusher.finish(Duration::from_secs(5)).await;
    assert_eq!((status.captured, status.acknowledged, status.dropped), (20, 20, 0));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn counter_times_and_missing_times_set_the_capture_clock() {
    let rig = Rig::start().await;
    let client = Client::connect(&rig.url()).await.unwrap();
    for (camera, times, expected) in [
        ("north", v1::PushTimes::Counter, CaptureClock::CAMERA),
        ("south", v1::PushTimes::Unspecified, CaptureClock::ARRIVAL),
    ] {
        let pusher = client.push(PushOptions::new(camera).times(times)).unwrap();
        // The counter starts with the program. Without a clock, the time is ignored.
        let begun = std::time::Instant::now();
        send(&pusher, 5, || begun.elapsed().as_nanos() as i64).await;
        let index = rig.server.hub().installation().camera_id(camera).unwrap().0;
        let state = rig.until("frames", index, |state| state.frames > 0).await;
        assert_eq!(state.capture_clock, Some(expected));
        assert!(state.latency_ms < 1000.0, "{}", state.latency_ms);
        pusher.finish(Duration::from_secs(5)).await;
    }
}
