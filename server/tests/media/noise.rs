//! `rtsp://…` over a wire that changes bytes, and from something that is no camera.

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
    PATIENCE, SIZE, alone, failure, opener,
    rtsp::{number, start},
};

/// One byte in so many is changed.
const ONE_IN: usize = 500;

/// A wire to a camera.
struct Wire {
    port: u16,
    is_noisy: Arc<AtomicBool>,
}

impl Wire {
    fn to(camera: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let is_noisy = Arc::new(AtomicBool::new(false));
        let noisy = is_noisy.clone();
        thread::spawn(move || {
            for near in listener.incoming().map_while(Result::ok) {
                let Ok(far) = TcpStream::connect(("127.0.0.1", camera)) else { continue };
                let (near_again, far_again) = (near.try_clone().unwrap(), far.try_clone().unwrap());
                let noisy = noisy.clone();
                thread::spawn(move || pass(near, far, &AtomicBool::new(false)));
                thread::spawn(move || pass(far_again, near_again, &noisy));
            }
        });
        Self { port, is_noisy }
    }

    fn set_noisy(&self, noisy: bool) {
        self.is_noisy.store(noisy, Ordering::Release);
    }
}

fn pass(mut from: TcpStream, mut to: TcpStream, is_noisy: &AtomicBool) {
    let (mut bytes, mut passed) = (vec![0; 4096], 0);
    while let Ok(count @ 1..) = from.read(&mut bytes) {
        let bytes = &mut bytes[..count];
        if is_noisy.load(Ordering::Acquire) {
            let first = (ONE_IN - passed % ONE_IN) % ONE_IN;
            bytes.iter_mut().skip(first).step_by(ONE_IN).for_each(|byte| *byte ^= 0x5a);
        }
        passed += count;
        if to.write_all(bytes).is_err() {
            break;
        }
    }
    let _ = to.shutdown(Shutdown::Both);
}

/// Ends with words, never otherwise.
fn complaint<T>(outcome: Result<T, SourceError>) -> Option<String> {
    match outcome {
        Ok(_) => None,
        Err(SourceError::Failed(reason)) => Some(reason),
        // Of a picture's head, too, bytes were changed.
        Err(error @ SourceError::Size { .. }) => Some(error.to_string()),
        Err(other) => panic!("{other:?}"),
    }
}

/// Frames for so long, from a source that is opened again whenever it fails; how often that was.
fn bear(
    opener: &mut dyn OpenSource,
    source: &mut Option<Box<dyn FrameSource>>,
    length: Duration,
) -> usize {
    let (begun, mut failures) = (Instant::now(), 0);
    while begun.elapsed() < length {
        let complaint = match source {
            Some(source) => complaint(source.next_frame()),
            None => complaint(opener.open().map(|opened| *source = Some(opened))),
        };
        if let Some(reason) = complaint {
            assert!(reason.contains("rtsp://127.0.0.1:"), "{reason}");
            (failures, *source) = (failures + 1, None);
        }
    }
    failures
}

/// Ten frames whose numbers follow one another; otherwise what came.
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

/// A source that runs well, opened again until it does: a loaded machine's camera, too, leaves frames out.
fn settled(opener: &mut dyn OpenSource, when: &str) -> Box<dyn FrameSource> {
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
                assert!(begun.elapsed() < PATIENCE, "{when}: {reason}");
            }
        }
    }
}

#[test]
fn bytes_that_change_on_the_wire_are_survived() {
    let _alone = alone();
    for encoder in ["jpeg", "h264"] {
        let Some(camera) = start("bytes_that_change_on_the_wire_are_survived", encoder) else {
            return;
        };
        let wire = Wire::to(camera.port);
        let (mut opener, _) = opener(&format!("rtsp://127.0.0.1:{}/stream", wire.port), SIZE);
        let mut source = Some(settled(&mut opener, &format!("{encoder}, before")));
        wire.set_noisy(true);
        let failures = bear(&mut opener, &mut source, Duration::from_secs(4));
        println!("{encoder}: {failures} times opened again");
        wire.set_noisy(false);
        // One connection ends before another begins.
        if source.is_none_or(|mut source| ten_frames(&mut *source).is_err()) {
            settled(&mut opener, &format!("{encoder}, afterwards"));
        }
    }
}

#[test]
fn what_is_no_camera_is_told() {
    let _alone = alone();
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
    assert!(reason.ends_with("is it a camera's port, and is the network sound?"), "{reason}");
}
