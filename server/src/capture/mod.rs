//! Frames and their detections: sources, one worker for each camera, and source probes.

pub mod image_file;
pub mod push_messages;
pub mod source;
pub mod source_probe;
pub mod worker;
