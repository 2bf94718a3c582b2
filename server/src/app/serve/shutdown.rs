//! Ends a server in the order in which data flows: cameras, fusion, recording, clients. No part can delay the end.

use std::{
    sync::mpsc::channel,
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use tokio::sync::oneshot;

use super::{Server, spawn};

/// Time limit of a shutdown, after which a process ends at once. Below 5 s, with what the exit itself takes.
pub const SHUTDOWN_TIMEOUT: Duration = Duration::from_millis(4800);
/// Parts of [`SHUTDOWN_TIMEOUT`]: for cameras, fusion and history, which rarely need a tenth of it; for the recording; and
/// for clients.
const PRODUCER_TIMEOUT: Duration = Duration::from_millis(1800);
const RECORDER_TIMEOUT: Duration = Duration::from_millis(1200);
pub(super) const CLIENT_TIMEOUT: Duration = Duration::from_millis(1500);

impl Server {
    /// Ends the recording, if that is possible within a time.
    pub async fn finish_recording(&self, timeout: Duration) {
        self.stop_recording.stop();
        let (recorder, deadline) = (self.recorder.clone(), Instant::now() + timeout);
        on_thread(move || drop(within("the recording", deadline, move || recorder.stop()))).await;
    }

    /// Ends cameras, then fusion, then clients, within [`SHUTDOWN_TIMEOUT`]. Threads that do not end in time are left
    /// running, with a warning.
    pub async fn shutdown(mut self) {
        self.is_shut_down = true;
        self.stop_recording.stop();
        let (manager, calibrator) = (self.camera_manager.clone(), self.calibrator.clone());
        let (lenses, history) = (self.lenses.clone(), self.history.clone());
        let (stop_fusion, fusion) = (self.stop_fusion.clone(), self.fusion.take());
        // Not on the runtime, whose threads may all hang in requests.
        on_thread(move || {
            let begun = Instant::now();
            // Cameras that hang leave time for the others.
            let (deadline, camera_deadline) =
                (begun + PRODUCER_TIMEOUT, begun + PRODUCER_TIMEOUT * 2 / 3);
            let stop = move || (manager.stop_all(), [calibrator.shut_down(), lenses.shut_down()]);
            if let Some((cameras, calibrations)) = within("the cameras", camera_deadline, stop) {
                calibrations.into_iter().flatten().for_each(|thread| join(thread, camera_deadline));
                cameras.into_iter().for_each(|thread| join(thread, camera_deadline));
            }
            stop_fusion.stop();
            if let Some(fusion) = fusion {
                join(fusion, deadline);
            }
            if let Some(history) = history.and_then(|history| history.shut_down()) {
                join(history, deadline);
            }
        })
        .await;
        // After the last output of cameras and fusion, which the recording then includes.
        self.finish_recording(RECORDER_TIMEOUT).await;
        self.cancel_clients.cancel();
        if let Some(api) = self.api.take()
            && let Err(error) = api.await
        {
            tracing::error!(%error, "the APIs failed");
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if self.is_shut_down {
            return;
        }
        self.stop_recording.stop();
        self.camera_manager.stop_all();
        self.calibrator.shut_down();
        self.lenses.shut_down();
        self.stop_fusion.stop();
        self.cancel_clients.cancel();
    }
}

/// Runs blocking work on a thread of its own, which no other work can keep from starting.
pub(super) async fn on_thread(work: impl FnOnce() + Send + 'static) {
    let (ended, end) = oneshot::channel::<()>();
    let run = move || {
        work();
        drop(ended);
    };
    if spawn("shutdown".to_owned(), run).is_ok() {
        let _ = end.await;
    }
}

/// Runs work that may hang. `None`: it did not end in time and is left running.
fn within<T: Send + 'static>(
    what: &str,
    deadline: Instant,
    work: impl FnOnce() -> T + Send + 'static,
) -> Option<T> {
    let (ended, end) = channel();
    spawn("shutdown".to_owned(), move || ended.send(work())).ok()?;
    let result = end.recv_timeout(deadline.saturating_duration_since(Instant::now()));
    result.inspect_err(|_| tracing::warn!("{what} did not end in time")).ok()
}

/// Waits for a thread.
pub(super) fn join<T>(thread: JoinHandle<T>, deadline: Instant) {
    const POLL_INTERVAL: Duration = Duration::from_millis(5);
    while !thread.is_finished() {
        if Instant::now() >= deadline {
            let name = thread.thread().name().unwrap_or_default();
            tracing::warn!(thread = name, "did not end in time");
            return;
        }
        thread::sleep(POLL_INTERVAL);
    }
    if thread.join().is_err() {
        tracing::error!("a thread ended with a panic");
    }
}
