//! Paper is not flat.
//!
//! Paper bent to a cylinder of curvature κ lifts a point of a rim by up to κ r²/2 from the plane of the others. In a view
//! at an angle, this moves the disc's rim against the outer one just as perspective does, which alone tells the two
//! normals apart: both displacements are proportional to r² sin θ, with a mean of cos θ/(2 d) for perspective at the
//! distance d, and of κ/4 for the bend. So far from the camera, where perspective is the weaker of the two, a roundel on
//! bent paper shows the wrong normal, however clear the picture is. The evidence for a normal is limited accordingly.

use crate::{marker::Kind, pose::RoundelPose};

/// Standard deviation of the curvature of mounted prints, 1/m.
const CURVATURE_1_M: f64 = 0.3;
/// A greater likelihood than this is that of no other normal.
const MAX_LIKELIHOOD: f64 = 1.0 - 1e-9;

/// Standard deviation of a print's centre along its normal, from the plane through its rims, metres.
pub fn flatness_m(kind: &Kind) -> f64 {
    let radius_m = 0.5 * kind.outer_diameter_m;
    0.25 * CURVATURE_1_M * radius_m * radius_m
}

/// Limits the likelihood of the first normal to what the flatness of paper allows.
///
/// With a signal ±s in noise of variance σ², the log-odds are 2 s x/σ² for an observed x, about 2 s²/σ². A further
/// variance β² reduces these to λ/(1 + λ β²/(2 s²)).
pub(super) fn limit_likelihood(pose: &mut RoundelPose) {
    if pose.normal == pose.other_normal {
        return;
    }
    let distance_m = pose.position_m.norm();
    let cos = -pose.normal.dot(&pose.position_m) / distance_m;
    let bend_over_signal = 0.5 * CURVATURE_1_M * distance_m / cos.max(1e-3);
    let likelihood = pose.normal_likelihood.clamp(0.5, MAX_LIKELIHOOD);
    let odds_ln = (likelihood / (1.0 - likelihood)).ln();
    let limited_ln = odds_ln / (1.0 + 0.5 * odds_ln * bend_over_signal * bend_over_signal);
    pose.normal_likelihood = 1.0 / (1.0 + (-limited_ln).exp());
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::rigid::Covariance6;

    fn limited(distance_m: f64, likelihood: f64) -> f64 {
        let mut pose = RoundelPose {
            position_m: Vector3::new(0.0, 0.0, distance_m),
            normal: Vector3::new(0.0, 0.5, -0.75_f64.sqrt()),
            normal_likelihood: likelihood,
            other_normal: Vector3::new(0.0, -0.5, -0.75_f64.sqrt()),
            yaw_rad: None,
            yaw_symmetry: 1,
            covariance: Covariance6::identity(),
        };
        limit_likelihood(&mut pose);
        pose.normal_likelihood
    }

    #[test]
    fn the_normal_is_certain_only_near_the_camera() {
        assert!(limited(0.5, 1.0) > 0.999_9);
        assert!(limited(2.0, 1.0) > 0.99);
        let far = limited(6.0, 1.0);
        assert!((0.7..0.9).contains(&far), "{far}");
        // Weak evidence remains.
        assert!((limited(6.0, 0.55) - 0.55).abs() < 0.02);
        assert_eq!(limited(6.0, 0.5), 0.5);
    }
}
