//! The experiments of the paper's section 6, repeated before simulated cameras by the real detector and the
//! real poses, and printed beside the paper's figures.
//!
//! In: which tables, and how long. Out: a [`Table`] each, whose rows hold the paper's measurement and
//! prediction, the prediction of the sensor model for what is measured here ([`model`]), and the
//! measurement, with a sentence on what makes the difference.
//!
//! What stands for the paper's cameras and halls is in [`scene`] and [`hall`], each with what the paper
//! says of it and what had to be chosen. A rendered lens is exactly what its model says; the paper's were
//! not, and its error is mostly theirs. So precision is judged with lenses as Roundel's own calibration
//! finds them from rendered views, never with the true ones.
//!
//! `cargo run --release -p roundel-tests --bin paper -- [--short] [NAME…]`; `tests/paper.md` has the result.

mod base;
mod contest;
mod datasets;
pub mod foretold;
pub mod hall;
pub mod lens;
pub mod model;
mod moving;
mod others;
pub mod precision;
mod range;
pub mod scene;
mod sizes;
mod speed;
pub mod table;

use std::process::Command;

pub use table::{Aim, Row, Table};

/// What stands above all tables, so that the program's output is the whole of `tests/paper.md`.
pub const INTRODUCTION: &str = "\
# The paper's experiments, repeated

    cargo run --release -p roundel-tests --bin paper > tests/paper.md

repeats section 6 of Krajník et al., *A Practical Multirobot Localization System*, 2014, before simulated cameras, with
Roundel's detector, poses and calibration as they are; `-- NAME…` does some of it (table1 to table8, fig6, sizes), `--short`
less of each. `cargo test -p roundel-tests --test paper` holds the rows of precision and range to be better than the paper's,
and this program ends with an error where a row is worse without saying why.

Columns: what the paper measured; what its model predicted; what the sensor model (equations 12 to 20, as corrected in
[errata.md](../core/docs/errata.md), or the plan's where a table says so) predicts for what is measured here; what is measured
here; how many times better that is than the paper's measurement; and how far it is from our model where that is a tenth or
more, with what makes the difference. What the paper does not say of its cameras and halls
was chosen, and is told in `tests/src/paper/scene.rs`, `hall.rs`, `moving.rs` and `datasets.rs`. A rendered picture has no
vignetting, no compression and no lens that differs from its model, so that distances and errors are what a camera as
good as that would give. Precision is judged with lenses as `roundel calibrate lens` finds them in rendered views.
";

/// What was run where, for whoever compares: the commit, and the machine.
pub fn state() -> String {
    let git = |arguments: &[&str]| {
        let output = Command::new("git")
            .args(["-C", env!("CARGO_MANIFEST_DIR")])
            .args(arguments)
            .output()
            .ok()
            .filter(|output| output.status.success())?;
        Some(String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let commit =
        git(&["rev-parse", "--short", "HEAD"]).unwrap_or_else(|| "an unknown commit".to_owned());
    // The tables themselves are what is being written.
    let changed =
        git(&["status", "--porcelain", "--untracked-files=no", "--", ":/", ":/!tests/paper.md"])
            .is_some_and(|changed| !changed.is_empty());
    let also = if changed { ", with changes" } else { "" };
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    format!(
        "State: all at {commit}{also}, on a machine of {threads} threads ({}).\n",
        speed::processor()
    )
}

/// How much is rendered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Length {
    /// All rows from few pictures, for tests.
    Short,
    /// For the record.
    Full,
}

impl Length {
    /// One of two numbers.
    pub(crate) fn pick<T>(self, short: T, full: T) -> T {
        match self {
            Self::Short => short,
            Self::Full => full,
        }
    }
}

/// An experiment: makes its table.
pub type Experiment = fn(Length) -> anyhow::Result<Table>;

/// All, by the names that they are asked for with.
pub const ALL: [(&str, Experiment); 10] = [
    ("table1", range::table),
    ("table2", base::table),
    ("table3", precision::space),
    ("table4", precision::plane),
    ("fig6", speed::figure),
    ("table5", speed::platforms),
    ("table6", moving::table),
    ("table7", contest::table),
    ("table8", speed::others),
    ("sizes", sizes::table),
];
