//! Where frames come from.

mod address;

pub use address::{AddressError, ImagesAddress, SimAddress, SimPreset, SourceAddress};
