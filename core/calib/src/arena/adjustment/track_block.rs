//! Normal equations of one roundel's sightings, and their reduction to the cameras.
//!
//! Whitened residuals e = W (p - q) with Σ⁻¹ = Wᵀ W depend on four control points and the unknowns of one camera. With the
//! spline's banded block B = L Lᵀ, the cameras' block C and the mixed block E, eliminating the spline leaves
//! C - Eᵀ B⁻¹ E = C - Yᵀ Y, Y = L⁻¹ E (Schur complement; Brown 1958; Triggs et al., *Bundle adjustment: a modern
//! synthesis*, 2000). A residual of squared length d² has the weight (c² / (c² + d²))² (Geman, McClure 1985), which
//! suppresses outliers.

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};

use super::{
    super::recording::RoundelKey,
    banded::{Band, Factor, WIDTH},
    camera_block::{CameraBlock, CameraJacobian, POSE_AND_CLOCK, UNKNOWNS},
    spline::{Instant, Spline},
};

/// Typical jerk, the prior where there are no sightings, m/s³.
const JERK_M_S3: f64 = 40.0;

#[derive(Clone, Debug)]
pub(crate) struct Observation {
    /// Index of the camera block.
    pub(crate) camera: usize,
    /// By the camera's clock, seconds since the middle of the recording.
    pub(crate) stamp_s: f64,
    /// In the camera frame.
    pub(crate) position_m: Vector3<f64>,
    /// W.
    pub(crate) whitener: Matrix3<f64>,
}

/// A roundel with all its sightings.
#[derive(Clone, Debug)]
pub(crate) struct TrackBlock {
    /// Key of a moving roundel; `None` for a reference.
    pub(crate) name: Option<RoundelKey>,
    pub(crate) spline: Spline,
    /// Stated position of a reference and its standard deviation, metres.
    pub(crate) stated: Option<(Vector3<f64>, f64)>,
    pub(crate) observations: Arc<[Observation]>,
    /// Cameras that saw it, ascending.
    pub(crate) cameras: Arc<[usize]>,
}

struct Normal {
    band: Band,
    /// Rows of the spline, columns of its cameras.
    border: Vec<f64>,
    cameras: Vec<f64>,
    spline_gradient: Vec<f64>,
    camera_gradient: Vec<f64>,
}

/// Reduced camera equations, and the factors that yield the spline from a camera step.
pub(crate) struct Reduced {
    /// Schur complement over the roundel's cameras, row by row.
    pub(crate) information: Vec<f64>,
    pub(crate) gradient: Vec<f64>,
    factor: Factor,
    border: Vec<f64>,
    spline_gradient: Vec<f64>,
}

/// Whitened residual and derivatives of a sighting.
struct Linearized {
    instant: Instant,
    error: Vector3<f64>,
    by_point: Matrix3<f64>,
    by_camera: CameraJacobian,
}

impl TrackBlock {
    pub(crate) fn new(
        name: Option<RoundelKey>,
        spline: Spline,
        stated: Option<(Vector3<f64>, f64)>,
        observations: Vec<Observation>,
    ) -> Self {
        let mut cameras: Vec<usize> =
            observations.iter().map(|observation| observation.camera).collect();
        cameras.sort_unstable();
        cameras.dedup();
        let observations = observations.into();
        Self { name, spline, stated, observations, cameras: cameras.into() }
    }

    /// Predicted position of a sighting in its camera; `None` if it has no image.
    pub(crate) fn predict(
        &self,
        observation: &Observation,
        blocks: &[CameraBlock],
    ) -> Option<Vector3<f64>> {
        let block = &blocks[observation.camera];
        block.predict(&self.spline.at(block.time_s(observation.stamp_s)).position_m)
    }

    /// Squared whitened residuals; infinite for points without image.
    pub(crate) fn squares(&self, blocks: &[CameraBlock]) -> impl Iterator<Item = f64> {
        self.observations.iter().map(|observation| {
            self.predict(observation, blocks).map_or(f64::INFINITY, |local_m| {
                (observation.whitener * (observation.position_m - local_m)).norm_squared()
            })
        })
    }

