//! Cameras on the network, served over loopback: frames counted, times looked at, faults survived, and what is said
//! of them. Waits are generous and end as soon as what they wait for is there.

mod camera;
mod http;
mod rig;
mod trial;
