//! What identifies an object: kind and body, and the code that most readings agree on.

mod code_vote;
mod subject;

pub(super) use code_vote::CodeVote;
pub(super) use subject::{CARRIER_NUMBER, Mark, Subject, body_number};
