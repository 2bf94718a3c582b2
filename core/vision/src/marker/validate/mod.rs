//! Tests of newly found rings.

pub(crate) mod disc_center;
pub(crate) mod elliptical_disc;
pub(crate) mod letter;
pub(crate) mod outline;
