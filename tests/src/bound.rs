//! The Cramér-Rao bound of a roundel's pose: the smallest covariance that an unbiased estimator can reach on the
//! pixels of one frame.
//!
//! Pixel i is g_i(θ) + n_i, where g is the noise-free image that [`crate::render`] draws and n has variance σ² +
//! 1/12: the camera's noise and the rounding to whole grey levels. Rims are anti-aliased by their contour integral;
//! oversampling with hard edges would add information that is not there. The Fisher information of the unknowns θ and
//! the bound of their covariance are
//!
//!   F = Σ_i ∇g_i ∇g_iᵀ / (σ² + 1/12),   cov θ̂ ≥ F⁻¹,
//!
//! with ∇g by central differences, steps of about a tenth of a pixel. θ has the shift across the ray (2), the
//! relative range along the ray, the two tilts, the grey levels of black and white, and the blur. [`Unknowns::yaw`]
//! adds the rotation about the normal, [`Unknowns::bloom`] the distance that white spreads into black, and
//! [`Unknowns::motion`] both components of the motion within the exposure. The motion must not be zero: there the
//! image has no first derivative by it.
//!
//! All pixels within [`REACH_BLURS`] deviations of the blur around the outer rim's box count; those that saturate give
//! no information. Beyond them the paper is assumed to continue, so the sheet's edge gives no information.
//!
//! Face-on, the first derivative by the tilts almost vanishes (only perspective remains). There the bound of the
//! normal holds for unbiased estimators only, which no estimator is, so tilts below about 10° must be judged by
//! errors, not by the bound.
//!
//! The check in `tests`: face-on, 30.5 px, inner/outer 0.4, black 40 and white 200, noise 2 and blur 0.7 give a depth
//! deviation of 0.0142 %.

use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix3, Matrix6, Translation3, UnitQuaternion, Vector3,
};

use crate::{
    optics::Pinhole,
    render::{Canvas, Imaging, MovingPrint, Outline, Print, Renderer},
};

/// Steps of the differences move a rim by about this.
const STEP_PX: f64 = 0.1;
/// Limit of rotation steps. Face-on, no rotation moves a rim by [`STEP_PX`] to first order.
const MAX_STEP_RAD: f64 = 0.03;
/// Step of the grey levels; the image is linear in them.
const STEP_GREY: f64 = 1.0;
/// A step that changes the image by less than this, grey levels (root of the sum of squares), changes only its
/// rounding.
const MIN_CHANGE: f64 = 0.01;
/// Pixels within this many deviations of the blur (plus one pixel) of the outer rim count.
pub const REACH_BLURS: f64 = 5.0;

/// Unknowns besides shift, range, tilt, black, white and blur.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Unknowns {
    /// Rotation about the normal, for prints that show it.
    pub yaw: bool,
    /// Distance that white spreads into black.
    pub bloom: bool,
    /// Motion within the exposure.
    pub motion: bool,
}

/// The bound of one roundel in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Bound {
    /// Over (position, rotation) in the camera frame, m², m·rad, rad². Rotation is a left perturbation, zero about
    /// the normal unless yaw was unknown.
    pub covariance: Matrix6<f64>,
    /// Relative deviation of the range, and so of the depth.
    pub range_share: f64,
    /// Deviations of the shift along two axes across the ray, at the image centre.
    pub shift_px: [f64; 2],
    /// Deviations of the tilt about the axis that increases it, and about the axis across.
    pub tilt_rad: [f64; 2],
    /// Deviation of the rotation about the normal, if it was unknown.
    pub yaw_rad: Option<f64>,
    /// Deviation of the blur.
    pub blur_px: f64,
}

/// One roundel before one camera: all that the noise-free image depends on.
#[derive(Clone, Debug)]
pub struct Scene<'a> {
    pub camera: Pinhole,
    /// Light must be even; exposure and shutter are ignored.
    pub imaging: Imaging,
    pub print: &'a Print,
    /// camera_from_roundel, in the middle of the exposure.
    pub pose: Isometry3<f64>,
    /// Motion within the exposure along the camera's x and y, at the image centre.
    pub motion_px: [f64; 2],
}

