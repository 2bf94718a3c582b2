//! Further tests of newly found rings, which tracked rings need not pass.
//!
//! | module | rejects |
//! | --- | --- |
//! | `outline` | rims with corners, teeth or gaps |
//! | `disc_center` | discs that are not white to the centre |
//! | `letter` | small letters: o, O, 0 |
//! | `elliptical_disc` | small discs that fit an elliptical kind poorly |

pub(crate) mod disc_center;
pub(crate) mod elliptical_disc;
pub(crate) mod letter;
pub(crate) mod outline;
