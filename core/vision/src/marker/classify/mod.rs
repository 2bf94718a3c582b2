//! The kind of a ring, by its two rims.

pub(crate) mod compensation;
pub(crate) mod elliptical;
