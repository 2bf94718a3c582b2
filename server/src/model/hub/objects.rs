//! Objects of the newest snapshot and those lost within the last minute.
//!
//! There may be many lost objects and many snapshots a second: a snapshot touches only its own objects and those that
//! have just left.

use std::collections::{BTreeMap, VecDeque};

use roundel_core::{
    id::{BodyId, KindId, ObjectId},
    marker::Code,
    time::Timestamp,
    world::{LifeStage, ObjectState, Snapshot},
};

const LOST_RETENTION_S: f64 = 60.0;

#[derive(Clone, Debug)]
pub struct ObjectRecord {
    pub id: ObjectId,
    pub kind: Option<KindId>,
    pub body: Option<BodyId>,
    /// The code read most often of late.
    pub code: Option<Code>,
    pub stage: LifeStage,
    /// Capture time of the first detection.
    pub first_seen: Timestamp,
    /// Capture time of the newest detection.
    pub last_seen: Timestamp,
    pub observations: u64,
}

impl ObjectRecord {
    fn of(state: &ObjectState) -> Self {
        Self {
            id: state.id,
            kind: state.kind,
            body: state.body,
            code: state.code,
            stage: state.stage,
            first_seen: state.first_observation,
            last_seen: state.newest_observation,
            observations: state.observations,
        }
    }
}

#[derive(Debug, Default)]
pub(super) struct RecentObjects {
    /// By id.
    present: Vec<ObjectRecord>,
    /// In the order of their loss.
    lost: VecDeque<ObjectRecord>,
}

impl RecentObjects {
    pub fn take(&mut self, snapshot: &Snapshot) {
        let now = snapshot.objects.iter().map(ObjectRecord::of).collect();
        let before = std::mem::replace(&mut self.present, now);
        for record in before {
            let is_present = |records: &[ObjectRecord]| {
                records.binary_search_by_key(&record.id, |other| other.id).is_ok()
            };
            if !is_present(&self.present) {
                self.lost.push_back(ObjectRecord { stage: LifeStage::Lost, ..record });
            }
        }
        let is_old = |record: &ObjectRecord| {
            snapshot.pose_time.seconds_since(record.last_seen) >= LOST_RETENTION_S
        };
        while self.lost.front().is_some_and(is_old) {
            self.lost.pop_front();
        }
    }

    pub fn all(&self) -> Vec<ObjectRecord> {
        let lost = self.lost.iter().map(|record| (record.id, record));
        // A recovered object replaces its lost record.
        let present = self.present.iter().map(|record| (record.id, record));
        lost.chain(present).collect::<BTreeMap<_, _>>().into_values().cloned().collect()
    }

    pub fn newest(&self, matches: impl Fn(&ObjectRecord) -> bool) -> Option<ObjectId> {
        let all = self.lost.iter().chain(&self.present).filter(|record| matches(record));
        all.max_by_key(|record| record.last_seen).map(|record| record.id)
    }
}
