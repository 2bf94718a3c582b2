//! What is measured once, so that everything else can be right: lenses, with the board for that, and where cameras
//! stand.

pub mod arena;
pub mod board;
pub mod checkerboard;
mod least_squares;
pub mod lens;
pub mod watch;
