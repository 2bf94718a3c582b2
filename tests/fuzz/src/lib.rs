//! The bodies of the fuzz targets, which the server's tests share.

#[path = "../../../server/tests/fuzz/mod.rs"]
pub mod targets;
