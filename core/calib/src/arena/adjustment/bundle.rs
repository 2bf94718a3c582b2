//! Bundle adjustment over all cameras and times.
//!
//! Unknown are each camera's place, clock and, if asked, lens, and every roundel's course. Levenberg and
//! Marquardt's steps are taken on the cameras alone, each roundel's course being eliminated exactly
//! ([`super::track_block`]), one roundel after another on as many cores as there are; sums are made in the
//! roundels' order, so that the same input gives the same bits on any machine with the same arithmetic.
//!
//! The start may be off by centimetres where a sighting is good to half a millimetre, so how far off a
//! sighting may be and still count begins at what is seen and narrows as the median falls
//! (graduated non-convexity: Blake, Zisserman 1987).
//!
//! The covariance is K = H⁻¹ M H⁻¹, with H the cameras' information and M the spread of the scores that
//! stretches of [`STRETCH_S`] contribute (White 1980; Liang, Zeger 1986), since errors of one roundel in one
//! camera hang together for a second or so, which H⁻¹ alone does not know. What the references and the
//! other knowledge beside contribute is in M as stated.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::{
    camera_block::{MOST, Station},
    track_block::{Reduced, Subject, loss, width},
};

/// Sightings' squares count by this much at the end (χ², 3 degrees of freedom: 1 - 10⁻³).
const SCALE: f64 = 16.0;
/// With this all sightings count alike.
const PLAIN: f64 = 1e12;
/// Median of χ² with 3 degrees of freedom.
const MEDIAN: f64 = 2.366;
/// Errors this far apart in time are independent, seconds.
const STRETCH_S: f64 = 5.0;
const MOST_STEPS: usize = 60;
/// A step below this in every unknown, in its deviations, ends it.
const SHORT: f64 = 1e-3;
const MOST_DAMPING: f64 = 1e6;

/// What is known of a camera's unknowns before: deviations of clock and lens; its place is free.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prior {
    /// Offset s, skew, ln f, principal point px, coefficient.
    pub(crate) deviations: [f64; MOST - 6],
}

/// Cameras and roundels.
pub(crate) struct Bundle {
    pub(crate) stations: Vec<Station>,
    pub(crate) subjects: Vec<Subject>,
    pub(crate) priors: Vec<Prior>,
}

/// How it went.
pub(crate) struct Outcome {
    /// Over every camera's unknowns in turn.
    pub(crate) covariance: DMatrix<f64>,
    /// Unknowns of each camera.
    pub(crate) width: usize,
    pub(crate) steps: usize,
    /// By how much errors are larger than was stated, as a ratio of deviations by their median.
    pub(crate) excess: f64,
}

/// Why it ended without a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Failed {
    /// Something is not determined, or not finite.
    Undetermined,
    /// The caller wanted no more of it.
    Cancelled,
}

/// The cameras' equations: everything else is eliminated.
struct Equations {
    information: DMatrix<f64>,
    gradient: DVector<f64>,
    reduced: Vec<Reduced>,
}

impl Bundle {
    /// Adjusts everything. `go_on` is asked before each step, with how many were made and how large the
    /// last one was in the unknowns' deviations.
    pub(crate) fn adjust(
        &mut self,
        mut go_on: impl FnMut(usize, f64) -> bool,
    ) -> Result<Outcome, Failed> {
        self.settle()?;
        let (mut damping, mut length) = (1e-6, f64::INFINITY);
        for step in 0..MOST_STEPS {
            if !go_on(step, length) {
                return Err(Failed::Cancelled);
            }
            let scale = self.scale();
            let equations = self.equations(scale).ok_or(Failed::Undetermined)?;
            let cost = self.cost(scale);
            let mut is_over = false;
            loop {
                let change = solve(&equations, damping).ok_or(Failed::Undetermined)?;
                let moved = self.moved(&equations, &change);
                let better = moved.cost(scale);
                length = self.length(&equations, &change);
                if better <= cost {
                    *self = moved;
                    damping = (damping * 0.1).max(1e-9);
                    break;
                }
                damping = (damping * 10.0).max(1e-6);
                // What cannot be bettered is as good as it gets.
                is_over = length < SHORT || damping > MOST_DAMPING;
                if is_over {
                    break;
                }
            }
            if is_over || length < SHORT {
                return self.outcome(step + 1);
            }
        }
        self.outcome(MOST_STEPS)
    }