/// `None` if the roundel faces away, is not wholly in front of the camera, or the image does not separate the
/// unknowns.
pub fn bound(scene: &Scene<'_>, unknowns: Unknowns) -> Option<Bound> {
    let window = Window::of(scene)?;
    let axes = Axes::of(&scene.pose);
    let steps = Steps::new(scene, &axes, window.radius_px, unknowns);
    let renderer = Renderer::new(window.camera(&scene.camera), scene.imaging);
    // The sheet is white on white: a small one saves drawing it.
    let sheet = Outline::Disc { diameter_m: 0.1 * scene.print.radius_m() };
    let print = Print { sheet, ..scene.print.clone() };
    let mut columns = Vec::new();
    for &(unknown, step) in &steps.0 {
        let image = |step: f64| draw(&renderer, &print, &axes.moved(scene, unknown, step));
        let (ahead, behind) = (image(step), image(-step));
        let slope =
            |(ahead, behind): (&f32, &f32)| (f64::from(*ahead) - f64::from(*behind)) / (2.0 * step);
        let column = DVector::from_iterator(ahead.len(), ahead.iter().zip(&behind).map(slope));
        if column.norm() * step < MIN_CHANGE {
            return None;
        }
        columns.push(column);
    }
    let jacobian = DMatrix::from_columns(&columns);
    let variance = scene.imaging.noise.powi(2) + 1.0 / 12.0;
    // Columns are scaled to the same norm, so that mixing metres and radians does not spoil the inverse.
    let scale = DVector::from_iterator(columns.len(), columns.iter().map(|c| 1.0 / c.norm()));
    let scaled = &jacobian * DMatrix::from_diagonal(&scale);
    let inverse = (scaled.transpose() * scaled).cholesky()?.inverse();
    let rescale = DMatrix::from_diagonal(&scale);
    let covariance = &rescale * inverse * &rescale * variance;
    covariance
        .iter()
        .all(|value| value.is_finite())
        .then(|| axes.bound(scene, &covariance, unknowns))
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Unknown {
    /// Along one of the axes across the ray, as a share of the range.
    Shift(usize),
    /// Along the ray, as a share of the range.
    Range,
    /// About one of the axes across the normal, or the normal itself, radians.
    Turn(usize),
    Black,
    White,
    Blur,
    Bloom,
    /// Along one axis of the camera.
    Motion(usize),
}

/// Unknowns in the order of the bound's rows, with the steps of their differences.
struct Steps(Vec<(Unknown, f64)>);

impl Steps {
    fn new(scene: &Scene<'_>, axes: &Axes, radius_px: f64, unknowns: Unknowns) -> Self {
        let focal_px = scene.camera.focal_px[0];
        let sine = axes.ray.cross(&axes.about[2]).norm();
        let turn = (STEP_PX / (radius_px * sine)).min(MAX_STEP_RAD);
        let shift = STEP_PX / focal_px;
        let mut steps = vec![
            (Unknown::Shift(0), shift),
            (Unknown::Shift(1), shift),
            (Unknown::Range, STEP_PX / radius_px),
            (Unknown::Turn(0), turn),
            (Unknown::Turn(1), turn),
            (Unknown::Black, STEP_GREY),
            (Unknown::White, STEP_GREY),
            (Unknown::Blur, 0.5 * STEP_PX),
        ];
        if unknowns.yaw {
            steps.push((Unknown::Turn(2), (STEP_PX / radius_px).min(MAX_STEP_RAD)));
        }
        if unknowns.bloom {
            steps.push((Unknown::Bloom, STEP_PX));
        }
        if unknowns.motion {
            steps.extend([0, 1].map(|axis| (Unknown::Motion(axis), STEP_PX)));
        }
        Self(steps)
    }
}

/// Unit vectors in the camera frame.
struct Axes {
    /// To the roundel's centre.
    ray: Vector3<f64>,
    /// Across the ray.
    across: [Vector3<f64>; 2],
    /// Axes of rotation: of the tilt, the axis across, the normal.
    about: [Vector3<f64>; 3],
}

impl Axes {
    fn of(pose: &Isometry3<f64>) -> Self {
        let ray = pose.translation.vector.normalize();
        let normal = pose.rotation * Vector3::z();
        let helper = if ray.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
        let first = ray.cross(&helper).normalize();
        let tilt = ray.cross(&normal).try_normalize(1e-6).unwrap_or(first);
        Self { ray, across: [first, ray.cross(&first)], about: [tilt, normal.cross(&tilt), normal] }
    }

    /// The scene with one unknown moved by `step`.
    fn moved<'a>(&self, scene: &Scene<'a>, unknown: Unknown, step: f64) -> Scene<'a> {
        let mut moved = scene.clone();
        let Scene { pose, imaging, motion_px, .. } = &mut moved;
        let range_m = pose.translation.vector.norm();
        let mut shift = |along: &Vector3<f64>| {
            pose.translation = Translation3::from(pose.translation.vector + along * range_m * step);
        };
        match unknown {
            Unknown::Shift(axis) => shift(&self.across[axis]),
            Unknown::Range => shift(&self.ray),
            Unknown::Turn(axis) => {
                let turn = UnitQuaternion::from_scaled_axis(self.about[axis] * step);
                pose.rotation = turn * pose.rotation;
            }
            Unknown::Black => imaging.black += step,
            Unknown::White => imaging.white += step,
            Unknown::Blur => imaging.blur_px += step,
            Unknown::Bloom => imaging.bloom_px += step,
            Unknown::Motion(axis) => motion_px[axis] += step,
        }
        moved
    }

    fn bound(&self, scene: &Scene<'_>, covariance: &DMatrix<f64>, unknowns: Unknowns) -> Bound {
        let range_m = scene.pose.translation.vector.norm();
        let mut into = DMatrix::zeros(6, covariance.nrows());
        let mut place = |column: usize, row: usize, vector: Vector3<f64>| {
            into.fixed_view_mut::<3, 1>(row, column).copy_from(&vector);
        };
        place(0, 0, self.across[0] * range_m);
        place(1, 0, self.across[1] * range_m);
        place(2, 0, self.ray * range_m);
        place(3, 3, self.about[0]);
        place(4, 3, self.about[1]);
        if unknowns.yaw {
            place(8, 3, self.about[2]);
        }
        let pose_covariance = &into * covariance * into.transpose();
        let deviation = |index: usize| covariance[(index, index)].sqrt();
        let focal_px = scene.camera.focal_px[0];
        Bound {
            covariance: Matrix6::from_fn(|row, column| pose_covariance[(row, column)]),
            range_share: deviation(2),
            shift_px: [deviation(0) * focal_px, deviation(1) * focal_px],
            tilt_rad: [deviation(3), deviation(4)],
            yaw_rad: unknowns.yaw.then(|| deviation(8)),
            blur_px: deviation(7),
        }
    }
}

