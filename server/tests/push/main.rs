//! Remote programs feed cameras of a server, over real sockets; links are cut and come back.

mod clean;
mod link;
mod picture;
mod proxy;
mod refused;
mod rig;
