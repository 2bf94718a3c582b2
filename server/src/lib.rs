//! The Roundel server: cameras in, world poses out.
//!
//! Modules import downwards only; `tests/tests/layering.rs` checks it.
//!
//! | module | content |
//! | --- | --- |
//! | [`model`] | configuration, commands, events, camera types, the clock, and the hub with the newest of everything |
//! | [`capture`] | sources of frames, and one worker thread for each camera |
//! | [`fusion`] | the fusion thread, camera monitoring, online calibration, and the camera manager |
//! | [`archive`] | recording, replay, history, evaluation |
//! | [`lab`] | lens calibration, printing, planning, drawing |
//! | [`api`] | gRPC, REST, WebSocket, metrics and the dashboard on one port |
//! | [`app`] | wiring, nodes and the command line |

// The library exists for the binary and its tests.
#![allow(missing_docs)]

pub mod api;
pub mod app;
pub mod archive;
pub mod capture;
pub mod fusion;
pub mod lab;
pub mod model;
