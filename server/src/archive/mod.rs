//! What is kept: recordings and their replay, the history of objects, and comparisons with other systems.

pub mod eval;
pub mod history;
pub mod record;
pub mod replay;
