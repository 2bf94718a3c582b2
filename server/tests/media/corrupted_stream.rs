//! `rtsp://…` over a connection that corrupts bytes, and from a server that is not a camera.

use std::{
    io::{Read, Write},
    net::{Shutdown, TcpListener, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use roundel_server::capture::source::{FrameSource, OpenSource, SourceError};

use super::{
    SIZE, TIMEOUT, failure, opener,
    rtsp::{number, start},
    run_exclusively,
};

/// While corruption is on, every 500th byte is changed.
const CORRUPTION_INTERVAL: usize = 500;

/// A TCP proxy that can corrupt what the camera sends.
struct CorruptingProxy {
    port: u16,
    is_corrupting: Arc<AtomicBool>,
}

impl CorruptingProxy {
    fn to(camera: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let is_corrupting = Arc::new(AtomicBool::new(false));
        let corrupting = is_corrupting.clone();
        thread::spawn(move || {
            for near in listener.incoming().map_while(Result::ok) {
                let Ok(far) = TcpStream::connect(("127.0.0.1", camera)) else { continue };
                let (near_clone, far_clone) = (near.try_clone().unwrap(), far.try_clone().unwrap());
                let corrupting = corrupting.clone();
                thread::spawn(move || pass(near, far, &AtomicBool::new(false)));
                thread::spawn(move || pass(far_clone, near_clone, &corrupting));
            }
        });
        Self { port, is_corrupting }
    }

    fn set_corrupting(&self, corrupting: bool) {
        self.is_corrupting.store(corrupting, Ordering::Release);
    }
}

fn pass(mut from: TcpStream, mut to: TcpStream, is_corrupting: &AtomicBool) {
    let (mut bytes, mut passed) = (vec![0; 4096], 0);
    while let Ok(count @ 1..) = from.read(&mut bytes) {
        let bytes = &mut bytes[..count];
        if is_corrupting.load(Ordering::Acquire) {
            let first = (CORRUPTION_INTERVAL - passed % CORRUPTION_INTERVAL) % CORRUPTION_INTERVAL;
            bytes
                .iter_mut()
                .skip(first)
                .step_by(CORRUPTION_INTERVAL)
                .for_each(|byte| *byte ^= 0x5a);
        }
        passed += count;
        if to.write_all(bytes).is_err() {
            break;
        }
    }
    let _ = to.shutdown(Shutdown::Both);
}

/// The error message of a source; `None` if it succeeds.
fn error_message<T>(outcome: Result<T, SourceError>) -> Option<String> {
    match outcome {
        Ok(_) => None,
        Err(SourceError::Failed(reason)) => Some(reason),
        // A corrupted picture header can contain another size.
        Err(error @ SourceError::Size { .. }) => Some(error.to_string()),
        Err(other) => panic!("{other:?}"),
    }
}

/// Reads frames for `length`, reopening the source when it fails; returns the number of failures.
fn read_for(
    opener: &mut dyn OpenSource,
    source: &mut Option<Box<dyn FrameSource>>,
    length: Duration,
) -> usize {
    let (begun, mut failures) = (Instant::now(), 0);
    while begun.elapsed() < length {
        let error_message = match source {
            Some(source) => error_message(source.next_frame()),
            None => error_message(opener.open().map(|opened| *source = Some(opened))),
        };
        if let Some(reason) = error_message {
            assert!(reason.contains("rtsp://127.0.0.1:"), "{reason}");
            (failures, *source) = (failures + 1, None);
        }
    }
    failures
}

/// Reads ten frames with consecutive numbers, or returns an error.
fn ten_frames(source: &mut dyn FrameSource) -> Result<(), String> {
    let mut newest = None;
    for _ in 0..10 {
        let lent = source.next_frame().map_err(|error| format!("{error:?}"))?;
        let (number, skipped) = (number(&lent.frame), lent.info.skipped);
        if newest.is_some_and(|newest| number != newest + 1 + skipped) {
            return Err(format!("{number} after {newest:?}, {skipped} skipped"));
        }
        newest = Some(number);
    }
    Ok(())
}

/// Opens the source until it delivers ten consecutive frames: on a loaded machine the camera itself drops frames.
fn open_until_stable(opener: &mut dyn OpenSource, when: &str) -> Box<dyn FrameSource> {
    let begun = Instant::now();
    loop {
        let outcome = match opener.open() {
            Ok(mut source) => ten_frames(&mut *source).map(|()| source),
            Err(error) => Err(format!("{error:?}")),
        };
        match outcome {
            Ok(source) => return source,
            Err(reason) => {
                println!("{when}: {reason}");
                assert!(begun.elapsed() < TIMEOUT, "{when}: {reason}");
            }
        }
    }
}

#[test]
fn survives_corrupted_bytes() {
    let _guard = run_exclusively();
    for encoder in ["jpeg", "h264"] {
        let Some(camera) = start("survives_corrupted_bytes", encoder) else {
            return;
        };
        let proxy = CorruptingProxy::to(camera.port);
        let (mut opener, _) = opener(&format!("rtsp://127.0.0.1:{}/stream", proxy.port), SIZE);
        let mut source = Some(open_until_stable(&mut opener, &format!("{encoder}, before")));
        proxy.set_corrupting(true);
        let failures = read_for(&mut opener, &mut source, Duration::from_secs(4));
        println!("{encoder}: reopened {failures} times");
        proxy.set_corrupting(false);
        // Drops the old connection before the next one is opened.
        if source.is_none_or(|mut source| ten_frames(&mut *source).is_err()) {
            open_until_stable(&mut opener, &format!("{encoder}, afterwards"));
        }
    }
}

#[test]
fn rejects_a_server_that_is_not_a_camera() {
    let _guard = run_exclusively();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    thread::spawn(move || {
        for mut near in listener.incoming().map_while(Result::ok) {
            let noise: Vec<u8> =
                (0..4096_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
            let _ = near.write_all(&noise);
            thread::sleep(Duration::from_millis(500));
        }
    });
    let reason = failure(&format!("rtsp://127.0.0.1:{port}/stream"), SIZE);
    assert!(reason.starts_with(&format!("rtsp://127.0.0.1:{port}/stream: ")), "{reason}");
    assert!(reason.ends_with("check the port and the network"), "{reason}");
}
