//! Network cameras over loopback: frame counts, capture times, recovery from faults, and error messages. Waits have
//! generous timeouts and end as soon as their condition holds.

pub mod fake_camera;
mod http;
mod rig;
mod source_probe;
