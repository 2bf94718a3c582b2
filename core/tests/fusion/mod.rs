//! Fusion in virtual time: scenarios against ground truth, and every fault of a stream.

mod arena;
mod arrival_order;
mod body;
mod clock;
mod consistency;
mod docking;
mod ground;
mod heading;
mod lifecycle;
mod mobile_camera;
mod normal;
mod print_size;
mod reconfigure;
mod roundel_camera;
mod score;
mod stream_faults;
mod trust;
