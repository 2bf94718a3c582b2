//! Bodies of the fuzz targets in `tests/fuzz`, which `fuzz_corpus` runs on the stored inputs.
//!
//! Each hands bytes from a stranger to the entry point that reads them, and asserts what must hold for any bytes:
//! no panic, results within the documented limits, finite numbers, no error that blames the server. The fuzzer also
//! limits memory and time.
//!
//! | module | bytes | entry point |
//! | --- | --- | --- |
//! | [`camera_file`] | ROS camera_info YAML | `camera_file::load_with_uncertainty` |
//! | [`configuration`] | TOML of a client's check request | `Config::parse_request`, `edit` |
//! | [`mjpeg`] | length of the chunks, and a multipart stream | `JpegSplitter` |
//! | [`picture`] | PNG, JPEG, BMP or PGM | `image_file::load`, `SentPicture::pixels` |
//! | [`push`] | a `PushRequest` | `Push.Send`, the source of the camera, fusion, drawing |
//! | [`query`] | path and query below `/api/v1/` | the HTTP router |
//! | [`recording`] | MCAP | `roundel info`, `eval`, `replay --output` |
//! | [`truth`] | trajectories as CSV or TUM | `truth::read`, `evaluate` |
//! | [`websocket`] | kind of the message, and its content | `/api/v1/stream` |
//!
//! The crate of the fuzz targets includes this folder, so no module here uses `crate`.

pub mod camera_file;
pub mod configuration;
pub mod lab;
pub mod mjpeg;
pub mod picture;
pub mod push;
pub mod query;
pub mod recording;
pub mod truth;
pub mod websocket;
