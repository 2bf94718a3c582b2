//! The filter against a plain reference, at extreme noise, and with systematic errors.

use super::*;
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;

const CAMERAS: usize = 3;
const SIZE: usize = 6 + 4 * CAMERAS;
/// First row of the clock errors.
const CLOCKS: usize = 6 + 3 * CAMERAS;

/// The same filter over (p, v, β and ε of every camera) as one matrix, with zero gain for β and ε.
struct Plain {
    state: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl Plain {
    fn begin(noise: &Noise, camera: usize, rate_variance: f64, clocks_s: &[f64; CAMERAS]) -> Self {
        let mut covariance = DMatrix::identity(SIZE, SIZE);
        let blurred = Matrix3::identity() * (rate_variance * noise.timing_s.powi(2));
        covariance.view_mut((0, 0), (3, 3)).copy_from(&(noise.total + blurred));
        for (clock, deviation_s) in clocks_s.iter().enumerate() {
            covariance[(CLOCKS + clock, CLOCKS + clock)] = deviation_s * deviation_s;
        }
        covariance.view_mut((3, 3), (3, 3)).fill_with_identity();
        covariance.view_mut((3, 3), (3, 3)).scale_mut(rate_variance);
        let own = 6 + 3 * camera;
        covariance.view_mut((0, own), (3, 3)).copy_from(&-noise.systematic_root);
        covariance.view_mut((own, 0), (3, 3)).copy_from(&-noise.systematic_root.transpose());
        Self { state: DVector::zeros(SIZE), covariance }
    }

    fn predict(&mut self, dt: f64, q: f64, time_s: f64) {
        let kept = (-dt / time_s).exp();
        let mut motion = DMatrix::identity(SIZE, SIZE) * kept;
        motion.view_mut((0, 0), (6, 6)).fill_with_identity();
        motion.view_mut((CLOCKS, CLOCKS), (CAMERAS, CAMERAS)).fill_with_identity();
        motion.view_mut((0, 3), (3, 3)).fill_with_identity();
        motion.view_mut((0, 3), (3, 3)).scale_mut(dt);
        self.state = &motion * &self.state;
        self.covariance = &motion * &self.covariance * motion.transpose();
        for axis in 0..3 {
            self.covariance[(axis, axis)] += q * dt * dt * dt / 3.0;
            self.covariance[(axis, axis + 3)] += q * dt * dt / 2.0;
            self.covariance[(axis + 3, axis)] += q * dt * dt / 2.0;
            self.covariance[(axis + 3, axis + 3)] += q * dt;
        }
        for index in 6..CLOCKS {
            self.covariance[(index, index)] += 1.0 - kept * kept;
        }
    }

    /// Covariance of the rate for known clocks.
    fn rate_of_known_clocks(&self) -> Matrix3<f64> {
        let mut rate: Matrix3<f64> = self.covariance.fixed_view::<3, 3>(3, 3).into_owned();
        for clock in CLOCKS..SIZE {
            let variance = self.covariance[(clock, clock)];
            if variance > 0.0 {
                let with_clock = self.covariance.fixed_view::<3, 1>(3, clock).into_owned();
                rate -= with_clock * with_clock.transpose() / variance;
            }
        }
        rate
    }

    /// Joseph's form, valid for any gain.
    fn update(&mut self, measured: &Vector3<f64>, noise: &Noise, camera: usize) {
        let mut observation_matrix = DMatrix::zeros(3, SIZE);
        observation_matrix.view_mut((0, 0), (3, 3)).fill_with_identity();
        observation_matrix.view_mut((0, 6 + 3 * camera), (3, 3)).copy_from(&noise.systematic_root);
        let rate = self.state.rows(3, 3).clone_owned();
        observation_matrix.view_mut((0, CLOCKS + camera), (3, 1)).copy_from(&-rate);
        let fresh = noise.total - noise.systematic_root * noise.systematic_root.transpose()
            + self.rate_of_known_clocks() * noise.timing_s.powi(2);
        let fresh = DMatrix::from_column_slice(3, 3, fresh.as_slice());
        let innovation =
            &observation_matrix * &self.covariance * observation_matrix.transpose() + &fresh;
        let mut gain =
            &self.covariance * observation_matrix.transpose() * innovation.try_inverse().unwrap();
        gain.view_mut((6, 0), (4 * CAMERAS, 3)).fill(0.0);
        let measured = DVector::from_column_slice(measured.as_slice());
        self.state += &gain * (measured - &observation_matrix * &self.state);
        let left = DMatrix::identity(SIZE, SIZE) - &gain * observation_matrix;
        self.covariance =
            &left * &self.covariance * left.transpose() + &gain * fresh * gain.transpose();
    }
}

/// Tight across a direction and loose along it, with a systematic share.
fn noise(across_m: f64, along_m: f64, direction: &Vector3<f64>, share: f64) -> Noise {
    let along = direction * direction.transpose();
    let total = (Matrix3::identity() - along) * across_m.powi(2) + along * along_m.powi(2);
    let systematic_root = cholesky_lower(&(total * share)).unwrap_or_else(Matrix3::zeros);
    Noise { total, systematic_root, timing_s: 0.0 }
}

fn direction() -> impl Strategy<Value = Vector3<f64>> {
    (-1.0..1.0f64, -1.0..1.0f64, 0.1..1.0f64)
        .prop_map(|(x, y, z)| Vector3::new(x, y, z).normalize())
}

fn step() -> impl Strategy<Value = (usize, f64, Vector3<f64>, Vector3<f64>)> {
    let measured = prop::array::uniform3(-0.1..0.1f64).prop_map(Vector3::from);
    (0..CAMERAS, 0.0..0.1f64, direction(), measured)
}

proptest! {
    #[test]
    fn equals_the_plain_filter(
        steps in prop::collection::vec(step(), 1..30),
        share in 0.0..0.9f64,
        clocks_s in prop::sample::select(vec![[0.0; CAMERAS], [0.02, 0.002, 0.005]]),
    ) {
        let first = Noise { timing_s: clocks_s[0], ..noise(0.001, 0.02, &steps[0].2, share) };
        let mut kalman = Kalman::begin(&first, CameraId(0), &Vector3::repeat(9.0));
        let mut value = Vector3::zeros();
        let mut plain = Plain::begin(&first, 0, 9.0, &clocks_s);
        for (camera, timing_s) in clocks_s.iter().enumerate() {
            let index = kalman.considered.find_or_insert(CameraId(camera as u32));
            kalman.considered.set_timing(index, *timing_s);
        }
        for (camera, dt, direction, measured) in &steps {
            let timing_s = clocks_s[*camera];
            let noise = Noise { timing_s, ..noise(0.001, 0.02, direction, share) };
            value += kalman.rate * *dt;
            kalman.predict(*dt, &Vector3::repeat(0.2), 1.0);
            plain.predict(*dt, 0.2, 1.0);
            let camera_id = CameraId(*camera as u32);
            value += kalman.update(&(measured - value), &noise, camera_id, f64::INFINITY).value;
            plain.update(measured, &noise, *camera);
        }
        let expected = plain.covariance.view((0, 0), (6, 6)).clone_owned();
        let found = kalman.reported().matrix();
        for row in 0..6 {
            for column in 0..6 {
                let scale = (expected[(row, row)] * expected[(column, column)]).sqrt();
                let off = (expected[(row, column)] - found[(row, column)]).abs();
                prop_assert!(off < 1e-6 * scale, "({row}, {column}) {off:e} of {scale:e}");
            }
        }
        for axis in 0..3 {
            let deviation = expected[(axis, axis)].sqrt();
            prop_assert!((plain.state[axis] - value[axis]).abs() < 1e-5 * deviation.max(1e-3));
        }
    }

    /// Any order of noise from 0.1 mm to 100 m. Double precision does not suffice for a much wider range.
    #[test]
    fn stays_positive_definite(
        steps in prop::collection::vec((step(), -4.0..2.0f64, -4.0..2.0f64), 1..60),
        share in 0.0..1.0f64,
    ) {
        let first = noise(1.0, 1.0, &Vector3::z(), share);
        let mut kalman = Kalman::begin(&first, CameraId(0), &Vector3::repeat(9.0));
        for ((camera, dt, direction, measured), across, along) in &steps {
            let timing_s = if *camera == 1 { 0.05 } else { 0.0 };
            let noise = noise(10f64.powf(*across), 10f64.powf(*along), direction, share);
            let noise = Noise { timing_s, ..noise };
            kalman.predict(*dt * 20.0, &Vector3::new(0.2, 0.2, 1e-6), 1.0);
            let camera = CameraId(*camera as u32);
            let Correction { innovation, .. } = kalman.update(measured, &noise, camera, 16.3);
            prop_assert!(innovation.distance_squared.is_finite());
            prop_assert!(kalman.covariance.matrix().cholesky().is_some(), "{:?}", kalman.covariance);
        }
    }
}

/// Two measurements of one camera with half of the variance systematic leave three quarters of it.
#[test]
fn systematic_errors_of_two_measurements_are_common() {
    let error = noise(0.01, 0.01, &Vector3::z(), 0.5);
    let mut kalman = Kalman::begin(&error, CameraId(0), &Vector3::zeros());
    kalman.update(&Vector3::zeros(), &error, CameraId(0), 16.3);
    let left = kalman.covariance.value[(0, 0)] / 1e-4;
    assert!((left - 0.75).abs() < 1e-6, "{left}");
}

#[test]
fn a_single_camera_keeps_its_systematic_error() {
    let error = noise(0.001, 0.001, &Vector3::z(), 0.5);
    let mut kalman = Kalman::begin(&error, CameraId(0), &Vector3::repeat(9.0));
    let still = Vector3::repeat(1e-12);
    for _ in 0..1000 {
        kalman.predict(0.01, &still, 1e6);
        kalman.update(&Vector3::zeros(), &error, CameraId(0), 16.3);
    }
    let one = kalman.covariance.value[(0, 0)];
    assert!((one / 0.5e-6 - 1.0).abs() < 0.1, "{one:e}");
    // A second camera has an independent error: the mean of both is twice as good.
    for frame in 0..2000 {
        kalman.predict(0.005, &still, 1e6);
        kalman.update(&Vector3::zeros(), &error, CameraId(frame % 2), 16.3);
    }
    let two = kalman.covariance.value[(0, 0)];
    assert!(two < 0.6 * one, "{two:e} of {one:e}");
}

#[test]
fn the_camera_without_measurements_for_longest_is_replaced() {
    let error = noise(0.001, 0.001, &Vector3::z(), 0.5);
    let mut kalman = Kalman::begin(&error, CameraId(0), &Vector3::repeat(9.0));
    for camera in 1..=MAX_SOURCES as u32 {
        kalman.predict(0.01, &Vector3::repeat(0.2), 1.0);
        kalman.update(&Vector3::zeros(), &error, CameraId(camera), 16.3);
    }
    assert_eq!(kalman.considered.find(CameraId(0)), None);
    assert!(kalman.considered.find(CameraId(1)).is_some());
}