    /// Robust cost of the sightings plus the priors.
    pub(crate) fn cost(&self, blocks: &[CameraBlock], scale: f64) -> f64 {
        let seen: f64 = self.squares(blocks).map(|square| loss(square, scale)).sum();
        let stated = self.stated.map_or(0.0, |(position_m, deviation_m)| {
            (self.spline.points_m[0] - position_m).norm_squared() / (deviation_m * deviation_m)
        });
        let weight = self.jerk_weight();
        let jerks = self.spline.points_m.windows(4).map(|points| {
            (points[3] - points[0] + (points[1] - points[2]) * 3.0).norm_squared() * weight
        });
        seen + stated + jerks.sum::<f64>()
    }

    /// Eliminates the spline.
    pub(crate) fn reduce(&self, blocks: &[CameraBlock], scale: f64) -> Option<Reduced> {
        let Normal { band, mut border, mut cameras, mut spline_gradient, mut camera_gradient } =
            self.normal(blocks, scale);
        let columns = camera_gradient.len();
        let factor = band.factor()?;
        factor.forward(&mut border, columns);
        factor.forward(&mut spline_gradient, 1);
        for (row, value) in border.chunks_exact(columns).zip(&spline_gradient) {
            for (i, one) in row.iter().enumerate() {
                camera_gradient[i] -= one * value;
                let target = &mut cameras[i * columns..(i + 1) * columns];
                for (to, other) in target.iter_mut().zip(row) {
                    *to -= one * other;
                }
            }
        }
        let gradient = camera_gradient;
        Some(Reduced { information: cameras, gradient, factor, border, spline_gradient })
    }

    /// The spline after a step of its cameras.
    pub(crate) fn stepped(&self, reduced: &Reduced, step: &[f64]) -> Spline {
        let columns = step.len();
        let mut change: Vec<f64> =
            std::iter::zip(reduced.border.chunks_exact(columns), &reduced.spline_gradient)
                .map(|(row, value)| {
                    value - std::iter::zip(row, step).map(|(a, b)| a * b).sum::<f64>()
                })
                .collect();
        reduced.factor.backward(&mut change);
        let mut spline = self.spline.clone();
        for (point, change) in spline.points_m.iter_mut().zip(change.chunks_exact(3)) {
            *point += Vector3::from_column_slice(change);
        }
        spline
    }

    /// Gradient that each time block contributes to the cameras after elimination of the spline, Σ (J - E B⁻¹ …)ᵀ e
    /// over the block. The scatter of these scores shows the correlation of errors within a block.
    pub(crate) fn scores(
        &self,
        reduced: &Reduced,
        blocks: &[CameraBlock],
        scale: f64,
        block_s: f64,
    ) -> Vec<Vec<f64>> {
        let columns = reduced.gradient.len();
        let time_block = |observation: &Observation| (observation.stamp_s / block_s).floor() as i64;
        let mut observations: Vec<&Observation> = self.observations.iter().collect();
        observations.sort_by_key(|observation| time_block(observation));
        observations
            .chunk_by(|one, other| time_block(one) == time_block(other))
            .map(|observations| {
                let mut spline = vec![0.0; self.spline.points_m.len() * 3];
                let mut score = vec![0.0; columns];
                for observation in observations {
                    let first = self.column(observation.camera, blocks);
                    if let Some(linearized) = self.linearized(observation, blocks, scale) {
                        let dims = unknowns_per_camera(blocks);
                        linearized.add_gradient(&mut spline, &mut score[first..first + dims]);
                    }
                }
                reduced.factor.forward(&mut spline, 1);
                for (row, value) in reduced.border.chunks_exact(columns).zip(&spline) {
                    for (to, entry) in score.iter_mut().zip(row) {
                        *to -= entry * value;
                    }
                }
                score
            })
            .collect()
    }

    /// First column of a camera.
    fn column(&self, camera: usize, blocks: &[CameraBlock]) -> usize {
        self.cameras.partition_point(|&other| other < camera) * unknowns_per_camera(blocks)
    }

