//! Integration tests of the server: APIs, sources, configuration, recordings. They share one program, so that the
//! server is linked once. `cargo test -p roundel-server --test main api::` runs one module.

mod api;
mod bad_input;
mod fleet;
mod fuzz;
mod fuzz_corpus;
mod history;
mod hostile;
#[cfg(feature = "gst")]
mod media;
mod push;
mod record;
mod replay;
mod setup;
mod source;
mod tls;
mod whole_server;
mod wire;
