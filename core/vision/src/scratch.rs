//! Memory that is made ready before it is needed, so that nothing is allocated frame after frame.

/// Makes room for so many items in all.
pub(crate) fn reserve_total<T>(items: &mut Vec<T>, capacity: usize) {
    items.reserve_exact(capacity.saturating_sub(items.len()));
}
