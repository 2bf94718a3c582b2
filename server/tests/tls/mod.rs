//! TLS: handshakes of real programs, certificates and their reload, client certificates, both clients.

mod authority;
mod command_line;
mod files;
mod handshake;
mod mutual;
mod programs;
mod reload;
mod rig;
mod rust_client;
