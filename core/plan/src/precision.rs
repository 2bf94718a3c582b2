//! How exactly a roundel would be located.
//!
//! **From the picture.** Rims stray by its noise and blur (`rim`), and [`roundel_vision::pose::locate`] makes the pose's
//! covariance of that, as it does of rings that are seen.
//!
//! **From compensation**, in fast mode. It takes the rims' areas to be as r²; perspective and lens make them a little
//! less so, which moves both rims of a large ring that is tilted or seen from near. By how much follows from the rims as
//! they would be imaged, and where the centre is then is located.
//!
//! **From the wrong normal.** The ring as it is without noise speaks for the right one of its two normals with a
//! likelihood L, by a misfit D = 2 ln(L/(1-L)) of the other one. Noise moves that by a deviation of 2√D, so that the
//! share Φ(-√D/2) of pictures speaks for the wrong one, and puts the centre where that has it. It stands in for the share
//! 1-L by which a single picture's covariance counts it.
//!
//! **From trials.** Where disc or black is hardly wider than the blur, and in fast mode up to 32 px, formulas are off by
//! factors, and what pictures of such a ring give counts: the covariance C of the position becomes S C S, S being the
//! factor along the line of sight l and the one across it (`tried`), S = a l lᵀ + b (I - l lᵀ). The normal's stays as it is.
//!
//! **From the lens** (the paper's Δf of equation 19 and ε of equation 17). The same ring is located through a camera
//! whose parameters are moved by a little: the derivatives J of the position by fx, fy, cx, cy and the coefficients,
//! with their covariance Σ, give J Σ Jᵀ. It is the same from frame to frame, so no filter averages it out.

use nalgebra::{DMatrix, Matrix3, Matrix3xX, Vector3};

use super::{
    Sensor,
    rim::rim_noise,
    sight::{Sighting, is_found, is_read, sight},
    tried::{Factors, factors},
};
use roundel_vision::{
    camera::{Camera, Intrinsics, Lens},
    id::TrackNumber,
    marker::{Kind, Mode, Pattern, Ring, compensated, rim_shift_px},
    normal_distribution,
    pose::{Detection, RimNoise, RoundelPose, locate, other_offset_m},
    rigid::Rigid,
    time::Timestamp,
};

/// Steps of the derivatives by the camera's parameters: pixels, and numbers.
const STEP_PX: f64 = 1e-2;
const STEP: f64 = 1e-5;

/// How well a camera's parameters are known.
#[derive(Clone, Debug, PartialEq)]
pub struct LensDoubt {
    /// Which of the lens' coefficients were estimated, in ascending order; the others are taken as exact.
    pub free: Vec<usize>,
    /// Over fx, fy, cx, cy (pixels) and these coefficients.
    pub covariance: DMatrix<f64>,
}

/// What a camera would make of a roundel.
#[derive(Clone, Debug, PartialEq)]
pub struct Expected {
    /// As imaged.
    pub sighting: Sighting,
    /// Whether its code would be read; true of one without.
    pub is_read: bool,
    /// With the covariance from the picture alone.
    pub pose: RoundelPose,
    /// Of the position by the lens' doubt, camera frame, m²; zero where the lens is exact.
    pub by_lens_m2: Matrix3<f64>,
}

/// What would be made of a roundel at a pose; `None` where it would not be found.
pub fn expect(
    sensor: &Sensor,
    doubt: Option<&LensDoubt>,
    kind: &Kind,
    camera_from_roundel: &Rigid,
) -> Option<Expected> {
    // Most of what a camera does not see is told by its centre alone.
    let center = sensor.camera.project(&camera_from_roundel.translation.vector).ok()?;
    if !sensor.camera.contains(center) {
        return None;
    }
    let sighting = sight(&sensor.camera, kind, &sensor.imaging, camera_from_roundel)?;
    if !is_found(sensor, kind, &sighting) {
        return None;
    }
    let mut pose = modelled(sensor, kind, &sighting)?;
    let Factors { along, across } =
        factors(sensor, kind, &sighting, &camera_from_roundel.translation.vector);
    let sight = pose.position_m.normalize();
    let scaled = Matrix3::identity() * across + sight * sight.transpose() * (along - across);
    let mut of_position = pose.covariance.fixed_view_mut::<3, 6>(0, 0);
    of_position.copy_from(&(scaled * &of_position));
    let mut of_position = pose.covariance.fixed_view_mut::<6, 3>(0, 0);
    of_position.copy_from(&(&of_position * scaled));
    let by_lens_m2 = match doubt {
        Some(doubt) => {
            let (seen_as, noise) = (whole(kind), rim_noise(sensor, kind, &sighting));
            let located = |camera: &Camera| locate(camera, &seen_as, &sighting.ring, &noise);
            let position = |camera: &Camera| Some(located(camera).ok()?.position_m);
            doubt.carried(&sensor.camera, position)?
        }
        None => Matrix3::zeros(),
    };
    let is_read = is_read(sensor, kind, &sighting);
    Some(Expected { sighting, is_read, pose, by_lens_m2 })
}

