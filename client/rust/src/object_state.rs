//! Accessors for snapshots and object states.

use crate::v1::{ObjectState, Snapshot};

/// Indices of the position variances in the upper triangle of the 6x6 covariance.
const POSITION_VARIANCES: [usize; 3] = [0, 6, 11];

/// Standard deviations of the position along the world's x, y and z, metres; `None` without a covariance.
pub fn position_sigma_m(state: &ObjectState) -> Option<[f64; 3]> {
    if state.covariance.len() != 21 {
        return None;
    }
    Some(POSITION_VARIANCES.map(|index| state.covariance[index].max(0.0).sqrt()))
}

/// The object with this configured name; the first by id of several, as when a kind of roundel has one name.
pub fn named<'a>(snapshot: &'a Snapshot, name: &str) -> Option<&'a ObjectState> {
    snapshot.objects.iter().find(|state| state.name == name)
}

/// The object with a code of this number in any layout; the first by id of several.
pub fn coded(snapshot: &Snapshot, number: u32) -> Option<&ObjectState> {
    let has_code = |state: &&ObjectState| state.code.is_some_and(|code| code.number == number);
    snapshot.objects.iter().find(has_code)
}

/// Position in the world frame, metres; `None` if absent.
pub fn position_m(state: &ObjectState) -> Option<[f64; 3]> {
    state.position.map(|p| [p.x, p.y, p.z])
}

/// Velocity in the world frame, m/s; `None` if absent.
pub fn velocity_m_s(state: &ObjectState) -> Option<[f64; 3]> {
    state.velocity.map(|v| [v.x, v.y, v.z])
}

/// Angle of its x axis about the world's z axis, counterclockwise from the world's x axis, radians; `None` if not
/// observed. With `yaw_symmetry` 2 it is ambiguous by half a turn.
pub fn yaw_rad(state: &ObjectState) -> Option<f64> {
    let q = state.orientation.filter(|_| state.yaw_observed)?;
    Some((2.0 * (q.x * q.y + q.w * q.z)).atan2(1.0 - 2.0 * (q.y * q.y + q.z * q.z)))
}

/// Norm of the velocity, m/s; 0 if absent.
pub fn speed_m_s(state: &ObjectState) -> f64 {
    state.velocity.map_or(0.0, |v| (v.x * v.x + v.y * v.y + v.z * v.z).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v1::{Code, Quaternion, Vector3};

    #[test]
    fn objects_are_found_by_name_and_code() {
        let state = |object_id, name: &str, number: Option<u32>| ObjectState {
            object_id,
            name: name.to_owned(),
            code: number.map(|number| Code { bits: 8, number }),
            ..Default::default()
        };
        let objects =
            vec![state(1, "", None), state(2, "cart", Some(7)), state(3, "cart", Some(9))];
        let snapshot = Snapshot { objects, ..Default::default() };
        assert_eq!(named(&snapshot, "cart").map(|it| it.object_id), Some(2));
        assert_eq!(coded(&snapshot, 9).map(|it| it.object_id), Some(3));
        assert_eq!((named(&snapshot, "drone"), coded(&snapshot, 1)), (None, None));
    }

    #[test]
    fn yaw_is_given_only_if_observed() {
        let (sine, cosine) = 0.6_f64.sin_cos();
        // Rotation by 1.2 rad about z.
        let orientation = Some(Quaternion { x: 0.0, y: 0.0, z: sine, w: cosine });
        let state = ObjectState { orientation, yaw_observed: true, ..Default::default() };
        assert!((yaw_rad(&state).unwrap() - 1.2).abs() < 1e-12);
        assert_eq!(yaw_rad(&ObjectState { yaw_observed: false, ..state }), None);
        let position = Some(Vector3 { x: 1.0, y: 2.0, z: 3.0 });
        let state = ObjectState { position, velocity: position, ..Default::default() };
        assert_eq!(
            (position_m(&state), velocity_m_s(&state)),
            (Some([1.0, 2.0, 3.0]), Some([1.0, 2.0, 3.0]))
        );
    }

    #[test]
    fn sigmas_are_the_roots_of_the_first_three_variances() {
        // Upper triangle, row by row: the squares of 1 to 6 on the diagonal, 0.5 elsewhere.
        let mut covariance = Vec::new();
        for row in 1..=6 {
            covariance.push(f64::from(row * row));
            covariance.extend(std::iter::repeat_n(0.5, 6 - row as usize));
        }
        let state = ObjectState { covariance, ..Default::default() };
        assert_eq!(position_sigma_m(&state), Some([1.0, 2.0, 3.0]));
        assert_eq!(position_sigma_m(&ObjectState::default()), None);
    }

    #[test]
    fn speed_is_the_velocitys_length() {
        let velocity = Some(Vector3 { x: 1.0, y: -2.0, z: 2.0 });
        assert_eq!(speed_m_s(&ObjectState { velocity, ..Default::default() }), 3.0);
        assert_eq!(speed_m_s(&ObjectState::default()), 0.0);
    }
}
