//! Which pixels belong to a ring: disc, black, edge bands of the rims, margin.
//!
//! | module | content |
//! | --- | --- |
//! | `patch` | the window around a ring, thresholded into words of bits |
//! | `segment_fill`, `segments` | disc and black ring, filled by runs |
//! | `edge_band` | edge bands and the pixels for the levels, from the segments |
//! | `ellipse_mask` | filled ellipses as bits |
//! | `predicted` | the same bands from the predicted rims of a tracked ring |

pub(crate) mod edge_band;
pub(crate) mod ellipse_mask;
pub(crate) mod patch;
pub(crate) mod predicted;
pub(crate) mod segment_fill;
pub(crate) mod segments;
