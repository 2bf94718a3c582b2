//! A shadow's edge across a ring: where it runs, and the picture without it.
//!
//! | module | content |
//! | --- | --- |
//! | `samples` | pixels of disc, ring and margin away from their rims |
//! | `edge` | the line that separates light and shadow, its levels and width |
//!
//! Light multiplies what a print reflects. Beyond the edge of a shadow, white and black have other levels, and a
//! threshold between the brighter black and the darker white still separates the print's areas. Bright and dark pixels
//! are therefore two classes, each with one level on either side of a line. The line is the one whose levels explain
//! most of the variance, as Otsu's threshold does for grey levels.
//!
//! Input: a place, and a threshold that separates the areas. Output: the window around it with the levels of the shadow
//! mapped to those of the light, in which the ring is measured and tested like any other.
//!
//! Limits: one straight edge per ring. White in the shadow must be brighter than black in the light. Noise is amplified
//! as the levels are. `core/tests/shadow.rs` covers places, directions, sizes and depths.

mod edge;
mod samples;

pub(crate) use edge::find_edge;
pub(crate) use samples::{LightSample, MAX_SAMPLES};
