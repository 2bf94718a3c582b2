//! Wires the modules together to servers and nodes, and implements the command line.

pub mod cli;
pub mod replay_server;
pub mod serve;
