//! Frames and what is detected in them: sources, one worker for each camera, and trials of a source.

pub mod image_file;
pub mod push_messages;
pub mod source;
pub mod source_probe;
pub mod worker;
