//! A snapshot as the hub publishes it.

use roundel_core::{time::Timestamp, world::Snapshot};

/// A snapshot with what the server adds to it.
#[derive(Clone, Debug, Default)]
pub struct FusedSnapshot {
    /// Grows by one with each snapshot; 0 before the first.
    pub sequence: u64,
    /// When fusion made it.
    pub fused_time: Timestamp,
    pub snapshot: Snapshot,
}