/// The pose with the covariance that formulas give it; `None` where none is found.
pub(super) fn modelled(sensor: &Sensor, kind: &Kind, sighting: &Sighting) -> Option<RoundelPose> {
    let (seen_as, noise) = (whole(kind), rim_noise(sensor, kind, sighting));
    let mut pose = locate(&sensor.camera, &seen_as, &sighting.ring, &noise).ok()?;
    let apart = other_offset_m(&sensor.camera, &seen_as, &sighting.ring, &noise).ok()?;
    let wrong = wrong_share(pose.normal_likelihood) - (1.0 - pose.normal_likelihood);
    let moved = match sensor.mode {
        Mode::Precise => Vector3::zeros(),
        Mode::Fast => moved_m(&sensor.camera, &seen_as, &sighting.ring),
    };
    let mut of_position = pose.covariance.fixed_view_mut::<3, 3>(0, 0);
    of_position += apart * apart.transpose() * wrong + moved * moved.transpose();
    Some(pose)
}

/// Share of noisy pictures that speak for the wrong normal, of a ring that without noise speaks for the right one with
/// this likelihood.
fn wrong_share(likelihood: f64) -> f64 {
    let misfit = 2.0 * (likelihood / (1.0 - likelihood)).ln().max(0.0);
    normal_distribution::cumulative(-0.5 * misfit.sqrt())
}

/// What compensation moves the position by where the rims' areas are not as the print's: camera frame, metres.
fn moved_m(camera: &Camera, kind: &Kind, ring: &Ring) -> Vector3<f64> {
    if kind.pattern != Pattern::Plain {
        return Vector3::zeros();
    }
    let position = |ring: &Ring| {
        let pose = locate(camera, kind, ring, &RimNoise::default()).ok()?;
        Some(pose.position_m)
    };
    let moved = || {
        let shift_px = rim_shift_px(&ring.outer, &ring.inner, kind.ratio())?;
        let (outer, inner) = compensated(&ring.outer, &ring.inner, shift_px)?;
        Some(position(&Ring { outer, inner, ..*ring })? - position(ring)?)
    };
    moved().unwrap_or_else(Vector3::zeros)
}

/// The fit sees a coded disc's rim whole, if in parts at the teeth's inner and outer ends.
fn whole(kind: &Kind) -> Kind {
    match kind.pattern {
        Pattern::Coded(_) => Kind { pattern: Pattern::Plain, ..kind.clone() },
        Pattern::Plain | Pattern::Elliptical { .. } => kind.clone(),
    }
}

/// Deviation of a position along an axis, metres.
pub(super) fn along_m(position_m2: &Matrix3<f64>, axis: &Vector3<f64>) -> f64 {
    let unit = axis.normalize();
    unit.dot(&(position_m2 * unit)).max(0.0).sqrt()
}

impl Expected {
    /// Of the position, camera frame, m².
    pub fn position_m2(&self) -> Matrix3<f64> {
        self.pose.covariance.fixed_view::<3, 3>(0, 0) + self.by_lens_m2
    }

    /// Deviation along the line of sight, metres.
    pub fn depth_m(&self) -> f64 {
        along_m(&self.position_m2(), &self.pose.position_m)
    }

    /// Root mean square of the deviations along the two directions across the line of sight, metres: what a place on a
    /// known plane square to it is off by in each of its coordinates (2D mode).
    pub fn across_m(&self) -> f64 {
        let depth = self.depth_m();
        (0.5 * (self.position_m2().trace() - depth * depth)).max(0.0).sqrt()
    }

    /// Root mean square of the distance from the truth, metres.
    pub fn position_m(&self) -> f64 {
        self.position_m2().trace().max(0.0).sqrt()
    }

    /// Root mean square of the angle by which the normal is off if the right one of two was taken, radians.
    pub fn normal_rad(&self) -> f64 {
        let rotation = self.pose.covariance.fixed_view::<3, 3>(3, 3).into_owned();
        let about = self.pose.normal.dot(&(rotation * self.pose.normal));
        (rotation.trace() - about).max(0.0).sqrt()
    }

    /// As a worker hands it to fusion, the lens' doubt included.
    pub fn detection(&self) -> Detection {
        let mut pose = self.pose.clone();
        let mut position = pose.covariance.fixed_view_mut::<3, 3>(0, 0);
        position += self.by_lens_m2;
        let (track, capture_time) = (TrackNumber(0), Timestamp::default());
        Detection { track, ring: self.sighting.ring, capture_time, pose: Some(pose) }
    }
}

