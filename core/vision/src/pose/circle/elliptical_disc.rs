//! A roundel with an elliptical disc: pose from both rims, and heading.
//!
//! **Pose.** The outer rim is the image of a circle. The disc's rim contributes its size and its
//! centre, as the circle of the same area: with the matrices **O** and **I** of the rims
//! (`marker::elliptical`) and the disc's semiaxes p and q over the outer radius, the image of that
//! circle has the matrix √(det **I**/det **O**) **O**. Perspective shifts the image of a conic in
//! the plane by its matrix times a vector k that depends on the tilt, so the centres of the rims
//! lie (1 - **S**) k apart, with **S** = diag(p², q²) rotated by the heading, and those of outer
//! rim and circle (1 - p q) k. In the image 1 - **S** becomes 1 - **I** **O**⁻¹, which gives the
//! circle's centre for either normal. The disc's elongation is used for the heading only, so its
//! errors do not enter the tilt.
//!
//! **Heading.** Rays through evenly spaced points t of the disc's rim meet the roundel's plane at
//! X(t). Their first harmonics A = (a b) are the semiaxes there, and the longer axis is the first
//! eigenvector of A Aᵀ. The opposite heading looks the same, so the heading is known modulo π, in
//! (-π/2, π/2].
//!
//! **Covariance.** Errors of the rim's elongation and turn (`rim::information`), with the phase of
//! A, rotate the axes by 2pq/(p² - q²) times their size. An error of the normal adds g·δθ, with g
//! of [`crate::pose::yaw`], here by central differences.
//!
//! **Limits.** Perspective biases the heading by the square of the disc's angular size: 10⁻³ for a
//! roundel 60 px wide at a focal length of 1,100 px and a tilt of 60°. Accuracy:
//! `tests/elliptical.rs` of the tests crate, in both modes.

use nalgebra::{Matrix2, UnitQuaternion, Vector2, Vector3};

use super::closed_form;
use crate::{
    camera::{Camera, PixelPoint},
    ellipse::{Ellipse, Symmetric2},
    marker::{Kind, Ring},
    pose::{
        PoseError, RimNoise, RoundelPose,
        rim::{
            information::Information,
            noise::{DiscWeights, RimErrors, RingNoise},
            rim_pair::{RimEllipse, RingMeasurement},
        },
        yaw,
    },
    rigid::orientation_of_normal,
};

const POINTS: usize = 8;
/// Rotation of the normal for the numerical derivative of the heading, radians.
const STEP_RAD: f64 = 1e-4;

/// As [`crate::pose::locate`], for an elliptical disc.
pub fn locate(
    camera: &Camera,
    kind: &Kind,
    ring: &Ring,
    noise: &RimNoise,
) -> Result<RoundelPose, PoseError> {
    let round = with_round_disc(kind, ring).ok_or(PoseError::NoCircle)?;
    let outer_m = 0.5 * kind.outer_diameter_m;
    let radii_m = [outer_m, outer_m * kind.mean_ratio()];
    let (min_ratio, max_ratio) = kind.ratios();
    // The ends of the longer axis wash out sooner than a circle's rim.
    let disc_px = ring.inner.semi_minor_px * (min_ratio / max_ratio).sqrt();
    let black_px = ring.outer.semi_minor_px * (1.0 - max_ratio);
    let noise =
        RingNoise { disc: DiscWeights::without_shape(), ..noise.for_ring(ring, disc_px, black_px) };
    let mut pose = closed_form::locate(camera, &RingMeasurement::new(&round, radii_m, noise))?;
    let rays = DiscRays::new(camera, &ring.inner)
        .map_err(|source| PoseError::Lens { rim: "inner", source })?;
    let heading = rays.heading(&pose).ok_or(PoseError::NoCircle)?;
    let variance =
        heading.variance_rad2(kind, &ring.inner, &noise.rims[1]).ok_or(PoseError::NoCircle)?;
    pose.yaw_rad = Some(heading.yaw_rad);
    pose.yaw_symmetry = 2;
    let by_tilt = rays.by_tilt(&pose, &heading);
    let deviation_rad = variance.sqrt().max(yaw::MIN_DEVIATION_RAD);
    let still = Vector3::zeros();
    pose.covariance =
        yaw::with_yaw(&pose.covariance, &pose.normal, &still, &by_tilt, deviation_rad.powi(2));
    Ok(pose)
}

