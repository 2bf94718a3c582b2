//! The recording that starts with the server (`start = true`).
//!
//! If it cannot be started, or fails, it is tried again with backoff. Meanwhile its status has the reason. A client that
//! stops it ends it for good.

use std::{
    sync::{Arc, mpsc::Sender, mpsc::channel},
    thread::JoinHandle,
    time::{Duration, Instant},
};

use backon::{BackoffBuilder, ExponentialBackoff, ExponentialBuilder};
use roundel_proto::v1::RecordingState;

use super::{RecordError, Recorder, RecordingOptions};
use crate::model::stop::StopSignal;

const POLL_INTERVAL: Duration = Duration::from_millis(500);
/// [`start`] waits this long, so that the recording misses nothing. A disk that hangs delays the start no longer.
const START_TIMEOUT: Duration = Duration::from_secs(2);
/// A recording that has run for this long resets the backoff.
const HEALTHY_AFTER: Duration = Duration::from_secs(60);

/// Delays that double from 2 s to 60 s.
fn delays() -> ExponentialBackoff {
    ExponentialBuilder::new()
        .with_min_delay(Duration::from_secs(2))
        .with_max_delay(Duration::from_secs(60))
        .without_max_times()
        .build()
}

/// Starts the recording on a thread that ends with the stop signal.
pub fn start(recorder: Arc<Recorder>, stop: StopSignal) -> Option<JoinHandle<()>> {
    let (attempted, first) = channel();
    let builder = std::thread::Builder::new().name("standing recording".to_owned());
    match builder.spawn(move || keep_recording(&recorder, &stop, &attempted)) {
        Ok(thread) => {
            let _ = first.recv_timeout(START_TIMEOUT);
            Some(thread)
        }
        Err(error) => {
            tracing::error!(%error, "cannot start the thread of the recording: nothing is recorded");
            None
        }
    }
}

fn keep_recording(recorder: &Recorder, stop: &StopSignal, attempted: &Sender<()>) {
    let (mut backoff, mut is_failing) = (delays(), false);
    while !stop.is_stopped() {
        let begun = Instant::now();
        match recorder.start(&RecordingOptions::default()) {
            // A client has started one: that is watched instead.
            Ok(()) | Err(RecordError::Busy(_)) => {}
            Err(error) => recorder.note_not_started(&error.to_string(), is_failing),
        }
        let _ = attempted.send(());
        while recorder.status().state() == RecordingState::Recording {
            if stop.wait(POLL_INTERVAL) {
                return;
            }
        }
        if recorder.status().state() != RecordingState::Failed {
            return;
        }
        if begun.elapsed() >= HEALTHY_AFTER {
            backoff = delays();
        }
        is_failing = true;
        stop.wait(backoff.next().unwrap_or_default());
    }
}
