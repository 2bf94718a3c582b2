//! Fills a history as the server's thread does, by the times of the snapshots instead of a clock.

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use roundel_core::{
    id::ObjectId,
    time::Timestamp,
    world::{LifeStage, Snapshot},
};
use roundel_server::{
    archive::history::{
        TIERS,
        store::{HistoryObject, HistoryPoint, Store},
    },
    model::{config::HistoryConfig, hub::Hub},
};

const EXPIRE_INTERVAL_S: f64 = 60.0;
const WRITE_POINTS: usize = 300;

pub(super) struct HistoryWriter {
    store: Store,
    hub: Arc<Hub>,
    keep: Duration,
    keys: BTreeMap<ObjectId, (i64, [Option<i64>; TIERS.len()])>,
    pending: Vec<(usize, i64, HistoryPoint)>,
    expired: Option<Timestamp>,
}

impl HistoryWriter {
    pub(super) fn new(config: &HistoryConfig, hub: Arc<Hub>) -> anyhow::Result<Self> {
        let store = Store::open(&config.file)?;
        let (keys, pending) = (BTreeMap::new(), Vec::new());
        Ok(Self { store, hub, keep: config.keep, keys, pending, expired: None })
    }

    pub(super) fn take(&mut self, snapshot: &Snapshot) -> anyhow::Result<()> {
        let time = snapshot.pose_time;
        self.keys.retain(|id, _| snapshot.objects.iter().any(|it| it.id == *id));
        for state in snapshot.objects.iter().filter(|it| it.stage == LifeStage::Tracked) {
            let (key, slots) = match self.keys.get_mut(&state.id) {
                Some(known) => known,
                None => {
                    let object = HistoryObject {
                        run: self.hub.installation().source_id.clone(),
                        id: state.id.0,
                        name: String::new(),
                        kind: "robot".to_owned(),
                        code: state.code.map_or(0, |code| u32::from(code.number)),
                    };
                    let key = self.store.key(&object, time)?;
                    self.keys.entry(state.id).or_insert((key, Default::default()))
                }
            };
            let point = HistoryPoint { time, position_m: state.position_m.into(), yaw_rad: None };
            for (index, (tier, slot)) in TIERS.iter().zip(slots).enumerate() {
                let now = time.as_ns().div_euclid(tier.step_ns);
                if slot.replace(now) != Some(now) {
                    self.pending.push((index, *key, point));
                }
            }
        }
        if self.pending.len() >= WRITE_POINTS {
            self.store.add(&self.pending)?;
            self.pending.clear();
        }
        if self.expired.is_none_or(|expired| time.seconds_since(expired) >= EXPIRE_INTERVAL_S) {
            self.expired = Some(time);
            while self.store.expire(time, self.keep)? {}
        }
        Ok(())
    }
}
