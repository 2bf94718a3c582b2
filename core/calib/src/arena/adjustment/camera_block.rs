//! A camera as the bundle sees it: place, clock and lens, and where it sees a point.
//!
//! With R, c of world_from_camera a point at x is at q = Rᵀ (x - c), and of small changes δc, δθ (on the
//! left, in the world), δx: δq = Rᵀ (δx - δc + [x - c]× δθ). A stamp s is at s - o - k (s - s₀) on the time
//! of all. What is measured was computed by the lens that was believed; if the true one differs, the point
//! shows up along the ray that the believed lens gives its pixel, and further off by the ratio of both
//! lenses' magnifications there: [`Station::apparent`].

use nalgebra::{Matrix2x3, Matrix3, SVector, UnitQuaternion, Vector3};

use roundel_vision::{
    camera::{Camera, CameraError, Intrinsics, Lens},
    rigid::Rigid,
};

/// Place 3, turn 3, clock's offset and skew, lens' ln f, principal point 2, first radial coefficient.
pub(crate) const MOST: usize = 12;
/// Without the lens.
pub(crate) const WITHOUT_LENS: usize = 8;
/// Of the lens.
const LENS: usize = MOST - WITHOUT_LENS;
/// Steps of the lens' differences: f, pixels, and of the coefficient.
const STEPS: [f64; LENS] = [1e-4, 0.1, 0.1, 1e-4];

/// Derivatives of a sighting's place in the camera by the camera, in the order of [`MOST`].
pub(crate) type ByCamera = [Vector3<f64>; MOST];

/// One camera's unknowns.
#[derive(Clone, Debug)]
pub(crate) struct Station {
    pub(crate) world_from_camera: Rigid,
    pub(crate) offset_s: f64,
    pub(crate) skew: f64,
    /// What measurements were computed with, and what its lens is now thought to be.
    lens: Option<Lenses>,
}

#[derive(Clone, Debug)]
struct Lenses {
    believed: Camera,
    change: [f64; LENS],
    now: Camera,
    /// The same with one number changed by its step.
    stepped: [Camera; LENS],
}

impl Station {
    /// `lens` only where it is to be refined.
    pub(crate) fn new(world_from_camera: Rigid, offset_s: f64, lens: Option<&Camera>) -> Self {
        let lens = lens.and_then(|believed| Lenses::new(believed, [0.0; LENS]).ok());
        Self { world_from_camera, offset_s, skew: 0.0, lens }
    }

    /// How many unknowns it has.
    pub(crate) fn refines_lens(&self) -> bool {
        self.lens.is_some()
    }

    /// By how much the lens differs from what was believed: ln f, principal point, coefficient.
    pub(crate) fn lens_change(&self) -> [f64; LENS] {
        self.lens.as_ref().map_or([0.0; LENS], |lens| lens.change)
    }

    /// The lens as it is now thought to be.
    pub(crate) fn lens(&self) -> Option<&Camera> {
        self.lens.as_ref().map(|lens| &lens.now)
    }

    /// On the time of all, from the camera's own, both since the middle of the recording.
    pub(crate) fn time_s(&self, stamp_s: f64) -> f64 {
        stamp_s - self.offset_s - self.skew * stamp_s
    }

    /// Where the camera measures what is at `point_m` of the world; `None` where it cannot see it.
    pub(crate) fn sees(&self, point_m: &Vector3<f64>) -> Option<Vector3<f64>> {
        let seen_m = self.world_from_camera.inverse_transform_point(&(*point_m).into()).coords;
        match &self.lens {
            Some(lens) => lens.apparent(&lens.now, &seen_m),
            None => Some(seen_m),
        }
    }

    /// What [`Station::sees`] gives, its derivative by the point, and by the camera.
    pub(crate) fn sees_with_jacobian(
        &self,
        point_m: &Vector3<f64>,
        velocity_m_s: &Vector3<f64>,
        stamp_s: f64,
    ) -> Option<(Vector3<f64>, Matrix3<f64>, ByCamera)> {
        let place = &self.world_from_camera;
        let back = place.rotation.inverse().to_rotation_matrix().into_inner();
        let arm_m = point_m - place.translation.vector;
        let seen_m = back * arm_m;
        let turn = back * arm_m.cross_matrix();
        let slip = -(back * velocity_m_s);
        let mut by = [Vector3::zeros(); MOST];
        for axis in 0..3 {
            by[axis] = -back.column(axis);
            by[3 + axis] = turn.column(axis).into_owned();
        }
        (by[6], by[7]) = (slip, slip * stamp_s);
        let Some(lens) = &self.lens else { return Some((seen_m, back, by)) };
        // The lens' own change is so small that it turns the other derivatives by no more than itself.
        let apparent_m = lens.apparent(&lens.now, &seen_m)?;
        for (number, stepped) in lens.stepped.iter().enumerate() {
            let moved_m = lens.apparent(stepped, &seen_m)?;
            by[WITHOUT_LENS + number] = (moved_m - apparent_m) / STEPS[number];
        }
        Some((apparent_m, back, by))
    }

