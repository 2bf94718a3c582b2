//! The pixels of one ring.

pub(crate) mod edge_band;
pub(crate) mod ellipse_mask;
pub(crate) mod patch;
pub(crate) mod predicted;
pub(crate) mod segment_fill;
pub(crate) mod segments;
