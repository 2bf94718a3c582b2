//! Hostile input: what has killed, wedged or exhausted a server, and what has revealed more than it should.

mod addresses;
mod damaged_recordings;
mod failures;
mod files;
mod large_configuration;
mod limits;
mod secrets;