impl LensDoubt {
    /// Of what follows from a camera's parameters and an image.
    fn carried(
        &self,
        camera: &Camera,
        position: impl Fn(&Camera) -> Option<Vector3<f64>>,
    ) -> Option<Matrix3<f64>> {
        let count = 4 + self.free.len();
        let mut slopes = Matrix3xX::zeros(count);
        for number in 0..count {
            let step = if number < 4 { STEP_PX } else { STEP };
            let at = |step: f64| position(&self.moved(camera, number, step)?);
            slopes.set_column(number, &((at(step)? - at(-step)?) / (2.0 * step)));
        }
        let carried = &slopes * &self.covariance * slopes.transpose();
        Some((carried + carried.transpose()) * 0.5)
    }

    fn moved(&self, camera: &Camera, number: usize, step: f64) -> Option<Camera> {
        let mut to: Intrinsics = camera.intrinsics().clone();
        match number {
            0 => to.fx_px += step,
            1 => to.fy_px += step,
            2 => to.cx_px += step,
            3 => to.cy_px += step,
            _ => {
                let mut coefficients = to.lens.coefficients().to_vec();
                *coefficients.get_mut(self.free[number - 4])? += step;
                to.lens = Lens::from_ros(to.lens.name(), &coefficients)?;
            }
        }
        Camera::new(to).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{reach::before, tests::sensor};
    use super::*;
    use roundel_vision::camera::NormalizedPoint;

    fn face_on(sensor: &Sensor, doubt: Option<&LensDoubt>, diameter_px: f64) -> Expected {
        let kind = Kind::plain("", 0.16, 0.064);
        let distance_m = sensor.camera.intrinsics().fx_px * 0.16 / diameter_px;
        let pose = before(NormalizedPoint::default(), distance_m, 0.0);
        expect(sensor, doubt, &kind, &pose).unwrap()
    }

    /// With the tilt known it would be a seventieth of a percent (the bound of the pixels, which the crate of the tests
    /// finds by differences of rendered images); face-on what the tilt leaves open comes on top.
    #[test]
    fn at_30_px_the_distance_is_known_to_a_fortieth_of_a_percent() {
        let expected = face_on(&sensor(), None, 30.5);
        let share = expected.depth_m() / expected.pose.position_m.norm();
        assert!((1.42e-4..2.9e-4).contains(&share), "{share}");
        // Across it is a matter of the rims' length: 30.5 π 1.4 px, half of it for either direction.
        let px = expected.across_m() / expected.pose.position_m.norm() * 700.0;
        assert!((0.002..0.006).contains(&px), "{px}");
    }

    /// Φ of Abramowitz and Stegun's table 26.1.
    #[test]
    fn noise_takes_the_wrong_normal_as_often_as_its_misfit_says() {
        for (misfit, share) in
            [(0.0, 0.5), (1.0, 0.308_537_5), (4.0, 0.158_655_3), (16.0, 0.022_750_1)]
        {
            let odds = f64::exp(0.5 * misfit);
            let found = wrong_share(odds / (1.0 + odds));
            assert!((found - share).abs() < 1e-6, "{misfit}: {found}");
        }
        assert_eq!(wrong_share(1.0), 0.0);
    }

    /// Perspective leaves the rims of a large ring that is tilted nearer to each other in area than the print has them.
    #[test]
    fn compensation_costs_large_tilted_rings_precision_in_fast_mode() {
        let kind = Kind::plain("", 0.16, 0.064);
        let moved = |diameter_px: f64, tilt_rad: f64| {
            let distance_m = sensor().camera.intrinsics().fx_px * 0.16 / diameter_px;
            let pose = before(NormalizedPoint::default(), distance_m, tilt_rad);
            let seen = sight(&sensor().camera, &kind, &sensor().imaging, &pose).unwrap();
            moved_m(&sensor().camera, &kind, &seen.ring).norm() / distance_m
        };
        let share = moved(100.0, 0.8);
        assert!((1e-4..1e-2).contains(&share), "{share}");
        assert!(moved(25.0, 0.8) < 0.2 * share && moved(100.0, 0.0) < 0.2 * share);
    }

    #[test]
    fn noise_and_a_doubtful_lens_cost_precision() {
        let clean = face_on(&sensor(), None, 30.0).depth_m();
        let mut noisy = sensor();
        noisy.imaging.noise = 4.0;
        let ratio = face_on(&noisy, None, 30.0).depth_m() / clean;
        assert!((1.3..3.0).contains(&ratio), "{ratio}");
        // Both focal lengths off together by a thousandth: so is the distance.
        let mut covariance = DMatrix::zeros(4, 4);
        covariance.view_mut((0, 0), (2, 2)).fill(0.7f64.powi(2));
        let doubt = LensDoubt { free: Vec::new(), covariance };
        let expected = face_on(&sensor(), Some(&doubt), 30.0);
        let by_lens = expected.depth_m().powi(2) - clean.powi(2);
        let share = by_lens.sqrt() / expected.pose.position_m.norm();
        assert!((share / 1e-3 - 1.0).abs() < 0.1, "{share}");
    }
}
