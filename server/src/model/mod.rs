//! What all other modules share: configuration, commands, events, camera types, the clock, and the hub.

pub mod access;
pub mod address;
pub mod camera;
pub mod camera_file;
pub mod capture_clock;
pub mod clock;
pub mod command;
pub mod config;
pub mod convert;
pub mod hub;
pub(crate) mod reason;
pub mod redact;
pub mod regular_file;
pub mod simulated;
pub mod snapshot;
pub mod source_rules;
pub mod stop;
pub(crate) mod suggestion;
pub mod tap;
pub mod text_file;
pub mod untrusted_text;
