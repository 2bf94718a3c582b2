//! Numbers that are often wanted of an object's state.

use crate::v1::ObjectState;

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

/// How fast it moves, m/s; 0 where the velocity is absent.
pub fn speed_m_s(state: &ObjectState) -> f64 {
    state.velocity.map_or(0.0, |v| (v.x * v.x + v.y * v.y + v.z * v.z).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v1::Vector3;

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
