//! What is measured once, so that everything else can be right: where cameras stand.

pub mod arena;
pub mod watch;
