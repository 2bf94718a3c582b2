//! Unknowns of one camera: pose, clock and lens; and its prediction of a point.
//!
//! With R, c of world_from_camera, a world point x is at q = Rᵀ (x - c) in the camera. For small δc, δθ (left
//! perturbation) and δx: δq = Rᵀ (δx - δc + [x - c]× δθ). The stamp s corresponds to the time s - o - k (s - s₀).
//! Measurements were computed with the given lens. With another true lens, a point appears along the ray that the given
//! lens assigns to its pixel, at a distance scaled by the ratio of both lenses' magnifications: [`LensEstimate::apparent`].

use nalgebra::{Matrix2x3, Matrix3, SVector, UnitQuaternion, Vector3};

use roundel_vision::{
    camera::{Camera, CameraError, Intrinsics, Lens},
    rigid::Rigid,
};

/// Position 3, rotation 3, clock offset and skew, ln f, principal point 2, first radial coefficient.
pub(crate) const UNKNOWNS: usize = 12;
/// Unknowns without those of the lens.
pub(crate) const POSE_AND_CLOCK: usize = 8;
const LENS: usize = UNKNOWNS - POSE_AND_CLOCK;
/// Steps of the numerical derivatives by the lens: ln f, pixels, coefficient.
const STEPS: [f64; LENS] = [1e-4, 0.1, 0.1, 1e-4];

/// Derivatives of a predicted position in the camera, in the order of [`UNKNOWNS`].
pub(crate) type CameraJacobian = [Vector3<f64>; UNKNOWNS];

#[derive(Clone, Debug)]
pub(crate) struct CameraBlock {
    pub(crate) world_from_camera: Rigid,
    pub(crate) offset_s: f64,
    pub(crate) skew: f64,
    /// Prior deviations of clock and lens; the pose is free.
    prior_deviations: [f64; UNKNOWNS - 6],
    /// The given lens and its current estimate, if it is refined.
    pub(crate) lens: Option<LensEstimate>,
}

#[derive(Clone, Debug)]
pub(crate) struct LensEstimate {
    given: Camera,
    change: [f64; LENS],
    pub(crate) now: Camera,
    /// The current lens with one parameter changed by its step.
    stepped: [Camera; LENS],
}

impl CameraBlock {
    /// `lens` is given only if it must be refined. Prior deviations of offset s, skew, ln f, principal point px and
    /// coefficient.
    pub(crate) fn new(
        world_from_camera: Rigid,
        offset_s: f64,
        prior_deviations: [f64; UNKNOWNS - 6],
        lens: Option<&Camera>,
    ) -> Self {
        let lens = lens.and_then(|given| LensEstimate::new(given, [0.0; LENS]).ok());
        Self { world_from_camera, offset_s, skew: 0.0, prior_deviations, lens }
    }

    /// Index, value and weight of each prior, for the first `dims` unknowns.
    pub(crate) fn priors(&self, dims: usize) -> impl Iterator<Item = (usize, f64, f64)> {
        let lens = self.lens.as_ref().map_or([0.0; LENS], |lens| lens.change);
        let values = [self.offset_s, self.skew, lens[0], lens[1], lens[2], lens[3]];
        let weights = self.prior_deviations.map(|deviation| deviation.powi(-2));
        (6..dims).map(move |number| (number, values[number - 6], weights[number - 6]))
    }

    /// Common time of a stamp, both relative to the middle of the recording.
    pub(crate) fn time_s(&self, stamp_s: f64) -> f64 {
        stamp_s - self.offset_s - self.skew * stamp_s
    }

    /// Measured position of a world point; `None` if it has no image.
    pub(crate) fn predict(&self, point_m: &Vector3<f64>) -> Option<Vector3<f64>> {
        let local_m = self.world_from_camera.inverse_transform_point(&(*point_m).into()).coords;
        match &self.lens {
            Some(lens) => lens.apparent(&lens.now, &local_m),
            None => Some(local_m),
        }
    }

    /// As [`CameraBlock::predict`], with the derivatives by the point and by the camera.
    pub(crate) fn predict_with_jacobian(
        &self,
        point_m: &Vector3<f64>,
        velocity_m_s: &Vector3<f64>,
        stamp_s: f64,
    ) -> Option<(Vector3<f64>, Matrix3<f64>, CameraJacobian)> {
        let place = &self.world_from_camera;
        let back = place.rotation.inverse().to_rotation_matrix().into_inner();
        let arm_m = point_m - place.translation.vector;
        let local_m = back * arm_m;
        let turn = back * arm_m.cross_matrix();
        let clock_shift = -(back * velocity_m_s);
        let mut by = [Vector3::zeros(); UNKNOWNS];
        for axis in 0..3 {
            by[axis] = -back.column(axis);
            by[3 + axis] = turn.column(axis).into_owned();
        }
        (by[6], by[7]) = (clock_shift, clock_shift * stamp_s);
        let Some(lens) = &self.lens else { return Some((local_m, back, by)) };
        // The change of the lens is so small that its effect on the other derivatives is negligible.
        let apparent_m = lens.apparent(&lens.now, &local_m)?;
        for (number, stepped) in lens.stepped.iter().enumerate() {
            let moved_m = lens.apparent(stepped, &local_m)?;
            by[POSE_AND_CLOCK + number] = (moved_m - apparent_m) / STEPS[number];
        }
        Some((apparent_m, back, by))
    }

