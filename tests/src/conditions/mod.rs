//! Roundels as printers, lamps, lenses and cameras show them, and what detection makes of them: the table condition ×
//! (found, followed, error over the bound, share inside the stated 95 %, cost).
//!
//! A [`Condition`] is what differs from an ideal print in even light, as ranges that are drawn per roundel. A
//! [`Sequence`](sequence::Sequence) renders one roundel under it, frame by frame: it moves on a small circle by about a
//! pixel per frame, rotates by up to a degree, and shadow edges sweep across it. Core gets the *nominal* kind (160 mm)
//! and the nominal camera, since it does not know what a printer or a lens did.
//!
//! **Errors** ([`trial`]). Each trial has one frame that is searched and [`trial::FOLLOWED`] that are followed; the last
//! [`trial::SCORED`] are scored against the true pose. The same trials are drawn under each condition: same poses,
//! same noise. Errors are divided by the Cramér-Rao bound of the print as printed in even light, with the condition's
//! blur, noise and saturation but without shadow, lamp, dirt, processing: a ratio of 1 means as good as an ideal
//! estimator in even light that knows the print. Where the size itself is unknown, the depth cannot be right from one
//! camera; shares inside the stated 95 % show whether the covariance says so.
//!
//! **Cost** ([`cost`]). Twelve followed roundels in one picture, relative to the same twelve under the condition `plain`
//! in the same mode, with both measured alternately.
//!
//! Limits: one roundel per trial, on a dark floor; shadow edges are hard; polygons do not bloom, so bloom is drawn as ink
//! that shrinks.

mod condition;
pub mod cost;
pub mod score;
pub mod sequence;
pub mod trial;

pub use condition::{Condition, Marker, all};
