//! One roundel's part of the bundle: its sightings' normal equations, and these without its course.
//!
//! Sightings' errors e = W (p - q), with W of Σ⁻¹ = Wᵀ W, are linear in four control points and one
//! camera's unknowns. With the course's banded block B = L Lᵀ, the cameras' block C and E between them,
//! what the course's elimination leaves to the cameras is C - Eᵀ B⁻¹ E = C - Yᵀ Y, Y = L⁻¹ E (Schur's
//! complement; Brown 1958; Triggs et al., *Bundle adjustment: a modern synthesis*, 2000). A sighting of
//! squared length d² counts by (c² / (c² + d²))² (Geman, McClure 1985), so that what is far off says nothing.

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};

use super::{
    super::recording::Name,
    banded::{Band, Factor, WIDTH},
    camera_block::{ByCamera, MOST, Station, WITHOUT_LENS},
    spline::{Course, Instant},
};

/// What holds a course where nobody sees it: jerk of this size is usual, m/s³.
const JERK_M_S3: f64 = 40.0;

/// Where one camera saw it at an instant.
#[derive(Clone, Debug)]
pub(crate) struct Sight {
    /// Index among the stations.
    pub(crate) camera: usize,
    /// By the camera's clock, since the middle of the recording.
    pub(crate) stamp_s: f64,
    /// In the camera.
    pub(crate) place_m: Vector3<f64>,
    /// W.
    pub(crate) whitener: Matrix3<f64>,
}

/// A roundel with all that was seen of it.
#[derive(Clone, Debug)]
pub(crate) struct Subject {
    /// Of a robot's.
    pub(crate) name: Option<Name>,
    pub(crate) course: Course,
    /// Of a reference: where it was said to be, and how well that is known, metres.
    pub(crate) stated: Option<(Vector3<f64>, f64)>,
    pub(crate) sights: Arc<[Sight]>,
    /// Cameras that saw it, ascending.
    pub(crate) cameras: Arc<[usize]>,
}

/// Normal equations, one roundel's.
struct Normal {
    band: Band,
    /// Rows of the course, columns of its cameras.
    border: Vec<f64>,
    cameras: Vec<f64>,
    course_gradient: Vec<f64>,
    camera_gradient: Vec<f64>,
}

/// What is left to the cameras, and what gives the course from their step.
pub(crate) struct Reduced {
    /// Schur's complement, over the subject's own cameras, row by row.
    pub(crate) information: Vec<f64>,
    pub(crate) gradient: Vec<f64>,
    factor: Factor,
    border: Vec<f64>,
    course_gradient: Vec<f64>,
}

/// A sighting's error and derivatives, all whitened.
struct Said {
    instant: Instant,
    error: Vector3<f64>,
    by_point: Matrix3<f64>,
    by_camera: ByCamera,
}

impl Subject {
    pub(crate) fn new(
        course: Course,
        stated: Option<(Vector3<f64>, f64)>,
        sights: Vec<Sight>,
    ) -> Self {
        let mut cameras: Vec<usize> = sights.iter().map(|sight| sight.camera).collect();
        cameras.sort_unstable();
        cameras.dedup();
        Self { name: None, course, stated, sights: sights.into(), cameras: cameras.into() }
    }

    /// Squared whitened error of each sighting; infinite where the camera cannot see it.
    pub(crate) fn squares(&self, stations: &[Station]) -> impl Iterator<Item = f64> {
        self.sights.iter().map(|sight| {
            let station = &stations[sight.camera];
            let point_m = self.course.at(station.time_s(sight.stamp_s)).position_m;
            station.sees(&point_m).map_or(f64::INFINITY, |seen_m| {
                (sight.whitener * (sight.place_m - seen_m)).norm_squared()
            })
        })
    }

    /// What the errors cost, with everything known of the course beside.
    pub(crate) fn cost(&self, stations: &[Station], scale: f64) -> f64 {
        let seen: f64 = self.squares(stations).map(|square| loss(square, scale)).sum();
        let stated = self.stated.map_or(0.0, |(place_m, deviation_m)| {
            (self.course.points_m[0] - place_m).norm_squared() / (deviation_m * deviation_m)
        });
        let weight = self.jerk_weight();
        let jerks = self.course.points_m.windows(4).map(|points| {
            (points[3] - points[0] + (points[1] - points[2]) * 3.0).norm_squared() * weight
        });
        seen + stated + jerks.sum::<f64>()
    }

