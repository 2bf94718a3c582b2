//! The experiments of the paper's section 6, repeated with simulated cameras and the real detector and pose
//! estimation, beside the paper's figures.
//!
//! In: the names of tables, and the number of pictures. Out: a [`Table`] each. Its rows have the paper's measurement
//! and prediction, the sensor model's prediction for this measurement ([`model`]), the measurement, and a sentence on
//! the differences.
//!
//! [`scene`] and [`hall`] define the cameras and the hall, from the paper's statements and from documented choices. A
//! rendered lens matches its model exactly; the paper's did not, and most of its error comes from there. So precision
//! is measured with lenses as Roundel's own calibration finds them in rendered views, never with the true ones.
//!
//! `cargo run --release -p roundel-tests -- paper [--short] [NAME…]`; `tests/paper.md` has the result.

mod base;
mod comparison;
mod datasets;
pub mod hall;
pub mod lens;
pub mod model;
mod moving;
mod opencv;
pub mod precision;
pub mod predictions;
mod range;
pub mod scene;
mod sizes;
mod speed;
pub mod table;

pub use table::{Aim, Row, Table};

/// The text above all tables, so that the program's output is the whole of `tests/paper.md`.
pub const INTRODUCTION: &str = "\
# The paper's experiments, repeated

    cargo run --release -p roundel-tests -- paper > tests/paper.md

repeats section 6 of Krajník et al., *A Practical Multirobot Localization System*, 2014, with simulated cameras and
Roundel's unmodified detector, poses and calibration. `-- NAME…` selects tables (table1 to table8, fig6, sizes), `--short`
renders fewer pictures. `cargo test -p roundel-tests --test main paper::` requires the rows of precision and range to be better than
the paper's. The program fails if a row is worse and gives no reason.

| column | content |
| --- | --- |
| paper | measurement of the paper |
| its model | prediction of the paper's model |
| our model | prediction for this measurement: equations 12 to 20 as corrected in [errata.md](../core/docs/errata.md), or that of `roundel plan` where the table says so |
| here | measurement in simulation |
| better by | improvement over the paper's measurement |
| why | deviation from our model if it is a tenth or more, and its cause |

`tests/src/paper/scene.rs`, `hall.rs`, `moving.rs` and `datasets.rs` document the assumptions about cameras and halls that the paper does not
describe. Rendered pictures have no vignetting, no compression, and lenses that match their model, so distances and errors are those of an ideal
camera. Precision is measured with lenses as `roundel calibrate lens` finds them in rendered views.
";

/// A sentence about the machine that the tables were made on.
pub fn machine() -> String {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    format!("Machine: {threads} threads ({}).\n", speed::processor())
}

/// Number of rendered pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Length {
    /// All rows from few pictures, for tests.
    Short,
    /// For `tests/paper.md`.
    Full,
}

impl Length {
    /// The number that applies.
    pub(crate) fn pick<T>(self, short: T, full: T) -> T {
        match self {
            Self::Short => short,
            Self::Full => full,
        }
    }
}

/// Makes one table.
pub type Experiment = fn(Length) -> anyhow::Result<Table>;

/// All experiments by name.
pub const ALL: [(&str, Experiment); 10] = [
    ("table1", range::table),
    ("table2", base::table),
    ("table3", precision::space),
    ("table4", precision::plane),
    ("fig6", speed::figure),
    ("table5", speed::platforms),
    ("table6", moving::table),
    ("table7", comparison::table),
    ("table8", speed::others),
    ("sizes", sizes::table),
];
