//! Rotation of a coded roundel about its normal.
//!
//! The rays through the code's zero and its opposite meet the roundel's plane at X = m (n·p)/(n·m);
//! the print's x axis runs from one to the other. An error of the centre moves both equally and
//! rotates nothing. An error δn of the normal moves X along its ray by -X (δn·(X - p))/(n·p), which
//! rotates the axis of a tilted roundel: with the tilt's error δθ, δn = δθ × n, the rotation about
//! the normal is
//!
//! φ = g·δθ + ε      g = -Σ± ± (n·(x̂ × X)) n × (X - p) / (|X₊ - X₋| n·p)
//!
//! so the covariance of the whole rotation is T Σ Tᵀ + σ² n nᵀ, T = I + n gᵀ, with σ the standard
//! deviation that the reading states.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use crate::{
    camera::{Camera, PixelPoint},
    marker::CodeReading,
    pose::RoundelPose,
    rigid::{Covariance6, UNKNOWN_ANGLE_VARIANCE_RAD2, orientation_of_normal},
};

/// Lower limit of the standard deviation of a yaw, by errors of the print itself.
pub const MIN_DEVIATION_RAD: f64 = 1e-3;

/// Adds the yaw of a reading to a pose without yaw. The pose is unchanged without a ray to the
/// code's zero, or if its plane is seen edge-on.
pub fn add(pose: &mut RoundelPose, camera: &Camera, reading: &CodeReading) {
    let (p, n) = (pose.position_m, pose.normal);
    let height = n.dot(&p);
    let intersect = |pixel: PixelPoint| {
        let ray = camera.bearing(pixel).ok()?;
        let along = height / n.dot(&ray);
        (along > 0.0 && along.is_finite()).then(|| ray * along)
    };
    let Some(zero) = intersect(reading.zero) else { return };
    // Without an opposite the centre is the other end.
    let opposite =
        (reading.opposite != reading.zero).then(|| intersect(reading.opposite)).flatten();
    let other = opposite.unwrap_or(p);
    let across = zero - other;
    let length = across.norm();
    if length.is_nan() || length <= 0.0 {
        return;
    }
    let axis = across / length;
    let side = n.cross(&axis);
    let orientation = orientation_of_normal(&n);
    let (x, y) = (orientation * Vector3::x(), orientation * Vector3::y());
    pose.yaw_rad = Some(axis.dot(&y).atan2(axis.dot(&x)));
    let gradient = |end: &Vector3<f64>| n.cross(&(end - p)) * side.dot(end);
    let by_tilt = (gradient(&zero) - gradient(&other)) / (-length * height);
    let by_shift = if opposite.is_some() { Vector3::zeros() } else { side / -length };
    let deviation_rad = reading.yaw_deviation_rad.max(MIN_DEVIATION_RAD);
    pose.covariance = with_yaw(&pose.covariance, &n, &by_shift, &by_tilt, deviation_rad.powi(2));
}

/// Columns x, y and z of a roundel with this normal and yaw.
pub fn axes(normal: &Vector3<f64>, yaw_rad: f64) -> Matrix3<f64> {
    let turn = orientation_of_normal(normal)
        * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
    turn.to_rotation_matrix().into_inner()
}

pub fn from_axes_rad(axes: &Matrix3<f64>) -> f64 {
    let [x, normal] = [0, 2].map(|axis| axes.column(axis).into_owned());
    let x = orientation_of_normal(&normal).inverse() * x;
    x.y.atan2(x.x)
}

/// The yaw of these axes modulo π, in (-π/2, π/2].
pub fn heading_rad(axes: &Matrix3<f64>) -> f64 {
    let yaw_rad = from_axes_rad(axes);
    if yaw_rad > FRAC_PI_2 {
        yaw_rad - PI
    } else if yaw_rad <= -FRAC_PI_2 {
        yaw_rad + PI
    } else {
        yaw_rad
    }
}

/// Axes for another normal: along the line of sight to a position, x still points the same way.
pub fn axes_with_normal(
    axes: &Matrix3<f64>,
    position_m: &Vector3<f64>,
    normal: &Vector3<f64>,
) -> Matrix3<f64> {
    let a = x_with_normal(&axes.column(0).into_owned(), position_m, normal);
    Matrix3::from_columns(&[a, normal.cross(&a), *normal])
}

/// The x axis of [`axes_with_normal`].
pub fn x_with_normal(
    x: &Vector3<f64>,
    position_m: &Vector3<f64>,
    normal: &Vector3<f64>,
) -> Vector3<f64> {
    let sight = position_m.normalize();
    let across = x - sight * sight.dot(x);
    (across - sight * (across.dot(normal) / sight.dot(normal))).normalize()
}

/// The yaw about another normal for which the print's x points the same way in the image.
pub fn transferred_rad(pose: &RoundelPose, yaw_rad: f64, normal: &Vector3<f64>) -> f64 {
    let axes = axes_with_normal(&axes(&pose.normal, yaw_rad), &pose.position_m, normal);
    let x = orientation_of_normal(normal).inverse() * axes.column(0).into_owned();
    x.y.atan2(x.x)
}

pub fn deviation_rad(pose: &RoundelPose) -> f64 {
    let rotation = pose.covariance.fixed_view::<3, 3>(3, 3);
    pose.normal.dot(&(rotation * pose.normal)).max(0.0).sqrt()
}

