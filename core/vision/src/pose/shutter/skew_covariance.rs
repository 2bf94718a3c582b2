//! Covariance of a pose by the uncertainty of a rolling shutter's skew.
//!
//! In: a pose, and the standard deviation of either component of s in p → p + s (v - v₀), the image
//! of motion under a rolling shutter ([`super`]). Out: the pose with this uncertainty in its
//! covariance.
//!
//! **First order.** An error δs stretches the image by E = δs e_vᵀ, in the plane across the line of
//! sight E' = G⁻¹ E G with the derivative G of the lens. The image of a small roundel is linear,
//! d⁻¹ times the print's axes less their depths, and any E' passes for a pose. With z the line of
//! sight, x along the lean w, and c its cosine,
//!
//! δ ln d = -E_yy   θ_x = -c (E_xy + E_yx)/|w|   θ_y = c (E_xx - E_yy)/|w|   θ_z = -E_xy
//!
//! The roundel's centre is offset from that of a rim by r² f, f = w c, r the rim's radius over the
//! distance. Both rims show this, weighted by their lengths: with q the ratio of their radii and k
//! = q (1 - q), r the outer one's,
//!
//! δα = r² ((1 - k) (δf - 2 f δ ln d) + k E' f)
//!
//! Each component of s adds its outer product to the covariance.
//!
//! **Near face-on**, where |w| vanishes, a stretch of standard deviation ε passes for a lean of
//! √2ε, so 1/√(|w|² + ε/2) replaces 1/|w|. First order misses ε/|w|² of such a lean, half of which
//! is added in all directions. Only rings detected for the first time have an ε large enough to
//! matter.

use nalgebra::{Matrix2, Matrix3, Vector3, Vector6};

use crate::{camera::Camera, marker::Kind, pose::RoundelPose};

/// Share of the lean's effect on the centre that α does not contain, since different fits weight
/// the rims differently.
const CENTER_MISMATCH: f64 = 0.4;

/// `deviation` is that of either component of s.
pub fn widen(pose: &mut RoundelPose, camera: &Camera, kind: &Kind, deviation: f64) {
    let geometry = TiltGeometry::new(pose, kind, deviation);
    let Some(changes) = geometry.changes(camera) else { return };
    for change in changes {
        pose.covariance += change * change.transpose() * (deviation * deviation);
    }
    geometry.add_second_order(pose, deviation);
}

struct TiltGeometry {
    /// x, y and z of the module page.
    axes: [Vector3<f64>; 3],
    range_m: f64,
    /// |w| and c.
    sine: f64,
    cosine: f64,
    /// 1/|w|, limited near face-on.
    per_sine: f64,
    r2: f64,
    k: f64,
}

impl TiltGeometry {
    fn new(pose: &RoundelPose, kind: &Kind, deviation: f64) -> Self {
        let range_m = pose.position_m.norm();
        let z = pose.position_m / range_m;
        let cosine = -pose.normal.dot(&z);
        let lean = pose.normal + z * cosine;
        let sine = lean.norm();
        let x = lean.try_normalize(1e-9).unwrap_or_else(|| across(&z));
        let ratio = kind.inner_diameter_m / kind.outer_diameter_m;
        Self {
            axes: [x, z.cross(&x), z],
            range_m,
            sine,
            cosine,
            per_sine: 1.0 / (sine * sine + 0.5 * deviation).sqrt(),
            r2: (0.5 * kind.outer_diameter_m / range_m).powi(2),
            k: ratio * (1.0 - ratio),
        }
    }

    /// Derivatives of (position, rotation) by either component of s.
    fn changes(&self, camera: &Camera) -> Option<[Vector6<f64>; 2]> {
        let Self { axes: [x, y, z], sine, cosine, per_sine, r2, k, .. } = *self;
        let (_, by_point) = camera.project_with_jacobian(&z).ok()?;
        let slope = Matrix2::from_columns(&[by_point * x, by_point * y]);
        let inverse = slope.try_inverse()?;
        let f = sine * cosine;
        Some([0, 1].map(|part| {
            let e = inverse.column(part) * slope.row(1);
            let deeper = -e.m22;
            let turn_x = -cosine * (e.m12 + e.m21) * per_sine;
            let turn_y = cosine * (e.m11 - e.m22) * per_sine;
            // δw, and δf from it.
            let (along, aside) = (-cosine * turn_y, cosine * turn_x - sine * e.m12);
            let along_f = (cosine - sine * sine / cosine) * along - 2.0 * f * deeper;
            let beside = x * ((1.0 - k) * along_f + k * f * e.m11)
                + y * ((1.0 - k) * cosine * aside + k * f * e.m21);
            let moved = (z * deeper + beside * r2) * self.range_m;
            let turn = x * turn_x + y * turn_y - z * e.m12;
            Vector6::new(moved.x, moved.y, moved.z, turn.x, turn.y, turn.z)
        }))
    }