    /// Applies a step of the first or all unknowns; the lens stays the same if the step makes it invalid.
    pub(crate) fn moved(&self, step: &[f64]) -> Self {
        let part = |first: usize| SVector::<f64, 3>::from_column_slice(&step[first..first + 3]);
        let place = &self.world_from_camera;
        let turn = UnitQuaternion::from_scaled_axis(part(3));
        let origin_m = place.translation.vector + part(0);
        let lens = self.lens.as_ref().map(|lens| {
            let change = std::array::from_fn(|i| lens.change[i] + step[POSE_AND_CLOCK + i]);
            LensEstimate::new(&lens.given, change).unwrap_or_else(|_| lens.clone())
        });
        Self {
            world_from_camera: Rigid::from_parts(origin_m.into(), turn * place.rotation),
            offset_s: self.offset_s + step[6],
            skew: self.skew + step[7],
            prior_deviations: self.prior_deviations,
            lens,
        }
    }
}

impl LensEstimate {
    fn new(given: &Camera, change: [f64; LENS]) -> Result<Self, CameraError> {
        let now = changed(given, &change)?;
        let step = |number: usize| {
            let mut change = change;
            change[number] += STEPS[number];
            changed(given, &change)
        };
        let stepped = [step(0)?, step(1)?, step(2)?, step(3)?];
        Ok(Self { given: given.clone(), change, now, stepped })
    }

    /// Position that the given lens measures for a point at `local_m` imaged by `lens`.
    fn apparent(&self, lens: &Camera, local_m: &Vector3<f64>) -> Option<Vector3<f64>> {
        let (pixel, jacobian) = lens.project_with_jacobian(local_m).ok()?;
        let bearing = self.given.bearing(pixel).ok()?;
        let (_, given) = self.given.project_with_jacobian(&bearing).ok()?;
        let range_m = local_m.norm();
        // Magnifications at distance 1 and at range_m.
        let ratio = magnification(&given) / (magnification(&jacobian) * range_m);
        Some(bearing * (range_m * ratio))
    }
}

/// Pixels per unit of length across the line of sight: square root of the area scale of a projection.
fn magnification(jacobian: &Matrix2x3<f64>) -> f64 {
    jacobian.row(0).cross(&jacobian.row(1)).norm().sqrt()
}

fn changed(given: &Camera, change: &[f64; LENS]) -> Result<Camera, CameraError> {
    let intrinsics = given.intrinsics();
    let mut lens = intrinsics.lens;
    let first = match &mut lens {
        Lens::PlumbBob(coefficients) => &mut coefficients[0],
        Lens::Rational(coefficients) => &mut coefficients[0],
        Lens::Equidistant(coefficients) => &mut coefficients[0],
    };
    *first += change[3];
    Camera::new(Intrinsics {
        fx_px: intrinsics.fx_px * change[0].exp(),
        fy_px: intrinsics.fy_px * change[0].exp(),
        cx_px: intrinsics.cx_px + change[1],
        cy_px: intrinsics.cy_px + change[2],
        lens,
        ..intrinsics.clone()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_world::camera;

    fn block(with_lens: bool) -> CameraBlock {
        let lens = Lens::PlumbBob([-0.08, 0.02, 1e-4, -2e-4, 0.0]);
        let lens = camera((1920, 1080), [1100.0, 1100.0, 955.0, 545.0], lens);
        let turn = UnitQuaternion::from_euler_angles(3.0, 0.1, -0.4);
        let place = Rigid::from_parts(Vector3::new(0.3, -0.2, 5.0).into(), turn);
        let mut block = CameraBlock::new(place, 0.01, [1.0; 6], with_lens.then_some(&lens));
        block.skew = 2e-5;
        block
    }

    #[test]
    fn an_unchanged_lens_changes_nothing() {
        let point = Vector3::new(0.8, 0.4, 0.3);
        let apart = block(true).predict(&point).unwrap() - block(false).predict(&point).unwrap();
        assert!(apart.norm() < 1e-9, "{apart}");
    }

    #[test]
    fn jacobians_are_the_differences() {
        for with_lens in [false, true] {
            let (block, stamp_s) = (block(with_lens), 7.0);
            let velocity = Vector3::new(1.0, -0.5, 0.2);
            // Moves with its velocity, so that the clock has an effect.
            let point = |block: &CameraBlock| {
                Vector3::new(0.8, 0.4, 0.3) + velocity * block.time_s(stamp_s)
            };
            let (_, by_point, by_camera) =
                block.predict_with_jacobian(&point(&block), &velocity, stamp_s).unwrap();
            let count = if with_lens { UNKNOWNS } else { POSE_AND_CLOCK };
            for number in 0..count {
                let size = 1e-5;
                let moved = |sign: f64| {
                    let mut step = [0.0; UNKNOWNS];
                    step[number] = sign * size;
                    let moved = block.moved(&step);
                    moved.predict(&point(&moved)).unwrap()
                };
                let difference = (moved(1.0) - moved(-1.0)) / (2.0 * size);
                let off = (difference - by_camera[number]).norm();
                assert!(off < 2e-3 * difference.norm().max(0.1), "{number}: {off}");
            }
            for axis in 0..3 {
                let mut step = Vector3::zeros();
                step[axis] = 1e-5;
                let moved = |sign: f64| block.predict(&(point(&block) + step * sign)).unwrap();
                let difference = (moved(1.0) - moved(-1.0)) / 2e-5;
                assert!((difference - by_point.column(axis)).norm() < 1e-3);
            }
        }
    }
}