    /// The course that suits the cameras as they are.
    pub(crate) fn settled(&self, stations: &[Station], scale: f64) -> Option<Course> {
        let reduced = self.reduce(stations, scale)?;
        Some(self.stepped(&reduced, &vec![0.0; self.cameras.len() * width(stations)]))
    }

    /// Without the course.
    pub(crate) fn reduce(&self, stations: &[Station], scale: f64) -> Option<Reduced> {
        let Normal { band, mut border, mut cameras, mut course_gradient, mut camera_gradient } =
            self.normal(stations, scale);
        let columns = camera_gradient.len();
        let factor = band.factor()?;
        factor.forward(&mut border, columns);
        factor.forward(&mut course_gradient, 1);
        for (row, value) in border.chunks_exact(columns).zip(&course_gradient) {
            for (i, one) in row.iter().enumerate() {
                camera_gradient[i] -= one * value;
                let target = &mut cameras[i * columns..(i + 1) * columns];
                for (to, other) in target.iter_mut().zip(row) {
                    *to -= one * other;
                }
            }
        }
        let gradient = camera_gradient;
        Some(Reduced { information: cameras, gradient, factor, border, course_gradient })
    }

    /// The course after the step of its cameras' unknowns.
    pub(crate) fn stepped(&self, reduced: &Reduced, step: &[f64]) -> Course {
        let columns = step.len();
        let mut change: Vec<f64> =
            std::iter::zip(reduced.border.chunks_exact(columns), &reduced.course_gradient)
                .map(|(row, value)| {
                    value - std::iter::zip(row, step).map(|(a, b)| a * b).sum::<f64>()
                })
                .collect();
        reduced.factor.backward(&mut change);
        let mut course = self.course.clone();
        for (point, change) in course.points_m.iter_mut().zip(change.chunks_exact(3)) {
            *point += Vector3::from_column_slice(change);
        }
        course
    }

    /// What each stretch of time says to the cameras once the course is taken out, Σ over a stretch of
    /// (J - E B⁻¹ ..)ᵀ e: scores whose spread shows how much the errors of one stretch hang together.
    pub(crate) fn scores(
        &self,
        reduced: &Reduced,
        stations: &[Station],
        (scale, stretch_s): (f64, f64),
    ) -> Vec<Vec<f64>> {
        let columns = reduced.gradient.len();
        let stretch = |sight: &Sight| (sight.stamp_s / stretch_s).floor() as i64;
        let mut sights: Vec<&Sight> = self.sights.iter().collect();
        sights.sort_by_key(|sight| stretch(sight));
        sights
            .chunk_by(|one, other| stretch(one) == stretch(other))
            .map(|sights| {
                let mut course = vec![0.0; self.course.points_m.len() * 3];
                let mut score = vec![0.0; columns];
                for sight in sights {
                    let Some(said) = self.said(sight, stations, scale) else { continue };
                    let pull = said.by_point.transpose() * said.error;
                    for knot in 0..said.instant.count {
                        let first = (said.instant.first + knot) * 3;
                        for axis in 0..3 {
                            course[first + axis] += said.instant.weights[knot] * pull[axis];
                        }
                    }
                    let first = self.column(sight.camera, stations);
                    for number in 0..width(stations) {
                        score[first + number] += said.by_camera[number].dot(&said.error);
                    }
                }
                reduced.factor.forward(&mut course, 1);
                for (row, value) in reduced.border.chunks_exact(columns).zip(&course) {
                    for (to, entry) in score.iter_mut().zip(row) {
                        *to -= entry * value;
                    }
                }
                score
            })
            .collect()
    }

    /// The first column of a camera that saw it.
    fn column(&self, camera: usize, stations: &[Station]) -> usize {
        self.cameras.partition_point(|&other| other < camera) * width(stations)
    }

    fn normal(&self, stations: &[Station], scale: f64) -> Normal {
        let rows = self.course.points_m.len() * 3;
        let dims = width(stations);
        let columns = self.cameras.len() * dims;
        let mut normal = Normal {
            band: Band::zeros(rows),
            border: vec![0.0; rows * columns],
            cameras: vec![0.0; columns * columns],
            course_gradient: vec![0.0; rows],
            camera_gradient: vec![0.0; columns],
        };
        self.hold(&mut normal);
        for sight in self.sights.iter() {
            if let Some(said) = self.said(sight, stations, scale) {
                normal.add(&said, self.column(sight.camera, stations), (dims, columns));
            }
        }
        normal
    }