/// The ring with a circular disc of the same area; `None` unless its rims are ellipses.
fn with_round_disc(kind: &Kind, ring: &Ring) -> Option<Ring> {
    let (outer, inner) = (&ring.outer, &ring.inner);
    let full = |m: Symmetric2| Matrix2::new(m.uu, m.uv, m.uv, m.vv);
    let (o, i) = (full(outer.matrix()), full(inner.matrix()));
    let apart = Vector2::new(inner.center.u - outer.center.u, inner.center.v - outer.center.v);
    let bent = (Matrix2::identity() - i * o.try_inverse()?).try_inverse()?;
    let moved = bent * apart * (1.0 - kind.mean_ratio().powi(2));
    let scale = inner.mean_radius_px() / outer.mean_radius_px();
    let round = Ellipse {
        center: PixelPoint { u: outer.center.u + moved.x, v: outer.center.v + moved.y },
        semi_major_px: scale * outer.semi_major_px,
        semi_minor_px: scale * outer.semi_minor_px,
        angle_rad: outer.angle_rad,
    };
    round.is_valid().then_some(Ring { inner: round, ..*ring })
}

/// Rays through evenly spaced points of the disc's rim.
pub struct DiscRays([Vector3<f64>; POINTS]);

/// Direction of the disc's longer axis.
pub struct DiscHeading {
    /// About the normal, in (-π/2, π/2].
    pub yaw_rad: f64,
    /// Unit vector, camera frame.
    pub axis: Vector3<f64>,
    /// t of the longer axis.
    phase_rad: f64,
}

impl DiscRays {
    pub fn new(camera: &Camera, inner: &Ellipse) -> Result<Self, crate::camera::LensError> {
        let (sin, cos) = inner.angle_rad.sin_cos();
        let mut rays = [Vector3::zeros(); POINTS];
        for (ray, (cos_t, sin_t)) in rays.iter_mut().zip(phases()) {
            let (x, y) = (inner.semi_major_px * cos_t, inner.semi_minor_px * sin_t);
            *ray = camera.bearing(PixelPoint {
                u: inner.center.u + x * cos - y * sin,
                v: inner.center.v + x * sin + y * cos,
            })?;
        }
        Ok(Self(rays))
    }

    /// `None` if the roundel's plane is seen edge-on.
    pub fn heading(&self, pose: &RoundelPose) -> Option<DiscHeading> {
        self.heading_on(&pose.position_m, &pose.normal)
    }

    fn heading_on(&self, position_m: &Vector3<f64>, normal: &Vector3<f64>) -> Option<DiscHeading> {
        let height = normal.dot(position_m);
        let (mut a, mut b) = (Vector3::zeros(), Vector3::zeros());
        for (ray, (cos_t, sin_t)) in self.0.iter().zip(phases()) {
            let along = height / normal.dot(ray);
            if !(along > 0.0 && along.is_finite()) {
                return None;
            }
            a += ray * (along * cos_t);
            b += ray * (along * sin_t);
        }
        let orientation = orientation_of_normal(normal);
        let in_plane = |v: &Vector3<f64>| (orientation.inverse() * v).xy();
        let (p, q) = (in_plane(&a), in_plane(&b));
        let shape = Symmetric2 {
            uu: p.x * p.x + q.x * q.x,
            uv: p.x * p.y + q.x * q.y,
            vv: p.y * p.y + q.y * q.y,
        };
        let (_, _, yaw_rad) = shape.eigen();
        let axis = orientation * Vector3::new(yaw_rad.cos(), yaw_rad.sin(), 0.0);
        let phase_rad = 0.5 * (2.0 * p.dot(&q)).atan2(p.norm_squared() - q.norm_squared());
        Some(DiscHeading { yaw_rad, axis, phase_rad })
    }

