//! Tools for setting up an arena: lens calibration, printing, planning, and drawing.

pub(crate) mod drawing;
pub mod lens;
pub mod plan;
pub mod print;