    /// Changed by a step of the unknowns; itself if that is no lens.
    pub(crate) fn moved(&self, step: &[f64]) -> Self {
        let part = |first: usize| SVector::<f64, 3>::from_column_slice(&step[first..first + 3]);
        let place = &self.world_from_camera;
        let turn = UnitQuaternion::from_scaled_axis(part(3));
        let origin_m = place.translation.vector + part(0);
        let lens = self.lens.as_ref().map(|lens| {
            let change = std::array::from_fn(|i| lens.change[i] + step[WITHOUT_LENS + i]);
            Lenses::new(&lens.believed, change).unwrap_or_else(|_| lens.clone())
        });
        Self {
            world_from_camera: Rigid::from_parts(origin_m.into(), turn * place.rotation),
            offset_s: self.offset_s + step[6],
            skew: self.skew + step[7],
            lens,
        }
    }
}

impl Lenses {
    fn new(believed: &Camera, change: [f64; LENS]) -> Result<Self, CameraError> {
        let now = changed(believed, &change)?;
        let step = |number: usize| {
            let mut change = change;
            change[number] += STEPS[number];
            changed(believed, &change)
        };
        let stepped = [step(0)?, step(1)?, step(2)?, step(3)?];
        Ok(Self { believed: believed.clone(), change, now, stepped })
    }

    /// Where the believed lens measures what is truly at `seen_m` and imaged by `lens`.
    fn apparent(&self, lens: &Camera, seen_m: &Vector3<f64>) -> Option<Vector3<f64>> {
        let (pixel, jacobian) = lens.project_with_jacobian(seen_m).ok()?;
        let bearing = self.believed.bearing(pixel).ok()?;
        let (_, believed) = self.believed.project_with_jacobian(&bearing).ok()?;
        let range_m = seen_m.norm();
        // Of one at distance 1 and of one at range_m.
        let ratio = magnification(&believed) / (magnification(&jacobian) * range_m);
        Some(bearing * (range_m * ratio))
    }
}

/// Pixels a unit of length across the line of sight: the root of how a projection scales areas.
fn magnification(jacobian: &Matrix2x3<f64>) -> f64 {
    jacobian.row(0).cross(&jacobian.row(1)).norm().sqrt()
}

fn changed(believed: &Camera, change: &[f64; LENS]) -> Result<Camera, CameraError> {
    let intrinsics = believed.intrinsics();
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

    fn station(with_lens: bool) -> Station {
        let lens = Camera::new(Intrinsics {
            width: 1920,
            height: 1080,
            fx_px: 1100.0,
            fy_px: 1100.0,
            cx_px: 955.0,
            cy_px: 545.0,
            lens: Lens::PlumbBob([-0.08, 0.02, 1e-4, -2e-4, 0.0]),
        })
        .unwrap();
        let turn = UnitQuaternion::from_euler_angles(3.0, 0.1, -0.4);
        let place = Rigid::from_parts(Vector3::new(0.3, -0.2, 5.0).into(), turn);
        let mut station = Station::new(place, 0.01, with_lens.then_some(&lens));
        station.skew = 2e-5;
        station
    }

    #[test]
    fn an_unchanged_lens_changes_nothing() {
        let point = Vector3::new(0.8, 0.4, 0.3);
        let apart = station(true).sees(&point).unwrap() - station(false).sees(&point).unwrap();
        assert!(apart.norm() < 1e-9, "{apart}");
    }

    #[test]
    fn jacobians_are_the_differences() {
        for with_lens in [false, true] {
            let (station, stamp_s) = (station(with_lens), 7.0);
            let velocity = Vector3::new(1.0, -0.5, 0.2);
            // Moves with its velocity, so that the clock's unknowns show.
            let point = |station: &Station| {
                Vector3::new(0.8, 0.4, 0.3) + velocity * station.time_s(stamp_s)
            };
            let (_, by_point, by_camera) =
                station.sees_with_jacobian(&point(&station), &velocity, stamp_s).unwrap();
            let count = if with_lens { MOST } else { WITHOUT_LENS };
            for number in 0..count {
                let size = 1e-5;
                let moved = |sign: f64| {
                    let mut step = [0.0; MOST];
                    step[number] = sign * size;
                    let moved = station.moved(&step);
                    moved.sees(&point(&moved)).unwrap()
                };
                let difference = (moved(1.0) - moved(-1.0)) / (2.0 * size);
                let off = (difference - by_camera[number]).norm();
                assert!(off < 2e-3 * difference.norm().max(0.1), "{number}: {off}");
            }
            for axis in 0..3 {
                let mut step = Vector3::zeros();
                step[axis] = 1e-5;
                let moved = |sign: f64| station.sees(&(point(&station) + step * sign)).unwrap();
                let difference = (moved(1.0) - moved(-1.0)) / 2e-5;
                assert!((difference - by_point.column(axis)).norm() < 1e-3);
            }
        }
    }
}
