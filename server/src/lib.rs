//! The Roundel server: cameras in, world poses out. Data flows one way, down this list:
//!
//! | module | what it does | owner at run time |
//! | --- | --- | --- |
//! | [`config`], [`camera_file`], [`image_file`] | what people write, read with errors that name the place | the command line |
//! | [`clock`] | the one clock: monotonic, anchored to Unix time once | shared |
//! | [`source`] | frames with capture times, from a URL | the worker |
//! | [`worker`] | newest frame → detections → observations; supervised restarts | one OS thread a camera |
//! | [`fusion`] | drives `core::world`'s state machine; snapshots at a fixed rate | one OS thread |
//! | [`calibration`] | finds where cameras stand while they are served, and keeps it | one OS thread meanwhile |
//! | [`lens`] | finds the lens of a camera while a board is moved before it | one OS thread meanwhile |
//! | [`hub`] | the newest of everything, for whoever asks | shared |
//! | [`record`] | writes what is published and fused into files | one OS thread meanwhile |
//! | [`replay`] | plays such a file through the same hub and APIs | one OS thread meanwhile |
//! | [`eval`] | compares a recording with another system's trajectories | the command line |
//! | [`history`] | keeps where objects were | one OS thread |
//! | [`convert`] | the only place where core's types become proto's | – |
//! | [`api`] | gRPC, REST, WebSocket, metrics and the dashboard on one port | async tasks |
//! | [`roster`] | which cameras there are: added, changed and removed, and written back | shared |
//! | [`print`] | roundels on paper | whoever asks |
//! | [`plan`] | what an installation would reach | whoever asks |
//! | [`trial`] | one try of a source, before a camera is configured with it | whoever asks |
//! | [`serve`] | puts the above together, and takes it apart on shutdown | – |
//! | [`cli`] | the commands of `roundel` | main thread |

pub mod api;
pub mod calibration;
pub mod camera_file;
pub mod cli;
pub mod clock;
pub mod config;
pub mod convert;
mod drawing;
pub mod eval;
pub mod fusion;
pub mod history;
pub mod hub;
pub mod image_file;
pub mod lens;
pub mod plan;
pub mod print;
mod reason;
pub mod record;
pub mod replay;
pub mod roster;
pub mod serve;
pub mod source;
pub mod stop;
mod suggestion;
pub mod trial;
pub mod worker;
