//! Async client for Roundel servers: live poses of every tracked robot.
//!
//! ```no_run
//! use futures::StreamExt;
//! use roundel_client::{Client, Subscription, Update};
//!
//! # async fn example() -> Result<(), roundel_client::Error> {
//! let client = Client::connect("http://127.0.0.1:7670").await?;
//! let mut snapshots = client.snapshots(Subscription::default().names(["cart"]));
//! while let Some(update) = snapshots.next().await {
//!     match update? {
//!         Update::Snapshot(snapshot) => println!("{:?}", snapshot.objects),
//!         Update::Disconnected { reason, .. } => eprintln!("connection lost: {reason}"),
//!         Update::Reconnected { gap, restarted, .. } => {
//!             let server = if restarted { "restarted server" } else { "same run" };
//!             eprintln!("connected again after {gap:?}: {server}");
//!         }
//!         _ => {} // updates that newer versions may add
//!     }
//! }
//! # Ok(())
//! # }
//! ```
//!
//! Messages are those of [`v1`]; the `.proto` files define meaning, unit and frame of each field. [`Snapshots`] and
//! [`Latest`] reconnect automatically. Every other stream ends with an error when the connection is lost.
//!
//! | for | use |
//! | --- | --- |
//! | every snapshot, with an update for each gap | [`Client::snapshots`] |
//! | the newest snapshot with its age, in a loop with its own rate | [`Client::latest`], [`Latest::recent`] |
//! | predicted poses | [`predicted`], with [`Client::clock_offset`] for the server's current time |
//! | the robots of `roundel demo` | [`Client::drive`], [`Client::push_robot`] |

mod address;
mod backoff;
mod calibration;
mod call_headers;
mod camera_pose;
mod camera_setup;
mod client;
mod clock;
mod configuration;
mod connect_options;
mod connector;
mod error;
mod latest;
mod object_setup;
mod object_state;
mod predict;
mod push;
mod recording;
mod simulation;
mod snapshot;
mod subscription;
mod tls;

pub use camera_pose::camera_pose_at;
pub use client::{Client, Messages};
pub use clock::ClockOffset;
pub use connect_options::ConnectOptions;
pub use error::Error;
pub use latest::{Latest, Link, LinkState};
pub use object_state::{
    coded, named, position_m, position_sigma_m, speed_m_s, velocity_m_s, yaw_rad,
};
pub use predict::predicted;
pub use push::{Picture, PushOptions, PushStatus, Pusher};
pub use roundel_proto::v1;
pub use snapshot::{Snapshots, Update};
pub use subscription::Subscription;
pub use tonic::Code;

/// Compiles the Rust examples of the clients' README.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
struct Readme;