    /// Courses for the cameras as they are, first by all sightings alike and then by the best.
    fn settle(&mut self) -> Result<(), Failed> {
        for is_first in [true, false] {
            let scale = if is_first { PLAIN } else { self.scale() };
            let stations = &self.stations;
            let courses: Vec<_> = self
                .subjects
                .par_iter()
                .map(|subject| subject.settled(stations, scale))
                .collect::<Option<_>>()
                .ok_or(Failed::Undetermined)?;
            for (subject, course) in self.subjects.iter_mut().zip(courses) {
                subject.course = course;
            }
        }
        Ok(())
    }

    /// What a square may be and still count by a quarter.
    fn scale(&self) -> f64 {
        SCALE * self.excess_squared().max(1.0)
    }

    /// The median square over what it should be.
    fn excess_squared(&self) -> f64 {
        let mut squares: Vec<f64> = self
            .subjects
            .par_iter()
            .flat_map_iter(|subject| subject.squares(&self.stations))
            .collect();
        excess_squared(&mut squares)
    }

    fn equations(&self, scale: f64) -> Option<Equations> {
        let dims = width(&self.stations);
        let size = dims * self.stations.len();
        let reduced: Vec<Reduced> = self
            .subjects
            .par_iter()
            .map(|subject| subject.reduce(&self.stations, scale))
            .collect::<Option<_>>()?;
        let mut information = DMatrix::zeros(size, size);
        let mut gradient = DVector::zeros(size);
        for (subject, part) in self.subjects.iter().zip(&reduced) {
            let columns = spread(&subject.cameras, dims);
            for (i, &row) in columns.iter().enumerate() {
                gradient[row] += part.gradient[i];
                for (j, &column) in columns.iter().enumerate() {
                    information[(row, column)] += part.information[i * columns.len() + j];
                }
            }
        }
        for (camera, station) in self.stations.iter().enumerate() {
            for (number, value, weight) in self.known(camera, station, dims) {
                let at = camera * dims + number;
                information[(at, at)] += weight;
                gradient[at] -= weight * value;
            }
        }
        Some(Equations { information, gradient, reduced })
    }

    /// Unknown, value and weight of what is known of a camera beside.
    fn known(
        &self,
        camera: usize,
        station: &Station,
        dims: usize,
    ) -> impl Iterator<Item = (usize, f64, f64)> {
        let lens = station.lens_change();
        let values = [station.offset_s, station.skew, lens[0], lens[1], lens[2], lens[3]];
        let deviations = self.priors[camera].deviations;
        (0..dims - 6).map(move |i| (6 + i, values[i], deviations[i].powi(-2)))
    }

    fn moved(&self, equations: &Equations, change: &DVector<f64>) -> Bundle {
        let dims = width(&self.stations);
        let stations = self
            .stations
            .iter()
            .enumerate()
            .map(|(camera, station)| {
                let mut step = [0.0; MOST];
                step[..dims]
                    .copy_from_slice(&change.as_slice()[camera * dims..(camera + 1) * dims]);
                station.moved(&step)
            })
            .collect();
        let subjects = self
            .subjects
            .par_iter()
            .zip(&equations.reduced)
            .map(|(subject, reduced)| {
                let columns = spread(&subject.cameras, dims);
                let step: Vec<f64> = columns.iter().map(|&column| change[column]).collect();
                Subject { course: subject.stepped(reduced, &step), ..subject.clone() }
            })
            .collect();
        Bundle { stations, subjects, priors: self.priors.clone() }
    }

    fn cost(&self, scale: f64) -> f64 {
        let parts: Vec<f64> =
            self.subjects.par_iter().map(|subject| subject.cost(&self.stations, scale)).collect();
        let dims = width(&self.stations);
        let known = self.stations.iter().enumerate().flat_map(|(camera, station)| {
            self.known(camera, station, dims).map(|(_, value, weight)| value * value * weight)
        });
        parts.iter().sum::<f64>() + known.sum::<f64>()
    }

