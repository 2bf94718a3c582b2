//! Snapshots a moment later, by the model that the server predicts with.

use crate::v1::{ObjectState, Quaternion, Snapshot, Vector3};

/// L: after t seconds e^(-t/L) of an acceleration is left.
const ACCELERATION_LASTS_S: f64 = 0.4;

/// The snapshot so many seconds later (or before). Accelerations a fade: velocities grow by a L (1 - e), positions by
/// v t + a L (t - L (1 - e)), e = e^(-t/L), L = 0.4 s; objects turn on with their angular velocity.
///
/// Covariances are left out of it, since how they grow is the server's to say: [`crate::Subscription::horizon`] asks
/// for them. So is the acceleration of subscriptions without covariances: they are predicted by their velocity alone.
///
/// Where `seconds` is no finite number, there is no such moment: the snapshot stays as it is, of its own `pose_time_ns`.
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
    let left = (-seconds / ACCELERATION_LASTS_S).exp();
    let faster_s = ACCELERATION_LASTS_S * (1.0 - left);
    let further_s2 = ACCELERATION_LASTS_S * (seconds - faster_s);
    let acceleration = object.acceleration.unwrap_or_default();
    let velocity = object.velocity.unwrap_or_default();
    if let Some(position) = &mut object.position {
        *position = sum(&sum(position, &velocity, seconds), &acceleration, further_s2);
    }
    object.velocity = object.velocity.map(|velocity| sum(&velocity, &acceleration, faster_s));
    object.acceleration = object.acceleration.map(|it| sum(&Vector3::default(), &it, left));
    if let (Some(orientation), Some(rate)) = (&mut object.orientation, &object.angular_velocity) {
        *orientation = turned(orientation, rate, seconds);
    }
    object.observation_age_ns =
        object.observation_age_ns.saturating_add((seconds * 1e9).round() as i64);
    object.covariance.clear();
    object.velocity_covariance.clear();
}

/// a + b · share.
fn sum(a: &Vector3, b: &Vector3, share: f64) -> Vector3 {
    Vector3 { x: a.x + b.x * share, y: a.y + b.y * share, z: a.z + b.z * share }
}

/// Turned on about the world's axes.
fn turned(q: &Quaternion, rate: &Vector3, seconds: f64) -> Quaternion {
    let speed_rad_s = (rate.x * rate.x + rate.y * rate.y + rate.z * rate.z).sqrt();
    let half_rad = 0.5 * speed_rad_s * seconds;
    // sin(half) / speed, which is half the time at rest.
    let share = if speed_rad_s > 0.0 { half_rad.sin() / speed_rad_s } else { 0.5 * seconds };
    let (x, y, z, w) = (rate.x * share, rate.y * share, rate.z * share, half_rad.cos());
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
    fn a_quarter_turn_and_back_ends_where_it_began() {
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
        let (place, turn) = (state.position.unwrap(), state.orientation.unwrap());
        assert!((place.x - 1.5).abs() < 1e-12 && place.y > 2.0, "{place:?}");
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!((turn.z - half).abs() < 1e-12 && (turn.w - half).abs() < 1e-12, "{turn:?}");
        assert!(state.covariance.is_empty());
        let back = predicted(&later, -0.5).objects[0].clone();
        let gap = sum(&back.position.unwrap(), &object.position.unwrap(), -1.0);
        assert!(gap.x.abs() + gap.y.abs() + gap.z.abs() < 1e-12, "{gap:?}");
        assert!((back.orientation.unwrap().w - 1.0).abs() < 1e-12);
        assert_eq!(back.observation_age_ns, 0);
    }

    #[test]
    fn at_no_moment_nothing_has_moved() {
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
