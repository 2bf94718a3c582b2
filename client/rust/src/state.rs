//! What is often wanted of a snapshot and of an object's state.

use crate::v1::{ObjectState, Snapshot};

/// Places of the position's variances within the upper triangle of the 6x6 covariance.
const POSITION_VARIANCES: [usize; 3] = [0, 6, 11];

/// Standard deviations of the position along the world's x, y and z, metres; `None` where the
/// covariance was left out.
pub fn position_sigma_m(state: &ObjectState) -> Option<[f64; 3]> {
    if state.covariance.len() != 21 {
        return None;
    }
    Some(POSITION_VARIANCES.map(|place| state.covariance[place].max(0.0).sqrt()))
}

/// The object of this configured name; of several, as where a whole kind has one name, the first by id.
pub fn named<'a>(snapshot: &'a Snapshot, name: &str) -> Option<&'a ObjectState> {
    snapshot.objects.iter().find(|state| state.name == name)
}

/// The object whose roundel has the code of this number, in whatever layout; of several the first by id.
pub fn coded(snapshot: &Snapshot, number: u32) -> Option<&ObjectState> {
    let has_code = |state: &&ObjectState| state.code.is_some_and(|code| code.number == number);
    snapshot.objects.iter().find(has_code)
}

/// Where it is in the world frame, metres; `None` where that is absent.
pub fn position_m(state: &ObjectState) -> Option<[f64; 3]> {
    state.position.map(|p| [p.x, p.y, p.z])
}

/// Its velocity in the world frame, m/s; `None` where that is absent.
pub fn velocity_m_s(state: &ObjectState) -> Option<[f64; 3]> {
    state.velocity.map(|v| [v.x, v.y, v.z])
}

/// Angle of its x axis about the world's z axis, anticlockwise from the world's x, radians; `None` while it is not
/// observed. With `yaw_symmetry` 2 the opposite looks the same.
pub fn yaw_rad(state: &ObjectState) -> Option<f64> {
    let q = state.orientation.filter(|_| state.yaw_observed)?;
    Some((2.0 * (q.x * q.y + q.w * q.z)).atan2(1.0 - 2.0 * (q.y * q.y + q.z * q.z)))
}

/// How fast it moves, m/s; 0 where the velocity is absent.
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
    fn a_yaw_is_told_while_it_is_observed() {
        let (sine, cosine) = 0.6_f64.sin_cos();
        // By 1.2 about z.
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
        // The upper triangle of the diagonal matrix of the squares of 1 to 6, row by row.
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