    fn normal(&self, blocks: &[CameraBlock], scale: f64) -> Normal {
        let rows = self.spline.points_m.len() * 3;
        let dims = unknowns_per_camera(blocks);
        let columns = self.cameras.len() * dims;
        let mut normal = Normal {
            band: Band::zeros(rows),
            border: vec![0.0; rows * columns],
            cameras: vec![0.0; columns * columns],
            spline_gradient: vec![0.0; rows],
            camera_gradient: vec![0.0; columns],
        };
        self.add_priors(&mut normal);
        for observation in self.observations.iter() {
            if let Some(linearized) = self.linearized(observation, blocks, scale) {
                normal.add(&linearized, self.column(observation.camera, blocks), dims, columns);
            }
        }
        normal
    }

    /// Adds the stated position of a reference and the prior of the jerk.
    fn add_priors(&self, normal: &mut Normal) {
        let points_m = &self.spline.points_m;
        if let Some((position_m, deviation_m)) = self.stated {
            let weight = 1.0 / (deviation_m * deviation_m);
            for axis in 0..3 {
                normal.band.add(axis, axis, weight);
                normal.spline_gradient[axis] += weight * (position_m[axis] - points_m[0][axis]);
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
                    normal.spline_gradient[row] -= weight * factor * jerk[axis];
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
        (JERK_M_S3 * self.spline.knot_s.powi(3)).powi(-2)
    }

    fn linearized(
        &self,
        observation: &Observation,
        blocks: &[CameraBlock],
        scale: f64,
    ) -> Option<Linearized> {
        let block = &blocks[observation.camera];
        let instant = self.spline.at(block.time_s(observation.stamp_s));
        let (local_m, by_point, by_camera) = block.predict_with_jacobian(
            &instant.position_m,
            &instant.velocity_m_s,
            observation.stamp_s,
        )?;
        let error = observation.whitener * (observation.position_m - local_m);
        let trust = scale / (scale + error.norm_squared());
        let whitener = observation.whitener * trust;
        Some(Linearized {
            instant,
            error: error * trust,
            by_point: whitener * by_point,
            by_camera: by_camera.map(|column| whitener * column),
        })
    }
}

impl Linearized {
    /// Adds the gradient by the spline and by the unknowns of the camera.
    fn add_gradient(&self, spline: &mut [f64], camera: &mut [f64]) {
        let pull = self.by_point.transpose() * self.error;
        for knot in 0..self.instant.count {
            let first = (self.instant.first + knot) * 3;
            for axis in 0..3 {
                spline[first + axis] += self.instant.weights[knot] * pull[axis];
            }
        }
        for (sum, column) in camera.iter_mut().zip(&self.by_camera) {
            *sum += column.dot(&self.error);
        }
    }
}

impl Normal {
    /// Adds a sighting of the camera whose columns begin at `first`.
    fn add(&mut self, linearized: &Linearized, first: usize, dims: usize, columns: usize) {
        let camera_gradient = &mut self.camera_gradient[first..first + dims];
        linearized.add_gradient(&mut self.spline_gradient, camera_gradient);
        let Linearized { instant, by_point, by_camera, .. } = linearized;
        let square = by_point.transpose() * by_point;
        let mut cross = [Vector3::zeros(); UNKNOWNS];
        for (to, column) in cross.iter_mut().zip(by_camera).take(dims) {
            *to = by_point.transpose() * column;
        }
        for i in 0..instant.count {
            let weight = instant.weights[i];
            let row = (instant.first + i) * 3;
            for axis in 0..3 {
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
            for j in 0..dims {
                self.cameras[(first + i) * columns + first + j] += by_camera[i].dot(&by_camera[j]);
            }
        }
    }
}

pub(crate) fn unknowns_per_camera(blocks: &[CameraBlock]) -> usize {
    if blocks.iter().any(|block| block.lens.is_some()) { UNKNOWNS } else { POSE_AND_CLOCK }
}

/// Geman-McClure loss of a squared residual, bounded by `scale`.
pub(crate) fn loss(square: f64, scale: f64) -> f64 {
    if square.is_finite() { scale * square / (scale + square) } else { scale }
}

const _: () = assert!(WIDTH == 4 * 3);
