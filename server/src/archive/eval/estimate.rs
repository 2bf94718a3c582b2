//! Trajectories of a recording's objects, and latencies of its snapshots.

use std::collections::BTreeMap;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use prost::Message;
use roundel_core::time::Timestamp;
use roundel_proto::v1;

use super::{Sample, Trajectory};
use crate::archive::{
    record::{file_reader::Channel, schema::Topic},
    replay::{ReplayError, reader::Reader},
};

#[derive(Clone, Debug, Default)]
pub struct RecordedTrajectories {
    /// By id, while a camera observed them.
    pub objects: BTreeMap<u64, RecordedObject>,
    /// From the newest capture to the snapshot, seconds.
    pub latencies_s: Vec<f64>,
    /// Pose times of the snapshots.
    pub times: Vec<Timestamp>,
}

#[derive(Clone, Debug, Default)]
pub struct RecordedObject {
    pub code: Option<u32>,
    pub trajectory: Trajectory,
}

/// Reads a recording's snapshots. Predicted objects are skipped.
pub fn read(reader: &mut Reader) -> Result<RecordedTrajectories, ReplayError> {
    let mut estimate = RecordedTrajectories::default();
    while let Some(raw) = reader.take()? {
        if raw.channel != Channel::Topic(Topic::Snapshots) {
            continue;
        }
        if let Ok(snapshot) = v1::Snapshot::decode(raw.data.as_slice()) {
            estimate.add(&snapshot);
        }
    }
    Ok(estimate)
}

impl RecordedTrajectories {
    fn add(&mut self, snapshot: &v1::Snapshot) {
        let time = Timestamp::from_ns(snapshot.pose_time_ns);
        if self.times.last().is_some_and(|last| *last >= time) {
            return;
        }
        self.times.push(time);
        if snapshot.capture_time_ns != 0 {
            let late_ns = snapshot.fused_time_ns.saturating_sub(snapshot.capture_time_ns);
            self.latencies_s.push(late_ns as f64 * 1e-9);
        }
        for state in &snapshot.objects {
            if state.stage() == v1::LifeStage::Tracked {
                self.objects.entry(state.object_id).or_default().add(time, state);
            }
        }
    }
}

impl RecordedObject {
    fn add(&mut self, time: Timestamp, state: &v1::ObjectState) {
        let Some(position) = state.position else { return };
        self.code = state.code.map(|code| code.number).or(self.code);
        if self.trajectory.name.is_empty() {
            self.trajectory.name = state.name.clone();
        }
        let turn = state.orientation.filter(|_| state.yaw_observed);
        let orientation = turn.map(|turn| {
            UnitQuaternion::from_quaternion(Quaternion::new(turn.w, turn.x, turn.y, turn.z))
        });
        let position_m = Vector3::new(position.x, position.y, position.z);
        self.trajectory.samples.push(Sample { time, position_m, orientation });
    }
}