impl Bound {
    /// Covariance of the position, m².
    pub fn position(&self) -> Matrix3<f64> {
        self.covariance.fixed_view::<3, 3>(0, 0).into()
    }

    /// Rms angle between estimated and true normal, radians.
    pub fn normal_rad(&self) -> f64 {
        self.tilt_rad[0].hypot(self.tilt_rad[1])
    }
}

/// The pixels that count.
struct Window {
    left: f64,
    top: f64,
    width: usize,
    height: usize,
    /// Longest radius of the outer rim.
    radius_px: f64,
}

impl Window {
    fn of(scene: &Scene<'_>) -> Option<Self> {
        let radius_m = scene.print.radius_m();
        let center = scene.camera.project(&scene.pose.translation.vector.into())?;
        let (mut low, mut high, mut radius_px) = (center, center, 0.0f64);
        for step in 0..32 {
            let (sin, cos) = (f64::from(step) * std::f64::consts::TAU / 32.0).sin_cos();
            let rim = scene.pose * nalgebra::Point3::new(radius_m * cos, radius_m * sin, 0.0);
            let at = scene.camera.project(&rim)?;
            (low, high) = (low.inf(&at), high.sup(&at));
            radius_px = radius_px.max((at - center).norm());
        }
        let [x, y] = scene.motion_px;
        let reach = REACH_BLURS * scene.imaging.blur_px + 1.0 + 0.5 * x.hypot(y);
        let (left, top) = ((low.x - reach).floor(), (low.y - reach).floor());
        let side = |from: f64, to: f64| ((to + reach).ceil() - from) as usize + 1;
        Some(Self { left, top, width: side(left, high.x), height: side(top, high.y), radius_px })
    }

