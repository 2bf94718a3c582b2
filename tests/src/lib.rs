//! The independent side of Roundel's tests: a renderer with ground truth, simulated arenas, scenarios, and scoring.
//!
//! The renderer shares no projection, distortion, pose or rendering code with `roundel-core`, so an error in one of them
//! cannot cancel against itself.
//!
//! | stage | modules | content |
//! | --- | --- | --- |
//! | rendering | [`random`] | the normal distribution, and a seeded generator |
//! | | [`optics`] | pinhole cameras with `plumb_bob` and `equidistant` lenses, forward and inverse |
//! | | [`half_plane`] | one side of a line, and the part of a polygon there |
//! | | [`coverage`] | share of each pixel that a shape covers, blurred, exact by a contour integral |
//! | | [`mod@print`] | printed roundels, as designed and as printers print them |
//! | | [`light`], [`processing`] | shadows, lamps and glare; noise, sharpening and compression by the camera |
//! | | [`render`] | 8-bit frames of moving prints over a background |
//! | | [`clutter`], [`look_alikes`] | seeded backgrounds without roundels, and shapes that resemble one |
//! | | [`board`], [`other_markers`] | calibration boards, and prints for other detectors |
//! | worlds | [`arena`] | cameras and robots on smooth paths, with the truth at any time |
//! | | [`sensor`] | simulated observations of such cameras without pixels, with known covariances |
//! | | [`export`], [`recorded`] | an arena as an installation on disk, and as a recording by a running server |
//! | scoring | [`bound`] | the Cramér-Rao bound of a roundel's pose in a frame |
//! | | [`score`] | snapshots compared with the truth: normalized errors, swaps, rms |
//! | detection | [`pipeline`] | core's path from frames to detections and tracks, without a server |
//! | | [`precision`], [`rolling_shutter`] | errors of single poses relative to the bound; past a rolling shutter |
//! | | [`coded`], [`elliptical`] | detection of coded roundels, and of elliptical discs |
//! | | [`recall`] | share of roundels found, and false detections |
//! | | [`conditions`] | errors and cost with real prints, light and cameras |
//! | | [`timing`] | times of tracking and searching |
//! | | [`paper`] | the paper's experiments, compared with its figures |
//! | systems | [`scenario`] | seeded scenarios of fusion with bars, in one table |
//! | | [`lab`] | R4 with real prints, light, lenses and lost frames |
//! | | [`survey`] | calibration of arenas, and its errors |
//! | | [`healing`] | bumped and drifting cameras, and the watch's reaction |
//! | | [`plans`] | predictions of `roundel plan` compared with simulation |
//! | | [`chaos`] | servers under seeded faults, and the promises that they keep |
//! | | [`soak`] | days of operation in minutes, and sizes that grow |
//! | tools | [`process`] | server processes |
//! | | [`python`], [`shared_data`] | Python with packages from PyPI; recordings beside the repository |
//! | | [`layering`] | rules for dependencies and imports, checked on source text |
//!
//! The binary's subcommands are in `run`.

// Internal to this crate's tests and programs: most names need no comment.
#![allow(missing_docs)]

pub mod arena;
pub mod board;
pub mod bound;
pub mod chaos;
pub mod clutter;
pub mod coded;
pub mod conditions;
pub mod coverage;
pub mod elliptical;
pub mod export;
pub mod half_plane;
pub mod healing;
pub mod lab;
pub mod layering;
pub mod light;
pub mod look_alikes;
pub mod optics;
pub mod other_markers;
pub mod paper;
pub mod pipeline;
pub mod plans;
pub mod precision;
pub mod print;
pub mod process;
pub mod processing;
pub mod python;
pub mod random;
pub mod recall;
pub mod recorded;
pub mod render;
pub mod rolling_shutter;
pub mod scenario;
pub mod score;
pub mod sensor;
pub mod shared_data;
pub mod soak;
pub mod survey;
pub mod timing;
