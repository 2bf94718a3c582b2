//! Buffers reserved in advance, so that nothing is allocated per frame.

/// Reserves capacity for `capacity` items in total.
pub(crate) fn reserve_total<T>(items: &mut Vec<T>, capacity: usize) {
    items.reserve_exact(capacity.saturating_sub(items.len()));
}
