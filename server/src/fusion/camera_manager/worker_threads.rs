//! The workers' threads, each with its own stop signal.

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

/// Workers stop within milliseconds. One that is blocked by its source for longer is abandoned.
const STOP_TIMEOUT: Duration = Duration::from_secs(3);
const POLL_INTERVAL: Duration = Duration::from_millis(2);

struct WorkerThread {
    stop: StopSignal,
    thread: JoinHandle<WorkerCounts>,
}

pub(super) struct WorkerThreads {
    threads: BTreeMap<CameraId, WorkerThread>,
    /// Ends waits for workers that do not stop.
    shutting_down: StopSignal,
}

impl WorkerThreads {
    pub(super) fn new(shutting_down: StopSignal) -> Self {
        Self { threads: BTreeMap::new(), shutting_down }
    }

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
        self.threads.insert(id, WorkerThread { stop, thread });
        Ok(())
    }

    /// Stops a worker and returns its counts; `None` if it is blocked.
    pub(super) fn stop(&mut self, id: CameraId) -> Option<WorkerCounts> {
        let WorkerThread { stop, thread } = self.threads.remove(&id)?;
        stop.stop();
        let deadline = Instant::now() + STOP_TIMEOUT;
        while !thread.is_finished() {
            if Instant::now() >= deadline || self.shutting_down.is_stopped() {
                let name = thread.thread().name().unwrap_or_default();
                tracing::warn!(thread = name, "did not end within the grace time");
                return None;
            }
            thread::sleep(POLL_INTERVAL);
        }
        thread.join().ok()
    }

    /// Stops all workers and returns their threads.
    pub(super) fn stop_all(&mut self) -> Vec<JoinHandle<WorkerCounts>> {
        let members = std::mem::take(&mut self.threads);
        members.values().for_each(|member| member.stop.stop());
        members.into_values().map(|member| member.thread).collect()
    }
}
