//! Rims of one ring: their errors, and their images in a plane in front of the camera.

pub mod information;
pub mod lens_iteration;
pub mod lens_series;
pub mod noise;
pub mod projection;
pub mod rim_pair;