    /// The part of the camera's image that counts, as a camera of its own.
    fn camera(&self, camera: &Pinhole) -> Pinhole {
        let [u, v] = camera.center_px;
        let center_px = [u - self.left, v - self.top];
        Pinhole { width: self.width, height: self.height, center_px, ..*camera }
    }
}

/// Grey values on paper without end. A new kernel is built only if the blur differs.
fn draw(renderer: &Renderer, print: &Print, scene: &Scene<'_>) -> Vec<f32> {
    let pose = scene.pose;
    let per_px = pose.translation.z / scene.camera.focal_px[0];
    let [x, y] = scene.motion_px.map(|motion_px| motion_px * per_px);
    let motion = move |time_s: f64| Translation3::new(x * time_s, y * time_s, 0.0) * pose;
    let imaging = Imaging { exposure_s: 1.0, ..scene.imaging };
    let moving = [MovingPrint { print, motion: &motion }];
    let paper = Canvas::flat(renderer.camera.width, renderer.camera.height, imaging.white);
    if imaging.blur_px == renderer.imaging.blur_px {
        let mut renderer = renderer.clone();
        renderer.imaging = imaging;
        return saturated(renderer.ideal(&paper, &moving).grey);
    }
    saturated(Renderer::new(renderer.camera, imaging).ideal(&paper, &moving).grey)
}