    /// g: rotation of the heading about the normal by an error of the normal, beyond the rotation
    /// they share.
    fn by_tilt(&self, pose: &RoundelPose, heading: &DiscHeading) -> Vector3<f64> {
        let normal = &pose.normal;
        let with_yaw = |about: &Vector3<f64>| {
            let turn = UnitQuaternion::from_scaled_axis(*about);
            let (normal, carried) = (turn * normal, turn * heading.axis);
            let found = self.heading_on(&pose.position_m, &normal)?.axis;
            let sign = carried.dot(&found).signum();
            Some(sign * carried.cross(&found).dot(&normal))
        };
        let mut by_tilt = Vector3::zeros();
        for about in [heading.axis, normal.cross(&heading.axis)] {
            if let (Some(there), Some(back)) =
                (with_yaw(&(about * STEP_RAD)), with_yaw(&(about * -STEP_RAD)))
            {
                by_tilt += about * ((there - back) / (2.0 * STEP_RAD));
            }
        }
        by_tilt
    }
}

impl DiscHeading {
    /// Variance from the errors of the disc's rim alone.
    fn variance_rad2(&self, kind: &Kind, inner: &Ellipse, noise: &RimErrors<f64>) -> Option<f64> {
        let (information, true) = Information::new(&RimEllipse::new(inner), noise) else {
            return None;
        };
        let turn = 1.0 / information.turn;
        let elongation = information.size
            / (information.size * information.elongation - information.size_and_elongation.powi(2));
        let (sin, cos) = (2.0 * self.phase_rad).sin_cos();
        let (min_ratio, max_ratio) = kind.ratios();
        let lever = 2.0 * min_ratio * max_ratio / (max_ratio * max_ratio - min_ratio * min_ratio);
        // The amplitude of a harmonic is √2 times its rms.
        Some(2.0 * lever * lever * (sin * sin * elongation + cos * cos * turn))
    }
}

/// (cos t, sin t) of the points.
fn phases() -> impl Iterator<Item = (f64, f64)> {
    (0..POINTS).map(|point| {
        let (sin, cos) = (std::f64::consts::TAU * point as f64 / POINTS as f64).sin_cos();
        (cos, sin)
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{
        camera::Lens,
        marker::Pattern,
        pose::tests::{camera, pose, rim_of},
    };

    proptest! {
        #[test]
        fn exact_rims_give_pose_and_heading(
            u in 100.0..1820.0f64, v in 100.0..980.0f64, distance_m in 1.5..8.0f64,
            tilt_rad in 0.35..1.05f64, turn_rad in -3.1..3.1f64, yaw_rad in -3.1..3.1f64,
            q in 0.3..0.5f64, lens in 0..2usize,
        ) {
            let lens = [[0.0; 5], [-0.12, 0.04, 0.0008, -0.0006, 0.0]][lens];
            let camera = camera(Lens::PlumbBob(lens));
            let pixel = PixelPoint { u, v };
            let (position_m, normal) = pose(&camera, pixel, distance_m, tilt_rad, turn_rad);
            let turn = orientation_of_normal(&normal)
                * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
            let pattern = Pattern::Elliptical { minor_diameter_m: 0.16 * q };
            let kind = Kind { pattern, ..Kind::plain("", 0.16, 0.096) };
            let ring = Ring {
                unevenness: 0.011,
                ..Ring::of_rims(
                    rim_of(&camera, &position_m, &turn, [0.08; 2]),
                    rim_of(&camera, &position_m, &turn, [0.048, 0.08 * q]),
                )
            };
            let found = crate::pose::locate(&camera, &kind, &ring, &RimNoise::default()).unwrap();
            prop_assert!((found.normal - normal).norm() < 2e-3, "{found:?} {normal}");
            prop_assert!((found.position_m - position_m).norm() < 2e-4 * distance_m);
            let off = (found.yaw_rad.unwrap() - yaw_rad).sin().abs();
            prop_assert!(off < 3e-3, "{off}");
            prop_assert!(found.covariance.cholesky().is_some());
            // Smaller than the variance of an unknown angle, however small the disc.
            prop_assert!(yaw::deviation_rad(&found) < 0.4, "{}", yaw::deviation_rad(&found));
        }
    }
}
