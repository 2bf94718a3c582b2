//! Runs the camera watch ([`roundel_core::calib::watch`]) on a low-priority thread.
//!
//! The watch computes for milliseconds four times a second, which would delay frames and clients on the fusion thread.
//! Its input is sent in ordered batches; the next batch follows the findings of the one before.

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

/// Minimum time between two batches.
const BATCH_PERIOD_NS: i64 = 50_000_000;
/// Capacity for the next batch. When it is full, frames are dropped.
const MAX_INPUTS: usize = 4096;
/// On a busy core the thread gets a tenth of the time of the others.
#[cfg(target_os = "linux")]
const NICE: i32 = 10;

#[derive(Clone, Debug)]
pub(super) enum MonitorInput {
    Placed {
        camera: CameraId,
        placement: Box<CameraPlacement>,
        /// Possibly measured by hand, and inexact.
        is_configured: bool,
        /// Differs from the pose before.
        is_new: bool,
    },
    Removed(CameraId),
    /// A frame and the offset of its time stamps, seconds.
    Detections(Arc<FrameObservations>, f64),
    /// Whether fusion holds a camera back.
    Held(CameraId, bool),
}

/// Result of one batch.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Findings {
    pub events: Vec<WatchEvent>,
    /// For each camera: whether its pose is only configured, and its health.
    pub cameras: Vec<(CameraId, bool, Option<CameraHealth>)>,
}

type Batch = (Vec<MonitorInput>, Timestamp);

pub(super) struct MonitorThread {
    notes: Vec<MonitorInput>,
    batches: Sender<Batch>,
    findings: Receiver<Findings>,
    is_busy: bool,
    sent: Option<Timestamp>,
}

impl MonitorThread {
    /// The thread ends when this is dropped.
    pub(super) fn new(watch: Watch) -> Self {
        let (batches, received) = channel();
        let (sender, findings) = channel();
        let thread = thread::Builder::new().name("watch".to_owned());
        if let Err(error) = thread.spawn(move || work(watch, &received, &sender)) {
            tracing::error!(
                %error,
                "cannot start the thread of the camera watch: bumped cameras are not detected"
            );
        }
        Self { notes: Vec::new(), batches, findings, is_busy: false, sent: None }
    }

    pub(super) fn note(&mut self, note: MonitorInput) {
        if self.notes.len() < MAX_INPUTS || !matches!(note, MonitorInput::Detections(..)) {
            self.notes.push(note);
        }
    }

    /// Findings of the last batch, once.
    pub(super) fn findings(&mut self) -> Option<Findings> {
        let findings = self.findings.try_recv();
        if findings == Err(TryRecvError::Empty) {
            return None;
        }
        if self.is_busy && findings.is_err() {
            tracing::error!(
                "the camera watch has failed: bumped cameras are not detected any more; restart the server"
            );
        }
        self.is_busy = false;
        findings.ok()
    }

    /// Whether a camera was moved or removed after the last batch was sent.
    pub(super) fn is_outdated(&self, camera: CameraId) -> bool {
        self.notes.iter().any(|note| match note {
            MonitorInput::Placed { camera: placed, is_new, .. } => *is_new && *placed == camera,
            MonitorInput::Removed(removed) => *removed == camera,
            MonitorInput::Detections(..) | MonitorInput::Held(..) => false,
        })
    }

    /// Sends the batch if one is due; the watch advances to `now`.
    pub(super) fn send(&mut self, now: Timestamp) {
        let is_due =
            self.sent.is_none_or(|sent| now.ns_since(sent).saturating_abs() >= BATCH_PERIOD_NS);
        if self.is_busy || !is_due {
            return;
        }
        self.sent = Some(now);
        // Fails if the thread has ended.
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

/// In Linux each thread has its own priority.
#[cfg(target_os = "linux")]
fn lower_priority() {
    if let Err(error) = rustix::process::setpriority_process(None, NICE) {
        tracing::debug!(%error, "the camera watch runs with normal priority");
    }
}

#[cfg(not(target_os = "linux"))]
fn lower_priority() {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn input_is_dropped_after_the_thread_has_ended() {
        let (batches, findings) = (channel().0, channel().1);
        let mut monitor_thread =
            MonitorThread { notes: Vec::new(), batches, findings, is_busy: true, sent: None };
        monitor_thread.note(MonitorInput::Held(CameraId(0), true));
        assert!(monitor_thread.findings().is_none() && !monitor_thread.is_busy);
        monitor_thread.send(Timestamp::from_ns(0));
        assert!(monitor_thread.notes.is_empty() && !monitor_thread.is_busy);
    }
}
