//! What GStreamer plays, against real servers on loopback and files that it made itself. Where Python's bindings of
//! GStreamer's RTSP server are missing, what needs them is skipped, by name.

mod aravis;
mod file;
mod noise;
mod rtsp;
mod server;
mod video;

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

/// Of all that the tests make.
pub const SIZE: (usize, usize) = (320, 64);
/// Nothing here takes so long but on a machine that stands still.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Held by each test: what plays in real time leaves frames out where several share a small machine.
pub fn alone() -> MutexGuard<'static, ()> {
    static ONE: Mutex<()> = Mutex::new(());
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A source as a worker opens it, and its clock.
pub fn opener(url: &str, size: (usize, usize)) -> (SourceOpener, Clock) {
    let address = SourceAddress::parse(url, Path::new("/")).unwrap();
    let (clock, playback) = Playback::begin(std::iter::once(&address)).unwrap();
    (SourceOpener::new(address, size, clock, playback, StopSignal::default()), clock)
}

/// Opens a source of frames of [`SIZE`].
pub fn open(url: &str) -> (Box<dyn FrameSource>, Clock) {
    let (mut opener, clock) = opener(url, SIZE);
    (opener.open().unwrap(), clock)
}

/// Opens a source until a frame comes, as a supervisor would.
pub fn open_again(opener: &mut dyn OpenSource) -> Box<dyn FrameSource> {
    let begun = Instant::now();
    loop {
        let outcome = opener.open().and_then(|mut source| {
            source.next_frame()?;
            Ok(source)
        });
        match outcome {
            Ok(source) => return source,
            Err(SourceError::Failed(reason)) => assert!(begun.elapsed() < PATIENCE, "{reason}"),
            Err(other) => panic!("{other:?}"),
        }
        thread::sleep(Duration::from_millis(200));
    }
}

/// Why a source fails, when it is opened or at its first frame.
pub fn failure(url: &str, size: (usize, usize)) -> String {
    let (mut opener, _) = opener(url, size);
    let outcome = opener.open().and_then(|mut source| source.next_frame().map(|lent| lent.info));
    match outcome {
        Err(error @ (SourceError::Failed(_) | SourceError::Size { .. })) => error.to_string(),
        other => panic!("{url}: {other:?}"),
    }
}
