//! What identifies an object: its code.

pub(super) mod code_vote;