/// A covariance without information about the yaw, with φ = s·δp + g·δθ + ε.
pub fn with_yaw(
    covariance: &Covariance6,
    normal: &Vector3<f64>,
    by_shift: &Vector3<f64>,
    by_tilt: &Vector3<f64>,
    variance: f64,
) -> Covariance6 {
    let along = normal * normal.transpose();
    let mut tilt = *covariance;
    let mut rotation = tilt.fixed_view_mut::<3, 3>(3, 3);
    rotation -= along * UNKNOWN_ANGLE_VARIANCE_RAD2;
    let mut follow = Covariance6::identity();
    let mut by_position = follow.fixed_view_mut::<3, 3>(3, 0);
    by_position += normal * by_shift.transpose();
    let mut by_rotation = follow.fixed_view_mut::<3, 3>(3, 3);
    by_rotation += normal * by_tilt.transpose();
    let mut whole = follow * tilt * follow.transpose();
    let mut rotation = whole.fixed_view_mut::<3, 3>(3, 3);
    rotation += along * variance;
    (whole + whole.transpose()) * 0.5
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;
    use crate::{
        camera::tests::{camera, lenses},
        marker::Code,
    };

    fn plain(position_m: Vector3<f64>, normal: Vector3<f64>) -> RoundelPose {
        let mut covariance = Covariance6::identity() * 1e-6;
        let mut rotation = covariance.fixed_view_mut::<3, 3>(3, 3);
        rotation += normal * normal.transpose() * UNKNOWN_ANGLE_VARIANCE_RAD2;
        RoundelPose {
            position_m,
            normal,
            normal_likelihood: 1.0,
            other_normal: normal,
            yaw_rad: None,
            yaw_symmetry: 1,
            covariance,
        }
    }

    fn reading(camera: &Camera, pose: &RoundelPose, yaw_rad: f64) -> CodeReading {
        let turn = orientation_of_normal(&pose.normal)
            * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
        let image_of =
            |x: f64| camera.project(&(pose.position_m + turn * Vector3::new(x, 0.0, 0.0))).unwrap();
        let certain = CodeReading::certain(Code { bits: 8, number: 1 }, image_of(0.03));
        CodeReading { opposite: image_of(-0.03), yaw_deviation_rad: 0.01, ..certain }
    }

    #[test]
    fn the_yaw_of_a_drawn_code_is_recovered() {
        let camera = camera(lenses()[1]);
        let normal = Vector3::new(0.5, -0.3, -0.8).normalize();
        let pose = plain(Vector3::new(0.4, 0.2, 1.5), normal);
        for yaw_rad in [-3.0, -1.2, 0.0, 0.7, 2.9] {
            let drawn = reading(&camera, &pose, yaw_rad);
            for opposite in [drawn.opposite, drawn.zero] {
                let mut found = pose.clone();
                add(&mut found, &camera, &CodeReading { opposite, ..drawn });
                assert!((found.yaw_rad.unwrap() - yaw_rad).abs() < 1e-9);
                assert!(found.covariance.cholesky().is_some());
                let rotation = found.covariance.fixed_view::<3, 3>(3, 3);
                let about = normal.dot(&(rotation * normal));
                // Without the opposite, the millimetre of the centre over 30 mm dominates.
                let max = if opposite == drawn.zero { 2e-3 } else { 2e-4 };
                assert!(about > 1e-4 && about < max, "{about}");
            }
        }
    }

    #[test]
    fn covariance_contains_the_rotation_by_a_wrong_normal() {
        let camera = camera(lenses()[1]);
        let normal = Vector3::new(0.5, -0.3, -0.8).normalize();
        let truth = plain(Vector3::new(0.4, 0.2, 1.5), normal);
        let drawn = reading(&camera, &truth, 0.7);
        let mut exact = truth.clone();
        add(&mut exact, &camera, &drawn);
        let orientation = |pose: &RoundelPose| {
            orientation_of_normal(&pose.normal)
                * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), pose.yaw_rad.unwrap())
        };
        for axis in
            [normal.cross(&Vector3::x()).normalize(), normal.cross(&Vector3::y()).normalize()]
        {
            let tilt = axis * 1e-5;
            let turn = UnitQuaternion::from_scaled_axis(tilt);
            let mut wrong = plain(truth.position_m, turn * normal);
            add(&mut wrong, &camera, &drawn);
            let error = (orientation(&wrong) * orientation(&exact).inverse()).scaled_axis();
            // For a tilt with variance 1 and nothing else, the covariance is that of (δθ, n φ).
            let mut only = Covariance6::zeros();
            let mut rotation = only.fixed_view_mut::<3, 3>(3, 3);
            rotation += tilt * tilt.transpose();
            rotation += normal * normal.transpose() * UNKNOWN_ANGLE_VARIANCE_RAD2;
            let mut stated = RoundelPose { covariance: only, ..truth.clone() };
            add(&mut stated, &camera, &drawn);
            let rotation = stated.covariance.fixed_view::<3, 3>(3, 3).into_owned();
            let expected = error * error.transpose() + normal * normal.transpose() * 1e-4;
            assert!((rotation - expected).norm() < 1e-13, "{rotation} {expected}");
        }
    }
}
