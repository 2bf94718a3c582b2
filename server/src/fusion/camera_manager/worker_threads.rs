//! The workers' threads, each with a stop of its own.

use std::{
    collections::BTreeMap,
    io,
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use roundel_core::id::CameraId;

use crate::{
    capture::worker::{self, Worker, WorkerCounts},
    model::stop::StopSignal,
};

/// A worker ends within milliseconds; one whose source holds it up for longer is left behind.
const STOP_TIMEOUT: Duration = Duration::from_secs(3);
const POLL_INTERVAL: Duration = Duration::from_millis(2);

struct WorkerThread {
    stop: StopSignal,
    thread: JoinHandle<WorkerCounts>,
}

#[derive(Default)]
pub(super) struct WorkerThreads(BTreeMap<CameraId, WorkerThread>);

impl WorkerThreads {
    /// Has a camera's worker run until its stop.
    pub(super) fn spawn(
        &mut self,
        id: CameraId,
        name: &str,
        worker: Worker,
        stop: StopSignal,
    ) -> io::Result<()> {
        let until = stop.clone();
        let builder = thread::Builder::new().name(format!("camera {name}"));
        let thread = builder.spawn(move || worker::run(worker, &until))?;
        self.0.insert(id, WorkerThread { stop, thread });
        Ok(())
    }

    /// Ends a camera's worker, and says what it has counted; `None` if that is not known.
    pub(super) fn stop(&mut self, id: CameraId) -> Option<WorkerCounts> {
        let WorkerThread { stop, thread } = self.0.remove(&id)?;
        stop.stop();
        let deadline = Instant::now() + STOP_TIMEOUT;
        while !thread.is_finished() {
            if Instant::now() >= deadline {
                let name = thread.thread().name().unwrap_or_default();
                tracing::warn!(thread = name, "did not end within the grace time");
                return None;
            }
            thread::sleep(POLL_INTERVAL);
        }
        thread.join().ok()
    }

    /// Ends all at once, and gives their threads to be waited for.
    pub(super) fn stop_all(&mut self) -> Vec<JoinHandle<WorkerCounts>> {
        let members = std::mem::take(&mut self.0);
        members.values().for_each(|member| member.stop.stop());
        members.into_values().map(|member| member.thread).collect()
    }
}
