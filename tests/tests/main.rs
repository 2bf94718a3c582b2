//! Scenarios, end-to-end tests and checks of the repository itself. One program, so that everything is linked once;
//! `cargo test -p roundel-tests --test main layering::` runs those of one module.

mod calibration;
#[cfg(feature = "chessboard")]
mod chessboard;
mod code;
mod coded;
mod consistency;
mod detect;
mod documents;
mod elliptical;
mod end_to_end;
mod formation;
mod fusion;
mod healing;
mod layering;
mod lens;
mod lens_command;
mod lens_live;
mod moving_lens;
mod node;
mod paper;
mod photometry;
mod placing;
mod plan;
mod pose;
mod print;
mod real;
mod recall;
mod recording;
mod renderer;
mod riding;
mod robustness;
mod scenarios;
mod shutter;
mod source;
mod survey;
mod wording;
