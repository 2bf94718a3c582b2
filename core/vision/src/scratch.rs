//! Memory that is made ready before it is needed, so that nothing is allocated frame after frame.

/// Makes room for so many items in all.
pub(crate) fn make_room<T>(items: &mut Vec<T>, most: usize) {
    items.reserve_exact(most.saturating_sub(items.len()));
}
