//! Scenarios, end-to-end tests and checks of the repository itself. They are one program, so that everything is
//! linked once; `cargo test -p roundel-tests --test main layering::` runs one module.

mod calibration;
#[cfg(feature = "chessboard")]
mod chessboard;
mod coded;
mod codes;
mod conditions;
mod consistency;
mod detect;
mod documents;
mod elliptical;
mod end_to_end;
mod field_cases;
mod formation;
mod fusion;
mod healing;
mod layering;
mod lens;
mod lens_command;
mod lens_session;
mod localization;
mod moving_cameras;
mod moving_lens;
mod network_video;
mod node;
mod paper;
mod photometry;
mod plans;
mod pose;
mod print;
mod real;
mod recall;
mod recording;
mod renderer;
mod robustness;
mod scenarios;
mod shutter;
mod survey;
mod wording;
