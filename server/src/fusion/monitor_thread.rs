//! The watch over cameras in a thread of its own, which gives way to all others.
//!
//! Four times a second it computes for milliseconds ([`roundel_core::calib::watch`]); nobody waits for that but who
//! was bumped, and in fusion's thread each frame and each client that came just then would. It is told what happened in
//! batches, in order, and has said what it makes of one before it gets the next.

use std::{
    collections::BTreeSet,
    sync::{
        Arc,
        mpsc::{Receiver, Sender, TryRecvError, channel},
    },
    thread,
};

use roundel_core::{
    calib::watch::{CameraHealth, Watch, WatchEvent},
    id::CameraId,
    time::Timestamp,
    world::{CameraPlacement, FrameObservations},
};

/// From one batch to the next at least.
const BATCH_PERIOD_NS: i64 = 50_000_000;
/// Notes that may wait for a batch; frames beyond are left out.
const MAX_INPUTS: usize = 4096;
/// Of its thread: a tenth of what others get where all want the same core, and they need not wait for it.
#[cfg(target_os = "linux")]
const NICE: i32 = 10;

#[derive(Clone, Debug)]
pub(super) enum MonitorInput {
    Placed {
        camera: CameraId,
        placement: Box<CameraPlacement>,
        /// By a person: it may be rough.
        is_configured: bool,
        /// Other than it was known to.
        is_new: bool,
    },
    Removed(CameraId),
    /// A frame, and by how much its stamps are late, seconds.
    Detections(Arc<FrameObservations>, f64),
    /// Whether fusion holds a camera back.
    Held(CameraId, bool),
}

/// What the watch made of a batch.
#[derive(Clone, Debug)]
pub(super) struct Findings {
    pub events: Vec<WatchEvent>,
    /// With each camera whether its place is only written, and how it is.
    pub cameras: Vec<(CameraId, bool, Option<CameraHealth>)>,
}

type Batch = (Vec<MonitorInput>, Timestamp);

/// Passes notes on to the thread, and brings findings back.
pub(super) struct MonitorThread {
    notes: Vec<MonitorInput>,
    batches: Sender<Batch>,
    findings: Receiver<Findings>,
    is_busy: bool,
    sent: Option<Timestamp>,
}

impl MonitorThread {
    /// With a watch that knows its landmarks. Its thread ends with this.
    pub(super) fn new(watch: Watch) -> Self {
        let (batches, received) = channel();
        let (sender, findings) = channel();
        let thread = thread::Builder::new().name("watch".to_owned());
        if let Err(error) = thread.spawn(move || work(watch, &received, &sender)) {
            tracing::error!(
                %error,
                "no thread could be started for the watch: that a camera was bumped is not noticed"
            );
        }
        Self { notes: Vec::new(), batches, findings, is_busy: false, sent: None }
    }

    pub(super) fn note(&mut self, note: MonitorInput) {
        if self.notes.len() < MAX_INPUTS || !matches!(note, MonitorInput::Detections(..)) {
            self.notes.push(note);
        }
    }

    /// What was made of the batch before, if that is known by now and was not taken yet.
    pub(super) fn findings(&mut self) -> Option<Findings> {
        let findings = match self.findings.try_recv() {
            Err(TryRecvError::Empty) => return None,
            Err(TryRecvError::Disconnected) => {
                if self.is_busy {
                    tracing::error!(
                        "the watch has ended by an error: from now on, that a camera was bumped is not noticed; start \
                         the server anew"
                    );
                }
                None
            }
            Ok(findings) => Some(findings),
        };
        self.is_busy = false;
        findings
    }

    /// Whether a camera was placed elsewhere or removed since the batch whose findings are taken next, or just were.
    pub(super) fn is_outdated(&self, camera: CameraId) -> bool {
        self.notes.iter().any(|note| match note {
            MonitorInput::Placed { camera: placed, is_new, .. } => *is_new && *placed == camera,
            MonitorInput::Removed(removed) => *removed == camera,
            MonitorInput::Detections(..) | MonitorInput::Held(..) => false,
        })
    }

    /// Sends what was noted, if it is time for that; time passes until `now`.
    pub(super) fn send(&mut self, now: Timestamp) {
        let is_due =
            self.sent.is_none_or(|sent| now.ns_since(sent).saturating_abs() >= BATCH_PERIOD_NS);
        if self.is_busy || !is_due {
            return;
        }
        self.sent = Some(now);
        // Without the thread nobody hears of it.
        self.is_busy = self.batches.send((std::mem::take(&mut self.notes), now)).is_ok();
    }
}

fn work(mut watch: Watch, batches: &Receiver<Batch>, findings: &Sender<Findings>) {
    lower_priority();
    let mut cameras = BTreeSet::new();
    while let Ok((notes, now)) = batches.recv() {
        for note in notes {
            match note {
                MonitorInput::Placed { camera, placement, is_configured, .. } => {
                    watch.set_camera(camera, *placement);
                    if is_configured {
                        watch.distrust(camera);
                    }
                    cameras.insert(camera);
                }
                MonitorInput::Removed(camera) => {
                    watch.remove_camera(camera);
                    cameras.remove(&camera);
                }
                MonitorInput::Detections(frame, late_s) => watch.observe(&frame, late_s),
                MonitorInput::Held(camera, is_held) => watch.hold(camera, is_held),
            }
        }
        let events = watch.advance(now);
        let each = cameras.iter();
        let cameras = each.map(|&it| (it, !watch.is_trusted(it), watch.health(it))).collect();
        if findings.send(Findings { events, cameras }).is_err() {
            return;
        }
    }
}

/// In Linux each thread has a priority of its own.
#[cfg(target_os = "linux")]
fn lower_priority() {
    if let Err(error) = rustix::process::setpriority_process(None, NICE) {
        tracing::debug!(%error, "the watch has the priority of all others");
    }
}

#[cfg(not(target_os = "linux"))]
fn lower_priority() {}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is noted then is let go of.
    #[test]
    fn nothing_piles_up_where_the_watch_has_ended() {
        let (batches, findings) = (channel().0, channel().1);
        let mut monitor_thread =
            MonitorThread { notes: Vec::new(), batches, findings, is_busy: true, sent: None };
        monitor_thread.note(MonitorInput::Held(CameraId(0), true));
        assert!(monitor_thread.findings().is_none() && !monitor_thread.is_busy);
        monitor_thread.send(Timestamp::from_ns(0));
        assert!(monitor_thread.notes.is_empty() && !monitor_thread.is_busy);
    }
}
