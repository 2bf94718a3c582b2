//! Views of a calibration target: which are usable, which are worth keeping, and which are still missing.

pub(super) mod blur;
pub(super) mod coverage;
pub(super) mod homography;
pub(super) mod layout_check;
pub(super) mod selection;
pub(super) mod target;
pub(super) mod view;
