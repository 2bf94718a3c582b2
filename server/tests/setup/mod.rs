//! Adding, changing and removing cameras and objects while a whole server runs: effects on other cameras, clients and
//! the configuration file.

mod add_camera;
mod change_camera;
mod coded_robots;
mod configuration;
mod configuration_file;
mod objects;
mod remove_camera;
pub mod rig;
mod server_restart;
