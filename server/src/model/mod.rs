//! What all other modules share: configuration, commands, events, camera types, the clock, and the hub.

pub mod address;
pub mod camera;
pub mod camera_file;
pub mod capture_clock;
pub mod clock;
pub mod command;
pub mod config;
pub mod convert;
pub mod event;
pub mod hub;
pub(crate) mod reason;
pub mod simulated;
pub mod snapshot;
pub mod stop;
pub(crate) mod suggestion;
pub mod tap;
