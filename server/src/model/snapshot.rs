//! A snapshot as the hub publishes it.

use roundel_core::{time::Timestamp, world::Snapshot};

#[derive(Clone, Debug, Default)]
pub struct FusedSnapshot {
    /// Increases by one with each snapshot; 0 before the first.
    pub sequence: u64,
    pub fused_time: Timestamp,
    pub snapshot: Snapshot,
}