    /// Terms that first order misses.
    fn add_second_order(&self, pose: &mut RoundelPose, deviation: f64) {
        let share = 0.5 * deviation * self.per_sine * self.per_sine;
        let turn = share * deviation * self.per_sine;
        let by_turn_m =
            self.r2 * self.range_m * (share + CENTER_MISMATCH) * deviation * self.per_sine;
        let (deeper, beside) = (share * deviation * self.range_m, by_turn_m);
        let along = self.axes[2] * self.axes[2].transpose();
        let across = Matrix3::identity() - along;
        let mut position = pose.covariance.fixed_view_mut::<3, 3>(0, 0);
        position += along * (deeper * deeper) + across * (beside * beside);
        let mut rotation = pose.covariance.fixed_view_mut::<3, 3>(3, 3);
        rotation += across * (turn * turn);
    }
}

fn across(axis: &Vector3<f64>) -> Vector3<f64> {
    let helper = if axis.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    axis.cross(&helper).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        camera::{Lens, PixelPoint},
        marker::Ring,
        pose::{
            RimNoise, locate,
            shutter::tests::{observed, skew},
            tests::{camera, pose, rim_of},
        },
        rigid::orientation_of_normal,
    };

    /// Pose and rims of a tilted roundel without motion.
    fn drawn(camera: &Camera, tilt_rad: f64, turn_rad: f64) -> (RoundelPose, Ring) {
        let at = PixelPoint { u: 1200.0, v: 300.0 };
        let (position_m, normal) = pose(camera, at, 3.0, tilt_rad, turn_rad);
        let turn = orientation_of_normal(&normal);
        let rim = |radius_m| rim_of(camera, &position_m, &turn, [radius_m; 2]);
        let ring = Ring::of_rims(rim(0.08), rim(0.032));
        let kind = Kind::plain("", 0.16, 0.064);
        let mut found = locate(camera, &kind, &ring, &RimNoise::default()).unwrap();
        if found.other_normal.angle(&normal) < found.normal.angle(&normal) {
            std::mem::swap(&mut found.normal, &mut found.other_normal);
        }
        (found, ring)
    }

    #[test]
    fn the_pose_follows_the_skew_to_first_order() {
        let kind = Kind::plain("", 0.16, 0.064);
        for lens in [Lens::PlumbBob([0.0; 5]), Lens::Equidistant([0.0; 4])] {
            let camera = camera(lens);
            for (tilt_rad, turn_rad) in [(0.5, 0.3), (0.8, -1.2), (1.0, 2.5), (0.6, 1.5)] {
                let (pose, ring) = drawn(&camera, tilt_rad, turn_rad);
                let step = 1e-5;
                let changes = TiltGeometry::new(&pose, &kind, 0.0).changes(&camera).unwrap();
                for (part, change) in changes.iter().enumerate() {
                    let mut per_row = [0.0; 2];
                    per_row[part] = step;
                    let by = skew(ring.outer.center.v, per_row);
                    let skewed = Ring {
                        outer: observed(&by, &ring.outer),
                        inner: observed(&by, &ring.inner),
                        ..ring
                    };
                    let found = locate(&camera, &kind, &skewed, &RimNoise::default()).unwrap();
                    let normal = [found.normal, found.other_normal]
                        .into_iter()
                        .min_by(|a, b| a.angle(&pose.normal).total_cmp(&b.angle(&pose.normal)))
                        .unwrap();
                    let moved = (found.position_m - pose.position_m) / step;
                    let turned = (normal - pose.normal) / step;
                    let (by_place, by_turn) =
                        (change.fixed_rows::<3>(0), change.fixed_rows::<3>(3));
                    let expected = by_turn.into_owned().cross(&pose.normal);
                    // Omitted terms are smaller by the roundel's angular size, except for a few
                    // thousandths of the centre, on which the rims disagree.
                    let sight = pose.position_m.normalize();
                    let off = moved - by_place;
                    let (deep, beside) = (off.dot(&sight), (off - sight * off.dot(&sight)).norm());
                    assert!(deep.abs() < 0.1 * 3.0, "{part}, {tilt_rad}: {deep}");
                    let max = (by_place - sight * by_place.dot(&sight)).norm();
                    assert!(beside < 0.5 * max, "{part}, {tilt_rad}: {beside} {max}");
                    let off = (turned - expected).norm();
                    assert!(off < 0.1 * (1.0 + expected.norm()), "{part}, {tilt_rad}: {off}");
                }
            }
        }
    }
}
