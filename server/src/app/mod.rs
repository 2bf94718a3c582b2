//! The program: wires the modules together, and reads the command line.

pub mod cli;
pub mod replay_server;
pub mod serve;
