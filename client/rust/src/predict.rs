//! Prediction of snapshots with the server's motion model.

use crate::v1::{ObjectState, Quaternion, Snapshot, Vector3};

/// L: predicted accelerations decay by e^(-t/L).
const ACCELERATION_TIME_CONSTANT_S: f64 = 0.4;

/// The snapshot predicted by `seconds`, which may be negative. Accelerations a decay by e = e^(-t/L), L = 0.4 s. Velocities
/// change by a L (1 - e), positions by v t + a L (t - L (1 - e)). Angular velocities are constant.
///
/// The result has no covariances. Only the server can predict them: see [`crate::Subscription::horizon`]. Subscriptions
/// without covariances receive no accelerations, so their snapshots are predicted by velocities only.
///
/// Returns the snapshot unchanged if `seconds` is not finite.
pub fn predicted(snapshot: &Snapshot, seconds: f64) -> Snapshot {
    let mut later = snapshot.clone();
    if !seconds.is_finite() {
        return later;
    }
    later.pose_time_ns = later.pose_time_ns.saturating_add((seconds * 1e9).round() as i64);
    for object in &mut later.objects {
        predict(object, seconds);
    }
    later
}

fn predict(object: &mut ObjectState, seconds: f64) {
    let decay = (-seconds / ACCELERATION_TIME_CONSTANT_S).exp();
    let integral_s = ACCELERATION_TIME_CONSTANT_S * (1.0 - decay);
    let double_integral_s2 = ACCELERATION_TIME_CONSTANT_S * (seconds - integral_s);
    let acceleration = object.acceleration.unwrap_or_default();
    let velocity = object.velocity.unwrap_or_default();
    if let Some(position) = &mut object.position {
        *position = add_scaled(
            &add_scaled(position, &velocity, seconds),
            &acceleration,
            double_integral_s2,
        );
    }
    object.velocity =
        object.velocity.map(|velocity| add_scaled(&velocity, &acceleration, integral_s));
    object.acceleration = object.acceleration.map(|it| add_scaled(&Vector3::default(), &it, decay));
    if let (Some(orientation), Some(rate)) = (&mut object.orientation, &object.angular_velocity) {
        *orientation = rotated(orientation, rate, seconds);
    }
    object.observation_age_ns =
        object.observation_age_ns.saturating_add((seconds * 1e9).round() as i64);
    object.covariance.clear();
    object.velocity_covariance.clear();
}

/// a + b · factor.
fn add_scaled(a: &Vector3, b: &Vector3, factor: f64) -> Vector3 {
    Vector3 { x: a.x + b.x * factor, y: a.y + b.y * factor, z: a.z + b.z * factor }
}

/// Rotation `q` after a rotation with this angular velocity in the world frame.
fn rotated(q: &Quaternion, rate: &Vector3, seconds: f64) -> Quaternion {
    let speed_rad_s = (rate.x * rate.x + rate.y * rate.y + rate.z * rate.z).sqrt();
    let half_rad = 0.5 * speed_rad_s * seconds;
    // sin(half) / speed, which tends to seconds / 2 at rest.
    let scale = if speed_rad_s > 0.0 { half_rad.sin() / speed_rad_s } else { 0.5 * seconds };
    let (x, y, z, w) = (rate.x * scale, rate.y * scale, rate.z * scale, half_rad.cos());
    Quaternion {
        x: w * q.x + x * q.w + y * q.z - z * q.y,
        y: w * q.y - x * q.z + y * q.w + z * q.x,
        z: w * q.z + x * q.y - y * q.x + z * q.w,
        w: w * q.w - x * q.x - y * q.y - z * q.z,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prediction_forth_and_back_restores_the_state() {
        let vector = |x, y, z| Some(Vector3 { x, y, z });
        let object = ObjectState {
            position: vector(1.0, 2.0, 3.0),
            velocity: vector(1.0, 0.0, 0.0),
            acceleration: vector(0.0, 2.0, 0.0),
            orientation: Some(Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
            angular_velocity: vector(0.0, 0.0, std::f64::consts::PI),
            covariance: vec![1.0; 21],
            ..Default::default()
        };
        let snapshot =
            Snapshot { pose_time_ns: 10, objects: vec![object.clone()], ..Default::default() };
        let later = predicted(&snapshot, 0.5);
        assert_eq!(later.pose_time_ns, 500_000_010);
        let state = &later.objects[0];
        let (position, turn) = (state.position.unwrap(), state.orientation.unwrap());
        assert!((position.x - 1.5).abs() < 1e-12 && position.y > 2.0, "{position:?}");
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!((turn.z - half).abs() < 1e-12 && (turn.w - half).abs() < 1e-12, "{turn:?}");
        assert!(state.covariance.is_empty());
        let back = predicted(&later, -0.5).objects[0].clone();
        let gap = add_scaled(&back.position.unwrap(), &object.position.unwrap(), -1.0);
        assert!(gap.x.abs() + gap.y.abs() + gap.z.abs() < 1e-12, "{gap:?}");
        assert!((back.orientation.unwrap().w - 1.0).abs() < 1e-12);
        assert_eq!(back.observation_age_ns, 0);
    }

    #[test]
    fn a_prediction_by_a_non_finite_time_changes_nothing() {
        let velocity = Some(Vector3 { x: 1.0, y: 0.0, z: 0.0 });
        let position = Some(Vector3 { x: 1.0, y: 2.0, z: 3.0 });
        let object =
            ObjectState { position, velocity, covariance: vec![1.0; 21], ..Default::default() };
        let snapshot = Snapshot { pose_time_ns: 10, objects: vec![object], ..Default::default() };
        for seconds in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert_eq!(predicted(&snapshot, seconds), snapshot);
        }
    }
}
