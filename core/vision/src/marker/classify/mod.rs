//! The kind of a ring by its two rims, and the compensation of the rims for that kind (paper, sections 3.4 and 3.5).
//!
//! | module | content |
//! | --- | --- |
//! | `compensation` | the common shift of both rims, eqs. (7) and (8) |
//! | `plain` | kinds by the ratio of diameters |
//! | `elliptical` | kinds by the disc's two axes |

pub(crate) mod compensation;
pub(crate) mod elliptical;
pub(crate) mod plain;