    /// The largest change in deviations of its unknown, were all others known.
    fn length(&self, equations: &Equations, change: &DVector<f64>) -> f64 {
        let along = |i: usize| change[i].abs() * equations.information[(i, i)].sqrt();
        (0..change.len()).map(along).fold(0.0, f64::max)
    }

    fn outcome(&self, steps: usize) -> Result<Outcome, Failed> {
        let scale = self.scale();
        let equations = self.equations(scale).ok_or(Failed::Undetermined)?;
        let covariance = self.covariance(&equations, scale).ok_or(Failed::Undetermined)?;
        let excess = self.excess_squared().sqrt();
        Ok(Outcome { covariance, width: width(&self.stations), steps, excess })
    }

    fn covariance(&self, equations: &Equations, scale: f64) -> Option<DMatrix<f64>> {
        let dims = width(&self.stations);
        let size = equations.gradient.len();
        let inverse = equations.information.clone().cholesky()?.inverse();
        let scores: Vec<Vec<Vec<f64>>> = self
            .subjects
            .par_iter()
            .zip(&equations.reduced)
            .map(|(subject, reduced)| match subject.stated {
                // References stand: their errors are those stated.
                Some(_) => Vec::new(),
                None => subject.scores(reduced, &self.stations, (scale, STRETCH_S)),
            })
            .collect();
        let (mut spread_of, mut stated) = (DMatrix::zeros(size, size), DMatrix::zeros(size, size));
        let mut moving = DMatrix::zeros(size, size);
        let mut stretches = 0;
        for ((subject, reduced), scores) in
            self.subjects.iter().zip(&equations.reduced).zip(&scores)
        {
            let columns = spread(&subject.cameras, dims);
            let target = if subject.stated.is_some() { &mut stated } else { &mut moving };
            for (i, &row) in columns.iter().enumerate() {
                for (j, &column) in columns.iter().enumerate() {
                    target[(row, column)] += reduced.information[i * columns.len() + j];
                    for score in scores {
                        spread_of[(row, column)] += score[i] * score[j];
                    }
                }
            }
            stretches += scores.len();
        }
        for (camera, station) in self.stations.iter().enumerate() {
            for (number, _, weight) in self.known(camera, station, dims) {
                stated[(camera * dims + number, camera * dims + number)] += weight;
            }
        }
        if stretches > 0 {
            // Few stretches say little of many unknowns: what they say on the whole then counts for each.
            let part = |middle: &DMatrix<f64>| (&inverse * middle * &inverse).trace();
            let inflation = part(&spread_of) / part(&moving).max(f64::MIN_POSITIVE);
            let few = size as f64 / (size + stretches) as f64;
            spread_of = spread_of * (1.0 - few) + moving * (inflation * few);
        }
        Some(&inverse * (spread_of + stated) * &inverse)
    }
}

/// The median of squared errors of three components over what it should be; 1 without any.
pub(crate) fn excess_squared(squares: &mut [f64]) -> f64 {
    if squares.is_empty() {
        return 1.0;
    }
    let middle = squares.len() / 2;
    let (_, median, _) = squares.select_nth_unstable_by(middle, f64::total_cmp);
    median.min(1e12) / MEDIAN
}

fn solve(equations: &Equations, damping: f64) -> Option<DVector<f64>> {
    let mut information = equations.information.clone();
    for i in 0..information.nrows() {
        information[(i, i)] *= 1.0 + damping;
    }
    let step = information.cholesky()?.solve(&equations.gradient);
    step.iter().all(|value| value.is_finite()).then_some(step)
}

/// Columns of these cameras' unknowns.
fn spread(cameras: &[usize], dims: usize) -> Vec<usize> {
    cameras.iter().flat_map(|camera| camera * dims..(camera + 1) * dims).collect()
}

/// Whether a sighting of this square counts by less than a quarter.
pub(crate) fn is_outlier(square: f64, excess: f64) -> bool {
    let scale = SCALE * (excess * excess).max(1.0);
    loss(square, scale) > 0.5 * scale
}
