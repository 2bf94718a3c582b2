//! Roundel's wire messages: `roundel/v1/*.proto` and the types generated from them.
//!
//! The same types define the JSON of REST and the WebSocket: field names as in the `.proto` files, nanoseconds as
//! decimal strings (they exceed 2^53), enumerations as lower-case words, absent messages as `null`. The comments in the
//! `.proto` files define meaning, unit and frame of each field.

pub mod json;

/// Messages and services of package `roundel.v1`.
#[allow(missing_docs, clippy::doc_markdown)]
pub mod v1 {
    tonic::include_proto!("roundel.v1");
}

/// Compiled descriptors of all files, for gRPC reflection and schema tests.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));