fn saturated(mut grey: Vec<f32>) -> Vec<f32> {
    grey.iter_mut().for_each(|grey| *grey = grey.min(255.0));
    grey
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{optics::Distortion, render::Ink};

    /// A roundel of this diameter, tilted about an axis in the image plane.
    fn scene(print: &Print, diameter_px: f64, tilt_deg: f64) -> Scene<'_> {
        let camera = Pinhole::centered(640, 480, 700.0, Distortion::NONE);
        let z = camera.focal_px[0] * 2.0 * print.radius_m() / diameter_px;
        let axis = Vector3::new(0.8, 0.6, 0.0) * tilt_deg.to_radians();
        let facing = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let rotation = UnitQuaternion::from_scaled_axis(axis) * facing;
        let translation = Translation3::new(0.0003 * z, -0.0002 * z, z);
        let pose = Isometry3::from_parts(translation, rotation);
        Scene { camera, imaging: Imaging::default(), print, pose, motion_px: [0.0; 2] }
    }

    fn default_bound(scene: &Scene<'_>) -> Bound {
        bound(scene, Unknowns::default()).expect("a roundel in plain view")
    }

    #[test]
    fn the_depth_bound_at_30_px_face_on_is_a_seventieth_of_a_percent() {
        let print = Print::plain(0.16, 0.064, 0.25);
        let share = default_bound(&scene(&print, 30.5, 0.0)).range_share;
        assert!((share - 1.42e-4).abs() < 0.02e-4, "{share}");
        // Thinner and thicker rings differ little: between 0.012 and 0.016 %.
        for ratio in [0.3, 0.5, 0.65] {
            let print = Print::plain(0.16, 0.16 * ratio, 0.25);
            let share = default_bound(&scene(&print, 30.5, 0.0)).range_share;
            assert!((1.2e-4..1.6e-4).contains(&share), "{ratio}: {share}");
        }
    }

    /// Along a straight edge of contrast C, blurred by s² = blur² + 1/12, a pixel's length contributes ∫ g'² = C²/(2
    /// √π s) about its shift. Round a closed rim both directions share it, so the trace of their information is the
    /// rims' length times it.
    #[test]
    fn the_bound_of_a_large_roundels_shift_follows_from_its_rims_length() {
        let print = Print::plain(0.16, 0.064, 0.25);
        let scene = scene(&print, 110.0, 40.0);
        let bound = default_bound(&scene);
        let axes = Axes::of(&scene.pose);
        let variances = nalgebra::Matrix2::from_fn(|i, j| {
            (axes.across[i].transpose() * bound.position() * axes.across[j])[0]
        });
        let px_per_m = scene.camera.focal_px[0] / scene.pose.translation.z;
        let found = variances.try_inverse().unwrap().trace() / px_per_m.powi(2);
        // Circumference of an ellipse of semiaxes 1 and cos 40° (Ramanujan), times both radii.
        let (a, b) = (1.0, f64::to_radians(40.0).cos());
        let around =
            std::f64::consts::PI * (3.0 * (a + b) - ((3.0 * a + b) * (a + 3.0 * b)).sqrt());
        let length_px = around * 55.0 * 1.4;
        let spread_px = (0.7f64.powi(2) + 1.0 / 12.0).sqrt();
        let per_px = 160f64.powi(2) / (2.0 * std::f64::consts::PI.sqrt() * spread_px);
        let expected = length_px * per_px / (4.0 + 1.0 / 12.0);
        assert!((found / expected - 1.0).abs() < 0.03, "{found} {expected}");
    }

    #[test]
    fn the_bound_grows_with_noise_and_unknowns() {
        let print = Print::plain(0.16, 0.064, 0.25);
        let still = scene(&print, 25.0, 35.0);
        let mut noisy = still.clone();
        noisy.imaging.noise = 4.0;
        let ratio = default_bound(&noisy).range_share / default_bound(&still).range_share;
        let expected = f64::sqrt((16.0 + 1.0 / 12.0) / (4.0 + 1.0 / 12.0));
        assert!((ratio - expected).abs() < 1e-6);
        let blooming = bound(&still, Unknowns { bloom: true, ..Unknowns::default() }).unwrap();
        assert!(blooming.range_share > 1.05 * default_bound(&still).range_share);
    }

    #[test]
    fn an_unknown_motion_costs_little_and_needs_a_motion() {
        let print = Print::plain(0.16, 0.064, 0.25);
        let with_motion = Unknowns { motion: true, ..Unknowns::default() };
        let mut scene = scene(&print, 30.0, 35.0);
        assert_eq!(bound(&scene, with_motion), None);
        scene.motion_px = [1.2, 0.9];
        let known = default_bound(&scene).range_share;
        let unknown = bound(&scene, with_motion).unwrap().range_share;
        assert!((1.0..1.2).contains(&(unknown / known)), "{unknown} {known}");
    }

    #[test]
    fn a_plain_print_has_no_bound_of_its_yaw() {
        let plain = Print::plain(0.16, 0.064, 0.25);
        let with_yaw = Unknowns { yaw: true, ..Unknowns::default() };
        assert_eq!(bound(&scene(&plain, 30.0, 30.0), with_yaw), None);
        let marked = marked(&plain);
        let scene = scene(&marked, 30.0, 30.0);
        let bound = bound(&scene, with_yaw).unwrap();
        let yaw_rad = bound.yaw_rad.unwrap();
        // Two edges of 5 px, ten pixels from the centre, at 2300 px⁻² a pixel: 0.7 mrad.
        assert!((0.6e-3..1.0e-3).contains(&yaw_rad), "{yaw_rad}");
        let normal = scene.pose.rotation * Vector3::z();
        let rotation: Matrix3<f64> = bound.covariance.fixed_view::<3, 3>(3, 3).into();
        let about_normal = (normal.transpose() * rotation * normal)[0];
        assert!((about_normal.sqrt() / yaw_rad - 1.0).abs() < 1e-9);
    }

    /// The print with a white square in its ring.
    fn marked(print: &Print) -> Print {
        let square = [[0.04, -0.01], [0.07, -0.01], [0.07, 0.01], [0.04, 0.01]];
        let mut marked = print.clone();
        marked.inks.push(Ink { outline: Outline::Polygon(square.to_vec()), white: true });
        marked
    }

    #[test]
    fn a_roundel_that_faces_away_has_no_bound() {
        let print = Print::plain(0.16, 0.064, 0.25);
        assert_eq!(bound(&scene(&print, 30.0, 100.0), Unknowns::default()), None);
    }
}
