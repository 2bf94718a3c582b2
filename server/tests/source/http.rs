//! `http://…`: MJPEG and snapshots.

use std::{
    io::Write,
    net::TcpStream,
    sync::{Arc, Mutex},
    thread::sleep,
    time::Duration,
};

use roundel_core::{id::CameraId, world::FrameObservations};
use roundel_server::model::{capture_clock::TimeBase, hub::CameraStatus};
use tokio::{sync::broadcast::error::RecvError, time::timeout};

use super::{
    camera::{NetworkCamera, STREAM, jpeg, part},
    rig::{PATIENCE, Rig, SIZE, running},
};

const INTERVAL: Duration = Duration::from_millis(20);

/// Sends pictures until nobody listens.
fn stream(socket: &mut TcpStream) -> std::io::Result<()> {
    socket.write_all(STREAM.as_bytes())?;
    let picture = part(&jpeg(SIZE, 90), "");
    loop {
        socket.write_all(&picture)?;
        sleep(INTERVAL);
    }
}

fn url(camera: &NetworkCamera) -> String {
    format!("http://{}/stream", camera.address())
}

/// An answer that has one part only.
fn plain(head: &str, body: &[u8]) -> Vec<u8> {
    let head = head.replace('\n', "\r\n");
    [format!("HTTP/1.1 {head}\r\nContent-Length: {}\r\n\r\n", body.len()).as_bytes(), body].concat()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn frames_are_counted_to_the_last_one() {
    let camera = NetworkCamera::start(|number, request, socket| {
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

/// As many observations as wanted.
async fn observations(rig: &Rig, count: usize) -> Vec<Arc<FrameObservations>> {
    let mut receiver = rig.server.hub().observations();
    let mut seen = Vec::new();
    let gather = async {
        while seen.len() < count {
            match receiver.recv().await {
                Ok(frame) => seen.push(frame),
                Err(RecvError::Lagged(_)) => {}
                Err(error) => panic!("{error}"),
            }
        }
    };
    timeout(PATIENCE, gather).await.expect("no observations");
    seen
}

/// The camera's stamps are 40 ms apart, whatever happens on the way.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn stamps_of_the_camera_take_the_jitter_away() {
    let camera = NetworkCamera::start(|_, _, socket| {
        socket.write_all(STREAM.as_bytes())?;
        let begun = std::time::Instant::now();
        for frame in 0..u32::MAX {
            // Sent up to 30 ms late, but for every fourth.
            let due = INTERVAL * 2 * frame + Duration::from_millis(u64::from(frame % 4 * 10));
            sleep(due.saturating_sub(begun.elapsed()));
            let stamp_s = 7.5 + f64::from(frame) * 0.04;
            socket.write_all(&part(&jpeg(SIZE, 90), &format!("X-Timestamp: {stamp_s:.6}\r\n")))?;
        }
        Ok(())
    });
    let rig = Rig::start(&url(&camera)).await;
    let seen = observations(&rig, 60).await;
    // Frames that were dropped leave gaps of whole intervals; what is off is what the way was at its quickest.
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
async fn a_camera_that_is_killed_and_started_again_comes_back() {
    let camera = NetworkCamera::start(|_, _, socket| stream(socket));
    let address = camera.address();
    let rig = Rig::start(&url(&camera)).await;
    rig.until("running", |state| running(state) && state.frames > 5).await;
    drop(camera);
    let failed = rig.until("failure", |state| state.restarts > 0).await;
    assert_eq!(failed.status, CameraStatus::Failed);
    let refused = rig.until("refusal", |state| state.error.contains("cannot reach")).await;
    assert!(refused.error.contains(&address.to_string()), "{}", refused.error);
    assert!(refused.error.contains("nothing listens on that port"), "{}", refused.error);

    let _camera = NetworkCamera::start_at(address, |_, _, socket| stream(socket));
    let back =
        rig.until("recovery", |state| running(state) && state.frames > failed.frames + 5).await;
    assert_eq!(back.error, "");
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stall_is_noticed_and_the_connection_made_anew() {
    let camera = NetworkCamera::start(|number, _, socket| {
        if number > 0 {
            return stream(socket);
        }
        socket.write_all(STREAM.as_bytes())?;
        for _ in 0..5 {
            socket.write_all(&part(&jpeg(SIZE, 90), ""))?;
            sleep(INTERVAL);
        }
        // Half a picture, and silence on a connection that stands.
        socket.write_all(&part(&jpeg(SIZE, 90), "")[..300])?;
        sleep(Duration::from_secs(8));
        Ok(())
    });
    let rig = Rig::start(&url(&camera)).await;
    let message = rig.failure().await;
    assert_eq!(message, "stalled: no picture for 1.0 s; what comes holds no JPEG, or not its end");
    let back = rig.until("recovery", |state| running(state) && state.restarts == 1).await;
    assert_eq!(back.error, "");
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn garbage_on_the_wire_is_counted_and_survived() {
    let camera = NetworkCamera::start(|_, _, socket| {
        socket.write_all(STREAM.as_bytes())?;
        let good = jpeg(SIZE, 90);
        let noise: Vec<u8> =
            (0..5000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 16) as u8).collect();
        // Whole by its markers, but what it codes is damaged.
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
async fn single_pictures_are_asked_for_again_and_again() {
    let picture = jpeg(SIZE, 90);
    let camera = NetworkCamera::start(move |_, _, socket| {
        socket.write_all(&plain("200 OK\nContent-Type: image/jpeg", &picture))
    });
    let rig = Rig::start(&format!("{}#fps=50", url(&camera))).await;
    let state = rig.until("frames", |state| state.frames > 20).await;
    assert!(camera.served() >= 20, "{}", camera.served());
    assert_eq!((state.restarts, state.broken), (0, 0));
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn user_and_password_are_sent_and_not_shown() {
    let heard = Arc::new(Mutex::new(String::new()));
    let camera = NetworkCamera::start({
        let heard = heard.clone();
        move |_, request, socket| {
            request.clone_into(&mut heard.lock().unwrap());
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
    assert!(heard.lock().unwrap().starts_with("GET /stream HTTP/1.1"));

    let rig = Rig::start(&format!("http://lab:secret@{address}/stream")).await;
    let wrong = rig.failure().await;
    let expected = "answers 401 Unauthorized: user or password is wrong";
    assert_eq!(wrong, format!("http://{address}/stream {expected}"));
    rig.server.shutdown().await;
}

/// Each answer, and what is said about it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn wrong_answers_are_told_with_the_remedy() {
    let small = jpeg((32, 24), 90);
    let page = b"<html>IP Camera</html>".to_vec();
    let cases: Vec<(Vec<u8>, &str)> = vec![
        (plain("404 Not Found", b""), "/stream answers 404 Not Found: it has no such path;"),
        (
            plain("401 Unauthorized\nWWW-Authenticate: Basic", b""),
            "wants a user and a password: http://USER:PASSWORD@",
        ),
        (
            plain("401 Unauthorized\nWWW-Authenticate: Digest qop=auth", b""),
            "wants Digest authentication",
        ),
        (plain("503 Service Unavailable", b""), "one viewer at a time"),
        (plain("500 Internal Server Error", b""), "the camera has a fault"),
        (
            plain("302 Found\nLocation: /video", b""),
            "/stream sends to `/video` (302 Found): redirects are not followed",
        ),
        (
            plain("200 OK\nContent-Type: text/html", &page),
            "expected multipart/x-mixed-replace or image/jpeg, found text/html: this is a page for people",
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
        let camera = NetworkCamera::start(move |_, _, socket| socket.write_all(&answer));
        let rig = Rig::start(&url(&camera)).await;
        let message = rig.failure().await;
        assert!(message.contains(expected), "expected {expected:?}, found {message:?}");
        let told = rig.told(CameraStatus::Failed);
        assert!(told[0].contains(expected), "the event: {told:?}");
        rig.server.shutdown().await;
    }
}
