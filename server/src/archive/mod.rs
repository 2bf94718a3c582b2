//! Recordings and their replay, the history of objects, and evaluation against other systems.

pub mod eval;
pub mod history;
pub mod record;
pub mod replay;