    /// What is known of the course beside what is seen.
    fn hold(&self, normal: &mut Normal) {
        let points_m = &self.course.points_m;
        if let Some((place_m, deviation_m)) = self.stated {
            let weight = 1.0 / (deviation_m * deviation_m);
            for axis in 0..3 {
                normal.band.add(axis, axis, weight);
                normal.course_gradient[axis] += weight * (place_m[axis] - points_m[0][axis]);
            }
        }
        const DIFFERENCE: [f64; 4] = [-1.0, 3.0, -3.0, 1.0];
        let weight = self.jerk_weight();
        for (first, points) in points_m.windows(4).enumerate() {
            let jerk: Vector3<f64> =
                std::iter::zip(points, DIFFERENCE).map(|(point, factor)| point * factor).sum();
            for (i, factor) in DIFFERENCE.iter().enumerate() {
                for axis in 0..3 {
                    let row = (first + i) * 3 + axis;
                    normal.course_gradient[row] -= weight * factor * jerk[axis];
                    for (j, other) in DIFFERENCE.iter().enumerate().take(i + 1) {
                        let column = (first + j) * 3 + axis;
                        normal.band.add(row, column, weight * factor * other);
                    }
                }
            }
        }
    }

    /// Third differences of control points are h³ times the jerk.
    fn jerk_weight(&self) -> f64 {
        (JERK_M_S3 * self.course.knot_s().powi(3)).powi(-2)
    }

    fn said(&self, sight: &Sight, stations: &[Station], scale: f64) -> Option<Said> {
        let station = &stations[sight.camera];
        let instant = self.course.at(station.time_s(sight.stamp_s));
        let (seen_m, by_point, by_camera) = station.sees_with_jacobian(
            &instant.position_m,
            &instant.velocity_m_s,
            sight.stamp_s,
        )?;
        let error = sight.whitener * (sight.place_m - seen_m);
        let trust = scale / (scale + error.norm_squared());
        let whitener = sight.whitener * trust;
        Some(Said {
            instant,
            error: error * trust,
            by_point: whitener * by_point,
            by_camera: by_camera.map(|column| whitener * column),
        })
    }
}

impl Normal {
    /// Adds one sighting of the camera whose unknowns begin at `first`.
    fn add(&mut self, said: &Said, first: usize, (dims, columns): (usize, usize)) {
        let Said { instant, error, by_point, by_camera } = said;
        let square = by_point.transpose() * by_point;
        let pull = by_point.transpose() * error;
        let mut cross = [Vector3::zeros(); MOST];
        for (to, column) in cross.iter_mut().zip(by_camera).take(dims) {
            *to = by_point.transpose() * column;
        }
        for i in 0..instant.count {
            let weight = instant.weights[i];
            let row = (instant.first + i) * 3;
            for axis in 0..3 {
                self.course_gradient[row + axis] += weight * pull[axis];
                let start = (row + axis) * columns + first;
                let target = &mut self.border[start..start + dims];
                for (to, column) in target.iter_mut().zip(&cross) {
                    *to += weight * column[axis];
                }
                for j in 0..=i {
                    let column = (instant.first + j) * 3;
                    let both = weight * instant.weights[j];
                    let reach = if i == j { axis + 1 } else { 3 };
                    for other in 0..reach {
                        self.band.add(row + axis, column + other, both * square[(axis, other)]);
                    }
                }
            }
        }
        for i in 0..dims {
            self.camera_gradient[first + i] += by_camera[i].dot(error);
            for j in 0..dims {
                self.cameras[(first + i) * columns + first + j] += by_camera[i].dot(&by_camera[j]);
            }
        }
    }
}

/// Unknowns of each camera.
pub(crate) fn width(stations: &[Station]) -> usize {
    if stations.iter().any(Station::refines_lens) { MOST } else { WITHOUT_LENS }
}

/// What an error of this square costs: none ever more than `scale`.
pub(crate) fn loss(square: f64, scale: f64) -> f64 {
    if square.is_finite() { scale * square / (scale + square) } else { scale }
}

const _: () = assert!(WIDTH == 4 * 3);
