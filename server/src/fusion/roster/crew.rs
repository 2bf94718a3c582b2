//! The workers' threads, each with a stop of its own.

use std::{
    collections::BTreeMap,
    io,
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use roundel_core::id::CameraId;

use crate::{
    capture::worker::{self, Totals, Worker},
    model::stop::Stop,
};

/// A worker ends within milliseconds; one whose source holds it up for longer is left behind.
const PATIENCE: Duration = Duration::from_secs(3);
const LOOK_EVERY: Duration = Duration::from_millis(2);

struct Member {
    stop: Stop,
    thread: JoinHandle<Totals>,
}

/// All workers that run.
#[derive(Default)]
pub(super) struct Crew(BTreeMap<CameraId, Member>);

impl Crew {
    /// Has a camera's worker run until its stop.
    pub(super) fn begin(
        &mut self,
        id: CameraId,
        name: &str,
        worker: Worker,
        stop: Stop,
    ) -> io::Result<()> {
        let until = stop.clone();
        let builder = thread::Builder::new().name(format!("camera {name}"));
        let thread = builder.spawn(move || worker::run(worker, &until))?;
        self.0.insert(id, Member { stop, thread });
        Ok(())
    }

    /// Ends a camera's worker, and says what it has counted; `None` if that is not known.
    pub(super) fn end(&mut self, id: CameraId) -> Option<Totals> {
        let Member { stop, thread } = self.0.remove(&id)?;
        stop.stop();
        let deadline = Instant::now() + PATIENCE;
        while !thread.is_finished() {
            if Instant::now() >= deadline {
                let name = thread.thread().name().unwrap_or_default();
                tracing::warn!(thread = name, "did not end within the grace time");
                return None;
            }
            thread::sleep(LOOK_EVERY);
        }
        thread.join().ok()
    }

    /// Ends all at once, and gives their threads to be waited for.
    pub(super) fn end_all(&mut self) -> Vec<JoinHandle<Totals>> {
        let members = std::mem::take(&mut self.0);
        members.values().for_each(|member| member.stop.stop());
        members.into_values().map(|member| member.thread).collect()
    }
}
