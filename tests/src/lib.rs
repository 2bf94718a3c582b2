//! What judges Roundel: an independent renderer with known truth, and what runs and scores a server.
//!
//! The renderer shares no projection, distortion, pose or rendering code with `roundel-core`, so a
//! mistake in one of them cannot cancel against itself:
//!
//! | module | makes |
//! | --- | --- |
//! | [`normal`] | the normal distribution: cumulative function, quantiles, a seeded generator |
//! | [`optics`] | pinhole cameras with `plumb_bob` and `equidistant` lenses, forward and inverse |
//! | [`coverage`] | how much of each pixel a shape covers, blurred, exact by a contour integral |
//! | [`render`] | 8-bit frames of roundels that move, over a background |
//! | [`bound`] | the Cramér-Rao bound of a roundel's pose in such a frame |
//! | [`coded`] | coded roundels, shown and read |
//! | [`clutter`] | seeded backgrounds that hold no roundel |
//! | [`decoy`] | what resembles a roundel and is none |
//! | [`arena`] | cameras and robots on smooth paths, with the truth at any time |
//! | [`sensor`] | what those cameras would tell of the robots, without pixels, with the errors stated |
//! | [`export`] | such an arena as an installation on disk, for `roundel serve` |
//! | [`pipeline`] | core's own way from such frames to detections and world poses, without a server |
//! | [`plans`] | what the plan of an installation foretells, beside what happens |
//! | [`precision`] | single poses drawn at random, with their errors next to the bound |
//! | [`recall`] | what of shown roundels is found, and what else |
//! | [`paper`] | the paper's experiments, beside its figures |
//! | [`rival`] | prints that other detectors look for |
//! | [`chaos`] | servers under faults that a seed chooses, and the promises that they keep |
//! | [`soak`] | days of operation in minutes, and what grows meanwhile |
//! | [`python`] | Python with packages from PyPI, for tests that need them |
//! | [`scenario`] | what fusion has to hold: seeded worlds, their bars, one table |
//! | [`recorded`] | what such cameras see, recorded by a server that runs |
//! | [`score`] | snapshots against the truth: normalized errors, swaps, rms |
//! | [`survey`] | recordings that an arena is calibrated from, and how far off the result is |
//! | [`healing`] | cameras that are bumped and drift, and what the watch makes of it |
//! | [`process`] | a real server process: built, started, read, ended |
//! | [`layering`] | rules for dependencies and imports, checked on source text |
//! | [`timing`] | times of following and searching with poses |
//! | [`shared_data`] | the recordings beside the repository, where they are there |

pub mod arena;
pub mod board;
pub mod bound;
pub mod chaos;
pub mod clutter;
pub mod coded;
pub mod coverage;
pub mod decoy;
pub mod elliptical;
pub mod export;
pub mod healing;
pub mod layering;
pub mod normal;
pub mod optics;
pub mod paper;
pub mod passing;
pub mod pipeline;
pub mod plans;
pub mod precision;
pub mod process;
pub mod python;
pub mod recall;
pub mod recorded;
pub mod render;
pub mod rival;
pub mod scenario;
pub mod score;
pub mod sensor;
pub mod shared_data;
pub mod soak;
pub mod survey;
pub mod timing;
