//! `http://…` sources: MJPEG streams and JPEG snapshots.

use std::{
    io::Write,
    net::TcpStream,
    sync::{Arc, Mutex},
    thread::sleep,
    time::Duration,
};

use roundel_core::{id::CameraId, world::FrameObservations};
use roundel_server::model::{
    capture_clock::TimeBase,
    hub::{CameraStatus, EventKind},
};
use tokio::{sync::broadcast::error::RecvError, time::timeout};

use super::{
    fake_camera::{FakeCamera, STREAM, jpeg, part},
    rig::{Rig, SIZE, TIMEOUT, running},
};

const INTERVAL: Duration = Duration::from_millis(20);

/// Streams pictures until the client disconnects.
fn stream(socket: &mut TcpStream) -> std::io::Result<()> {
    socket.write_all(STREAM.as_bytes())?;
    let picture = part(&jpeg(SIZE, 90), "");
    loop {
        socket.write_all(&picture)?;
        sleep(INTERVAL);
    }
}

fn url(camera: &FakeCamera) -> String {
    format!("http://{}/stream", camera.address())
}

/// A response that is not a stream.
fn plain(head: &str, body: &[u8]) -> Vec<u8> {
    let head = head.replace('\n', "\r\n");
    [format!("HTTP/1.1 {head}\r\nContent-Length: {}\r\n\r\n", body.len()).as_bytes(), body].concat()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn counts_every_frame_of_a_stream() {
    let camera = FakeCamera::start(|number, request, socket| {
        assert!(request.starts_with("GET /stream?res=9 HTTP/1.1\r\n"), "{request}");
        if number > 0 {
            return Ok(());
        }
        socket.write_all(STREAM.as_bytes())?;
        for level in 0..40 {
            socket.write_all(&part(&jpeg(SIZE, 2 * level), ""))?;
            sleep(INTERVAL);
        }
        Ok(())
    });
    let rig = Rig::start(&format!("{}?res=9", url(&camera))).await;
    let state = rig.until("all frames", |state| state.frames + state.dropped == 40).await;
    assert_eq!((state.width, state.height, state.broken), (64, 48, 0));
    let clock = state.capture_clock.unwrap();
    assert_eq!((clock.base, clock.deviation_s), (TimeBase::Arrival, 0.05));
    assert!(state.decode_ms > 0.0);
    let message = rig.failure().await;
    assert!(message.contains("ended the stream") || message.contains("closed"), "{message}");
    rig.server.shutdown().await;
}

/// Collects this number of observations.
async fn observations(rig: &Rig, count: usize) -> Vec<Arc<FrameObservations>> {
    let mut receiver = rig.server.hub().observations();
    let mut seen = Vec::new();
    let collect = async {
        while seen.len() < count {
            match receiver.recv().await {
                Ok(frame) => seen.push(frame),
                Err(RecvError::Lagged(_)) => {}
                Err(error) => panic!("{error}"),
            }
        }
    };
    timeout(TIMEOUT, collect).await.expect("no observations");
    seen
}

/// The camera's time stamps are 40 ms apart, however late its frames arrive.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn camera_time_stamps_remove_the_jitter() {
    let camera = FakeCamera::start(|_, _, socket| {
        socket.write_all(STREAM.as_bytes())?;
        let begun = std::time::Instant::now();
        for frame in 0..u32::MAX {
            // Sends three of four frames late, by up to 30 ms.
            let due = INTERVAL * 2 * frame + Duration::from_millis(u64::from(frame % 4 * 10));
            sleep(due.saturating_sub(begun.elapsed()));
            let stamp_s = 7.5 + f64::from(frame) * 0.04;
            socket.write_all(&part(&jpeg(SIZE, 90), &format!("X-Timestamp: {stamp_s:.6}\r\n")))?;
        }
        Ok(())
    });
    let rig = Rig::start(&url(&camera)).await;
    let seen = observations(&rig, 60).await;
    // Dropped frames leave gaps of whole intervals, which are subtracted.
    let times: Vec<i64> = seen[8..].iter().map(|it| it.capture_time.as_ns()).collect();
    let off = times.windows(2).map(|pair| {
        let rest = (pair[1] - pair[0]).rem_euclid(40_000_000);
        rest.min(40_000_000 - rest)
    });
    let mut off: Vec<i64> = off.collect();
    off.sort_unstable();
    assert!(off[off.len() / 2] < 1_000_000, "{off:?}");
    let state = rig.until("running", running).await;
    assert_eq!(state.capture_clock.unwrap().base, TimeBase::Camera);
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn recovers_when_a_camera_restarts() {
    let camera = FakeCamera::start(|_, _, socket| stream(socket));
    let address = camera.address();
    let rig = Rig::start(&url(&camera)).await;
    rig.until("running", |state| running(state) && state.frames > 5).await;
    drop(camera);
    let failed = rig.until("failure", |state| state.restarts > 0).await;
    assert_eq!(failed.status, CameraStatus::Failed);
    let unreachable =
        rig.until("an unreachable camera", |state| state.error.contains("cannot reach")).await;
    assert!(unreachable.error.contains(&address.to_string()), "{}", unreachable.error);
    assert!(unreachable.error.contains("nothing listens on that port"), "{}", unreachable.error);

    let _camera = FakeCamera::start_at(address, |_, _, socket| stream(socket));
    let back =
        rig.until("recovery", |state| running(state) && state.frames > failed.frames + 5).await;
    assert_eq!(back.error, "");
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn detects_a_stall_and_reconnects() {
    let camera = FakeCamera::start(|number, _, socket| {
        if number > 0 {
            return stream(socket);
        }
        socket.write_all(STREAM.as_bytes())?;
        for _ in 0..5 {
            socket.write_all(&part(&jpeg(SIZE, 90), ""))?;
            sleep(INTERVAL);
        }
        // Half a picture, then no data on an open connection.
        socket.write_all(&part(&jpeg(SIZE, 90), "")[..300])?;
        sleep(Duration::from_secs(8));
        Ok(())
    });
    let rig = Rig::start(&url(&camera)).await;
    let message = rig.failure().await;
    assert_eq!(
        message,
        "stalled: no picture for 1.0 s; the received data contain no complete JPEG"
    );
    let back = rig.until("recovery", |state| running(state) && state.restarts == 1).await;
    assert_eq!(back.error, "");
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn corrupted_pictures_are_counted_and_skipped() {
    let camera = FakeCamera::start(|_, _, socket| {
        socket.write_all(STREAM.as_bytes())?;
        let good = jpeg(SIZE, 90);
        let noise: Vec<u8> =
            (0..5000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 16) as u8).collect();
        // Complete by its markers, but with damaged image data.
        let mut damaged = good.clone();
        let end = damaged.len();
        damaged.truncate(end - 12);
        damaged.extend([0xFF, 0xD9]);
        loop {
            for bad in [&noise[..], &good[..good.len() / 2], &damaged] {
                socket.write_all(&part(&good, ""))?;
                sleep(INTERVAL);
                socket.write_all(&part(bad, ""))?;
                sleep(INTERVAL);
            }
        }
    });
    let rig = Rig::start(&url(&camera)).await;
    let state = rig.until("frames", |state| state.frames > 30 && state.broken > 15).await;
    assert_eq!((state.status, state.restarts), (CameraStatus::Running, 0));
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn polls_a_camera_that_serves_single_pictures() {
    let picture = jpeg(SIZE, 90);
    let camera = FakeCamera::start(move |_, _, socket| {
        socket.write_all(&plain("200 OK\nContent-Type: image/jpeg", &picture))
    });
    let rig = Rig::start(&format!("{}#fps=50", url(&camera))).await;
    let state = rig.until("frames", |state| state.frames > 20).await;
    assert!(camera.served() >= 20, "{}", camera.served());
    assert_eq!((state.restarts, state.broken), (0, 0));
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn credentials_are_sent_and_not_shown() {
    let received = Arc::new(Mutex::new(String::new()));
    let camera = FakeCamera::start({
        let received = received.clone();
        move |_, request, socket| {
            request.clone_into(&mut received.lock().unwrap());
            if request.contains("authorization: Basic bGFiOmdlaGVpbQ==") {
                return stream(socket);
            }
            socket.write_all(&plain("401 Unauthorized\nWWW-Authenticate: Basic realm=\"cam\"", b""))
        }
    });
    let address = camera.address();
    let rig = Rig::start(&format!("http://lab:geh%65im@{address}/stream")).await;
    rig.until("frames", |state| state.frames > 3).await;
    let shown = rig.server.hub().installation().cameras[&CameraId(0)].source.clone();
    assert_eq!(shown, format!("http://{address}/stream"));
    rig.server.shutdown().await;
    assert!(received.lock().unwrap().starts_with("GET /stream HTTP/1.1"));

    let rig = Rig::start(&format!("http://lab:secret@{address}/stream")).await;
    let wrong = rig.failure().await;
    let expected = "answers 401 Unauthorized: user or password is wrong";
    assert_eq!(wrong, format!("http://{address}/stream {expected}"));
    rig.server.shutdown().await;
}

/// Each kind of wrong response, and its error message.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn wrong_responses_give_errors_with_a_remedy() {
    let small = jpeg((32, 24), 90);
    let page = b"<html>IP Camera</html>".to_vec();
    let cases: Vec<(Vec<u8>, &str)> = vec![
        (plain("404 Not Found", b""), "/stream answers 404 Not Found: it has no such path;"),
        (
            plain("401 Unauthorized\nWWW-Authenticate: Basic", b""),
            "requires a user and a password, as in http://USER:PASSWORD@",
        ),
        (
            plain("401 Unauthorized\nWWW-Authenticate: Digest qop=auth", b""),
            "requires Digest authentication",
        ),
        (plain("503 Service Unavailable", b""), "one viewer at a time"),
        (plain("500 Internal Server Error", b""), "the camera has an internal error"),
        (
            plain("302 Found\nLocation: /video", b""),
            "/stream redirects to `/video` (302 Found): redirects are not followed",
        ),
        (
            plain("200 OK\nContent-Type: text/html", &page),
            "expected multipart/x-mixed-replace or image/jpeg, found text/html: this is a web page",
        ),
        (
            plain("200 OK\nContent-Type: video/mp4", b"...."),
            "found video/mp4: set the camera to MJPEG",
        ),
        (
            plain("200 OK\nContent-Type: image/jpeg", &small),
            "/stream: expected an image of 64 x 48 pixels as the camera file says, found 32 x 24",
        ),
        (
            [STREAM.as_bytes(), &part(&small, "")].concat(),
            "expected an image of 64 x 48 pixels as the camera file says, found 32 x 24",
        ),
        (b"220 mail.example.org ESMTP\r\n\r\n".to_vec(), "does not speak HTTP"),
        (Vec::new(), "closed the connection"),
    ];
    for (answer, expected) in cases {
        let camera = FakeCamera::start(move |_, _, socket| socket.write_all(&answer));
        let rig = Rig::start(&url(&camera)).await;
        let message = rig.failure().await;
        assert!(message.contains(expected), "expected {expected:?}, found {message:?}");
        let events = rig.events(EventKind::CameraFailed);
        assert!(events[0].contains(expected), "the event: {events:?}");
        rig.server.shutdown().await;
    }
}
