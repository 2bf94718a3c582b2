//! Rings with teeth: their rims, code and yaw.
//!
//! | module | content |
//! | --- | --- |
//! | `sampler` | grey levels between pixels |
//! | `plane_map` | from a roundel's plane to the image |
//! | `outline` | rough outline and perspective, by spokes from the core |
//! | `rim_points`, `outer_rim` | outer rim to a fraction of a pixel |
//! | `profile` | grey levels around the teeth |
//! | `decode` | from the profile to a word |
//! | `reader` | a reading, with confidence and zero |
//! | `white_disc` | rim of the white disc between the teeth |
//! | `measure` | all steps in order |

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
