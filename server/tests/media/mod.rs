//! Sources that use GStreamer, with real servers on loopback and generated files. Tests that need the Python bindings
//! of GStreamer's RTSP server are skipped, with a message, where these are missing.

mod aravis;
mod corrupted_stream;
mod file;
mod real_video;
mod rtsp;
mod rtsp_server;

use std::{
    path::Path,
    sync::{Mutex, MutexGuard, PoisonError},
    thread,
    time::{Duration, Instant},
};

use roundel_server::{
    capture::source::{FrameSource, OpenSource, Playback, SourceError, SourceOpener},
    model::{address::SourceAddress, clock::Clock, stop::StopSignal},
};

/// Image size of all generated videos.
pub const SIZE: (usize, usize) = (320, 64);
/// Timeout of every wait; only a stalled machine reaches it.
pub const TIMEOUT: Duration = Duration::from_secs(60);

/// Lock that each test holds: real-time playback drops frames if several tests share a small machine.
pub fn run_exclusively() -> MutexGuard<'static, ()> {
    static ONE: Mutex<()> = Mutex::new(());
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A source opener like that of a worker, and its clock.
pub fn opener(url: &str, size: (usize, usize)) -> (SourceOpener, Clock) {
    let address = SourceAddress::parse(url, Path::new("/")).unwrap();
    let (clock, playback) = Playback::begin(std::iter::once(&address)).unwrap();
    (SourceOpener::new(address, size, clock, playback, StopSignal::default()), clock)
}

/// Opens a source with frames of [`SIZE`].
pub fn open(url: &str) -> (Box<dyn FrameSource>, Clock) {
    let (mut opener, clock) = opener(url, SIZE);
    (opener.open().unwrap(), clock)
}

/// Opens a source, retrying until it delivers a frame, as a supervisor does.
pub fn open_again(opener: &mut dyn OpenSource) -> Box<dyn FrameSource> {
    let begun = Instant::now();
    loop {
        let outcome = opener.open().and_then(|mut source| {
            source.next_frame()?;
            Ok(source)
        });
        match outcome {
            Ok(source) => return source,
            Err(SourceError::Failed(reason)) => assert!(begun.elapsed() < TIMEOUT, "{reason}"),
            Err(other) => panic!("{other:?}"),
        }
        thread::sleep(Duration::from_millis(200));
    }
}

/// The error of a source when it is opened or at its first frame.
pub fn failure(url: &str, size: (usize, usize)) -> String {
    let (mut opener, _) = opener(url, size);
    let outcome = opener.open().and_then(|mut source| source.next_frame().map(|lent| lent.info));
    match outcome {
        Err(error @ (SourceError::Failed(_) | SourceError::Size { .. })) => error.to_string(),
        other => panic!("{url}: {other:?}"),
    }
}
