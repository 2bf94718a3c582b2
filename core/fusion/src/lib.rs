//! Merges the detections of all cameras into tracks in one world frame.
//!
//! | module | content |
//! | --- | --- |
//! | [`track`] | one object's motion over time |
//! | [`world`] | all objects in the world frame, from all cameras |

pub mod track;
pub mod world;
