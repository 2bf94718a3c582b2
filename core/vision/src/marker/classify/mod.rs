//! The kind of a ring, by its two rims.

pub(crate) mod compensation;
pub(crate) mod elliptical;
pub(crate) mod plain;
