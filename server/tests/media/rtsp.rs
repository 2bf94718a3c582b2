//! `rtsp://…` sources: capture times, restarts, stalls and error messages.

use std::{
    thread,
    time::{Duration, Instant},
};

use roundel_core::frame::Frame;
use roundel_server::{
    capture::source::{FrameSource, OpenSource, SourceError},
    model::capture_clock::TimeBase,
};

use super::{
    SIZE, TIMEOUT, failure, open, open_again, opener, rtsp_server::RtspServer, run_exclusively,
};

const BLOCKS: usize = 16;

/// Reads the frame number that is drawn into a picture of [`SIZE`].
pub fn number(frame: &Frame<'_>) -> u64 {
    let row = frame.row(frame.height() / 2);
    let block = frame.width() / BLOCKS;
    (0..BLOCKS).fold(0, |number, at| number << 1 | u64::from(row[at * block + block / 2] > 125))
}

fn arguments(encoder: &str) -> [String; 3] {
    [encoder.to_owned(), SIZE.0.to_string(), SIZE.1.to_string()]
}

pub fn start(test: &str, encoder: &str) -> Option<RtspServer> {
    let arguments = arguments(encoder);
    RtspServer::start(test, &arguments.each_ref().map(String::as_str))
}

/// For each codec and transport, no frame is lost uncounted, and times are correct after the first sender report.
#[test]
fn capture_times_come_from_sender_reports() {
    let _guard = run_exclusively();
    for encoder in ["jpeg", "h264", "h265"] {
        let Some(camera) = start("capture_times_come_from_sender_reports", encoder) else { return };
        for transport in ["tcp", "udp"] {
            camera.forget_times();
            let (mut source, _) = open(&format!("{}#transport={transport}&stall=30", camera.url()));
            let begun = Instant::now();
            let mut errors_ms: Vec<f64> = Vec::new();
            let (mut numbers, mut skipped) = (Vec::new(), 0);
            while errors_ms.len() < 60 {
                assert!(begun.elapsed() < TIMEOUT, "{encoder} {transport}: {errors_ms:?}");
                let lent = source.next_frame().unwrap();
                let number = number(&lent.frame);
                numbers.push(number);
                skipped += lent.info.skipped;
                if lent.info.clock.base != TimeBase::Synchronized {
                    continue;
                }
                if let Some(truth) = camera.taken_ns(number) {
                    errors_ms.push((lent.info.capture_time.as_ns() - truth) as f64 * 1e-6);
                }
            }
            assert!(numbers.is_sorted_by(|a, b| a < b), "{encoder} {transport}: {numbers:?}");
            let sent = numbers[numbers.len() - 1] - numbers[0] + 1;
            let received = numbers.len() as u64 + skipped;
            println!("{encoder} {transport}: {received} of {sent} frames received");
            errors_ms.sort_by(f64::total_cmp);
            println!(
                "{encoder} {transport}: off by {:.2} ms median, {:.2} to {:.2}",
                errors_ms[30], errors_ms[0], errors_ms[59]
            );
            // The server's own stamps can be late on a busy machine.
            assert!(
                errors_ms[3] > -5.0 && errors_ms[45] < 5.0,
                "{encoder} {transport}: {errors_ms:?}"
            );
        }
    }
}

fn failed(result: Result<(), SourceError>) -> String {
    match result {
        Err(SourceError::Failed(message)) => message,
        other => panic!("{other:?}"),
    }
}

/// Reads frames until the source fails, and returns its error.
fn until_the_end(source: &mut dyn FrameSource) -> String {
    let begun = Instant::now();
    while begun.elapsed() < TIMEOUT {
        if let Err(error) = source.next_frame() {
            return failed(Err(error));
        }
    }
    panic!("the source does not end");
}

#[test]
fn recovers_when_a_camera_restarts() {
    let _guard = run_exclusively();
    const NAME: &str = "recovers_when_a_camera_restarts";
    let Some(camera) = start(NAME, "jpeg") else { return };
    let (mut opener, _) = opener(&camera.url(), SIZE);
    let mut source = opener.open().unwrap();
    assert_eq!(source.next_frame().unwrap().frame.width(), SIZE.0);
    let port = camera.port.to_string();
    drop(camera);
    let message = until_the_end(&mut *source);
    assert!(message.starts_with(&format!("rtsp://127.0.0.1:{port}/stream: ")), "{message}");
    drop(source);
    let unreachable = match opener.open() {
        Ok(mut source) => until_the_end(&mut *source),
        Err(error) => failed(Err(error)),
    };
    assert!(unreachable.contains("nothing listens there; check host and port"), "{unreachable}");

    let mut again = arguments("jpeg").to_vec();
    again.push(port);
    let again: Vec<&str> = again.iter().map(String::as_str).collect();
    let _camera = RtspServer::start(NAME, &again).unwrap();
    let mut source = open_again(&mut opener);
    for _ in 0..5 {
        source.next_frame().unwrap();
    }
}

#[test]
fn detects_a_stall_within_a_second() {
    let _guard = run_exclusively();
    let Some(camera) = start("detects_a_stall_within_a_second", "jpeg") else { return };
    let (mut source, _) = open(&camera.url());
    for _ in 0..5 {
        source.next_frame().unwrap();
    }
    camera.freeze();
    let message = until_the_end(&mut *source);
    camera.thaw();
    assert!(message.contains("stalled: no picture for 1.0 s"), "{message}");
    drop(source);
    let (mut source, _) = open(&camera.url());
    source.next_frame().unwrap();
}

/// For both transports; GStreamer's own UDP timeout must not apply.
#[test]
fn waits_for_a_pause_shorter_than_the_stall() {
    let _guard = run_exclusively();
    let Some(camera) = start("waits_for_a_pause_shorter_than_the_stall", "jpeg") else {
        return;
    };
    for transport in ["tcp", "udp"] {
        let (mut source, _) = open(&format!("{}#transport={transport}&stall=30", camera.url()));
        for _ in 0..5 {
            source.next_frame().unwrap();
        }
        camera.freeze();
        thread::sleep(Duration::from_secs(3));
        camera.thaw();
        for _ in 0..50 {
            source.next_frame().unwrap();
        }
    }
}

#[test]
fn rejects_wrong_paths_and_sizes() {
    let _guard = run_exclusively();
    let Some(camera) = start("rejects_wrong_paths_and_sizes", "jpeg") else { return };
    let missing = failure(&format!("rtsp://127.0.0.1:{}/other", camera.port), SIZE);
    assert!(missing.contains("the camera has no such path"), "{missing}");
    let size = failure(&camera.url(), (640, 480));
    let expected = "expected an image of 640 x 480 pixels as the camera file says, found 320 x 64";
    assert!(size.contains(expected), "{size}");
}
