//! Rings with teeth, measured and read.

pub(crate) mod decode;
pub(crate) mod measure;
pub(crate) mod outer_rim;
pub(crate) mod outline;
pub(crate) mod plane_map;
pub(crate) mod profile;
pub(crate) mod reader;
pub(crate) mod rim_points;
pub(crate) mod sampler;
pub(crate) mod white_disc;
