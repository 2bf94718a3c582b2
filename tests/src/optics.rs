//! Pinhole cameras with `plumb_bob` or `equidistant` distortion, independent of core's.
//!
//! Written from the published models alone: `plumb_bob` is Brown-Conrady as in OpenCV's documentation (k1 k2 p1 p2
//! k3), `equidistant` is Kannala-Brandt as in OpenCV's fisheye page (k1 to k4). Pixel centres lie on integers; camera
//! frame x right, y down, z forward.

use nalgebra::{Matrix2, Point3, Vector2, Vector3};

/// Distortion of a lens, with ROS' names and order of coefficients.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distortion {
    /// `plumb_bob`: k1 k2 p1 p2 k3.
    PlumbBob([f64; 5]),
    /// `equidistant`: k1 k2 k3 k4.
    Equidistant([f64; 4]),
}

impl Distortion {
    pub const NONE: Distortion = Distortion::PlumbBob([0.0; 5]);

    /// ROS' name of the model.
    pub fn name(&self) -> &'static str {
        match self {
            Distortion::PlumbBob(_) => "plumb_bob",
            Distortion::Equidistant(_) => "equidistant",
        }
    }

    /// Coefficients in ROS' order.
    pub fn coefficients(&self) -> &[f64] {
        match self {
            Distortion::PlumbBob(d) => d,
            Distortion::Equidistant(d) => d,
        }
    }

    /// Distorted image point, on the plane z = 1, of the ray through (x, y, 1).
    fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        match *self {
            Distortion::PlumbBob([k1, k2, p1, p2, k3]) => {
                let r2 = x * x + y * y;
                let radial = 1.0 + k1 * r2 + k2 * r2.powi(2) + k3 * r2.powi(3);
                (
                    x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                    y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
                )
            }
            Distortion::Equidistant([k1, k2, k3, k4]) => {
                let r = x.hypot(y);
                if r < 1e-12 {
                    return (x, y);
                }
                let a = r.atan();
                let bent =
                    a * (1.0 + k1 * a.powi(2) + k2 * a.powi(4) + k3 * a.powi(6) + k4 * a.powi(8));
                (x * bent / r, y * bent / r)
            }
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole {
    pub width: usize,
    pub height: usize,
    /// Along u and v.
    pub focal_px: [f64; 2],
    /// Principal point (u, v).
    pub center_px: [f64; 2],
    pub distortion: Distortion,
}

impl Pinhole {
    /// Square pixels, principal point at the image centre.
    pub fn centered(width: usize, height: usize, focal_px: f64, distortion: Distortion) -> Self {
        let center_px = [(width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0];
        Self { width, height, focal_px: [focal_px; 2], center_px, distortion }
    }

    /// Raw pixel (u, v) of a point in the camera frame, or `None` at or behind the camera.
    pub fn project(&self, point_m: &Point3<f64>) -> Option<Vector2<f64>> {
        if point_m.z <= 1e-6 {
            return None;
        }
        let (x, y) = self.distortion.distort(point_m.x / point_m.z, point_m.y / point_m.z);
        Some(Vector2::new(
            self.focal_px[0] * x + self.center_px[0],
            self.focal_px[1] * y + self.center_px[1],
        ))
    }

    /// The ray (x, y, 1) of a raw pixel (u, v), by Newton's method on [`Self::project`] with numeric derivatives.
    /// `None` where the distortion polynomial cannot be inverted.
    pub fn ray(&self, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        const STEP: f64 = 1e-6;
        let wanted = Vector2::new(
            (pixel.x - self.center_px[0]) / self.focal_px[0],
            (pixel.y - self.center_px[1]) / self.focal_px[1],
        );
        let at = |p: &Vector2<f64>| {
            let (x, y) = self.distortion.distort(p.x, p.y);
            Vector2::new(x, y)
        };
        let mut guess = wanted;
        for _ in 0..50 {
            let miss = at(&guess) - wanted;
            if miss.norm() < 1e-14 {
                break;
            }
            let along = |d: Vector2<f64>| (at(&(guess + d)) - at(&(guess - d))) / (2.0 * STEP);
            let slope = Matrix2::from_columns(&[
                along(Vector2::new(STEP, 0.0)),
                along(Vector2::new(0.0, STEP)),
            ]);
            guess -= slope.try_inverse()? * miss;
        }
        ((at(&guess) - wanted).norm() < 1e-10).then(|| Vector3::new(guess.x, guess.y, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MILD: Distortion = Distortion::PlumbBob([-0.12, 0.05, 0.001, -0.0008, -0.01]);
    const WIDE: Distortion = Distortion::Equidistant([-0.02, 0.004, -0.001, 0.0002]);

    #[test]
    fn rays_invert_projections_all_over_the_image() {
        for distortion in [Distortion::NONE, MILD, WIDE] {
            let camera = Pinhole::centered(1280, 720, 730.0, distortion);
            for u in (0..1280).step_by(97) {
                for v in (0..720).step_by(71) {
                    let pixel = Vector2::new(f64::from(u), f64::from(v));
                    let ray = camera.ray(&pixel).unwrap();
                    let again = camera.project(&Point3::from(ray * 3.7)).unwrap();
                    assert!((again - pixel).norm() < 1e-8, "{distortion:?} {pixel:?}");
                }
            }
        }
    }

    #[test]
    fn signs_follow_the_camera_frame() {
        let camera = Pinhole::centered(641, 481, 500.0, Distortion::NONE);
        let at = |x, y| camera.project(&Point3::new(x, y, 2.0)).unwrap();
        assert_eq!(at(0.0, 0.0), Vector2::new(320.0, 240.0));
        assert_eq!(at(0.4, 0.2), Vector2::new(420.0, 290.0));
        assert!(camera.project(&Point3::new(0.0, 0.0, -1.0)).is_none());
    }

    /// Numbers worked out by hand from the published equations, so that an error in one term shows.
    #[test]
    fn distortion_matches_hand_worked_numbers() {
        // x = 0.3, y = -0.2: r² = 0.13; radial = 1 + 0.1·0.13 + 0.01·0.0169 = 1.013169;
        // 2 p1 x y = -0.00012, p2 (r² + 2 x²) = 0.00062; p1 (r² + 2 y²) = 0.00021, 2 p2 x y = -0.00024.
        let (x, y) = Distortion::PlumbBob([0.1, 0.01, 0.001, 0.002, 0.0]).distort(0.3, -0.2);
        assert!((x - (0.303_950_7 - 0.000_12 + 0.000_62)).abs() < 1e-12);
        assert!((y - (-0.202_633_8 + 0.000_21 - 0.000_24)).abs() < 1e-12);
        // r = 1: θ = π/4; 1 + 0.1 θ² = 1.061685…
        let (x, _) = Distortion::Equidistant([0.1, 0.0, 0.0, 0.0]).distort(1.0, 0.0);
        let quarter = std::f64::consts::FRAC_PI_4;
        assert!((x - quarter * (1.0 + 0.1 * quarter * quarter)).abs() < 1e-15);
    }
}
