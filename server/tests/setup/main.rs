//! Cameras and objects that are added, changed and removed over the APIs while a whole server runs: what becomes of the others, of
//! clients, and of the configuration's file.

mod add;
mod change;
mod coded;
mod configuration;
mod file;
mod killed;
mod object;
mod remove;
mod rig;
