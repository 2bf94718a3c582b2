//! The APIs over real sockets on loopback, with a hub that the test feeds: no cameras, no fusion.

mod client;
mod deadline;
mod fuzz;
mod fuzz_stream;
mod grpc;
mod http;
mod lens;
mod many;
mod observation;
mod origin;
mod parity;
mod picture;
mod place;
mod plan;
mod port;
mod print;
mod rig;
mod service;
mod simulation;
mod stuck;
mod web;
mod websocket;
mod who;
