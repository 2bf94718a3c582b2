//! One ring, measured where it is thought to be.

pub(crate) mod checks;
pub(crate) mod measure;
pub(crate) mod pixels;
pub(crate) mod probe;
pub(crate) mod subpixel;
