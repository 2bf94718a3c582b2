//! Fusion in virtual time: whole scenarios against their truth, and every fault of a stream.

mod arena;
mod body;
mod clock;
mod consistency;
mod docking;
mod fault;
mod ground;
mod heading;
mod life;
mod normal;
mod order;
mod renew;
mod rider;
mod score;
mod sight;
mod trust;
