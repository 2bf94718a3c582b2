//! Bundle adjustment of an arena: camera poses, clocks and lenses, and the splines of all roundels.

pub(super) mod banded;
pub(super) mod bundle;
pub(super) mod camera_block;
pub(super) mod spline;
pub(super) mod track_block;
