//! Async client for Roundel servers: where every robot is, live.
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
//!         Update::Disconnected { reason, .. } => eprintln!("lost the server: {reason}"),
//!         Update::Reconnected { gap, restarted, .. } => {
//!             eprintln!("back after {gap:?}, {}", if restarted { "started anew" } else { "as it was" });
//!         }
//!         _ => {} // updates that newer versions may add
//!     }
//! }
//! # Ok(())
//! # }
//! ```
//!
//! Messages are those of [`v1`], whose `.proto` files say what each field means, in which unit and
//! frame. [`Snapshots`] and [`Latest`] go on by themselves when the server comes back; everything else is one call
//! or one stream, and ends with an error that says what to do.
//!
//! | for | use |
//! | --- | --- |
//! | every snapshot, and word of gaps | [`Client::snapshots`] |
//! | the newest one, in a loop with a rate of its own, and word of when it is no news | [`Client::latest`], [`Latest::recent`] |
//! | poses a moment later | [`predicted`], with [`Client::clock_offset`] for the server's now |
//! | the robots of `roundel demo` | [`Client::drive`], [`Client::push_robot`] |

mod address;
mod backoff;
mod calibration;
mod client;
mod clock;
mod configuration;
mod deadline;
mod error;
mod latest;
mod object;
mod predict;
mod push;
mod recording;
mod riding;
mod robot;
mod setup;
mod snapshot;
mod state;
mod subscription;

pub use client::{Client, Messages};
pub use clock::ClockOffset;
pub use error::Error;
pub use latest::{Latest, Link, LinkState};
pub use predict::predicted;
pub use push::{Picture, PushOptions, PushStatus, Pusher};
pub use riding::camera_pose_at;
pub use roundel_proto::v1;
pub use snapshot::{Snapshots, Update};
pub use state::{coded, named, position_m, position_sigma_m, speed_m_s, velocity_m_s, yaw_rad};
pub use subscription::Subscription;
pub use tonic::Code;

/// The clients' page, whose Rust is compiled as it stands there.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
struct Readme;
