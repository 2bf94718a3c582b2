//! The paper's cameras, and pictures of single roundels.
//!
//! The paper names its cameras and picture sizes, but neither focal lengths nor noise. Focal lengths follow from its
//! predictions where it makes any (equation 14 with D = 12), else from the usual field of view. Blur, noise and
//! distortion are chosen: barrel distortion that shrinks the corners by the measured 7 % (section 6.1.1), and more
//! blur in pixels where pixels are small. Blur and noise are unknown to the detector.
//!
//! Roundels have white discs of 0.4 of the black ring, on paper with a margin of a quarter of the diameter.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use roundel_core::{
    frame::Frame,
    marker::{Detector, Kind, Params, Ring, Scratch},
};

use crate::{
    optics::{Distortion, Pinhole},
    random::Random,
    render::{Canvas, Image, Imaging, MovingPrint, Print, Renderer},
};

/// White disc over black ring.
pub const RATIO: f64 = 0.4;
/// White margin, as a share of the outer diameter.
pub const MARGIN: f64 = 0.25;
/// Share of frames in which a roundel must be found to count as reliably found.
pub const RELIABLE: f64 = 0.98;
/// Side of the window that is rendered about small roundels.
pub const WINDOW_PX: usize = 96;
/// Grey level of the floor.
pub const FLOOR: f64 = 120.0;

/// One of the paper's cameras.
#[derive(Clone, Copy, Debug)]
pub struct PaperCamera {
    /// The paper's name.
    pub name: &'static str,
    pub optics: Pinhole,
    pub imaging: Imaging,
}

impl PaperCamera {
    fn new(
        name: &'static str,
        [width, height]: [usize; 2],
        focal_px: f64,
        k1: f64,
        [blur_px, noise]: [f64; 2],
    ) -> Self {
        let lens = Distortion::PlumbBob([k1, 0.0, 0.0, 0.0, 0.0]);
        let optics = Pinhole::centered(width, height, focal_px, lens);
        Self { name, optics, imaging: Imaging { blur_px, noise, ..Imaging::default() } }
    }

    /// f = 770 px from tables 1 and 2, and pictures of 4:3 from table 2.
    pub fn logitech() -> Self {
        Self::new("Logitech QC Pro", [1024, 768], 770.0, -0.044, [0.7, 3.0])
    }

    /// f = 3216 px from table 1; 4608x3456 as stated.
    pub fn olympus() -> Self {
        Self::new("Olympus VR-340", [4608, 3456], 3216.0, -0.038, [1.0, 3.0])
    }

    /// 1280x720 as stated; 65° across.
    pub fn creative() -> Self {
        Self::new("Creative Live!", [1280, 720], 1000.0, -0.05, [0.7, 3.0])
    }

    /// 5184x3456 as stated; a lens of 18 mm and a sensor of 22.3 mm.
    pub fn canon() -> Self {
        Self::new("Canon 550D", [5184, 3456], 4184.0, -0.04, [0.9, 2.0])
    }
}

/// A kind and its print.
pub fn printed(outer_m: f64) -> (Kind, Print) {
    let inner_m = RATIO * outer_m;
    (Kind::plain("roundel", outer_m, inner_m), Print::plain(outer_m, inner_m, MARGIN))
}

/// The window of a camera's image about this pixel, clipped to the image.
fn window(whole: &Pinhole, middle: Vector2<f64>) -> Pinhole {
    let cut = |at: f64, side: usize| {
        (at - WINDOW_PX as f64 / 2.0).round().clamp(0.0, (side - WINDOW_PX) as f64)
    };
    let (left, top) = (cut(middle.x, whole.width), cut(middle.y, whole.height));
    let center_px = [whole.center_px[0] - left, whole.center_px[1] - top];
    Pinhole { width: WINDOW_PX, height: WINDOW_PX, center_px, ..*whole }
}

/// A pose that faces the camera's axis, except for a tilt about an axis across it.
pub fn slanted(position: Vector3<f64>, tilt_rad: f64, axis_rad: f64) -> Isometry3<f64> {
    let faced = UnitQuaternion::from_scaled_axis(Vector3::x() * std::f64::consts::PI);
    let axis = Vector3::new(axis_rad.cos(), axis_rad.sin(), 0.0);
    let lean = UnitQuaternion::from_scaled_axis(axis * tilt_rad);
    Isometry3::from_parts(Translation3::from(position), lean * faced)
}

/// Takes pictures of single small prints on an even floor, in a window about them.
#[derive(Clone)]
pub struct Studio {
    whole: Pinhole,
    renderer: Renderer,
    floor: Canvas,
}

impl Studio {
    pub fn new(camera: &PaperCamera) -> Self {
        Self {
            whole: camera.optics,
            renderer: Renderer::new(camera.optics, camera.imaging),
            floor: Canvas::flat(WINDOW_PX, WINDOW_PX, FLOOR),
        }
    }

    /// A picture, and the image of the print's centre in it.
    pub fn picture(
        &mut self,
        print: &Print,
        pose: &Isometry3<f64>,
        random: &mut Random,
    ) -> (Image, Vector2<f64>) {
        let place = Point3::from(pose.translation.vector);
        let seen_at = |optics: &Pinhole| optics.project(&place).expect("a place before the camera");
        self.renderer.camera = window(&self.whole, seen_at(&self.whole));
        let motion = |_: f64| *pose;
        let moving = [MovingPrint { print, motion: &motion }];
        let image = self.renderer.frame(&self.floor, &moving, random);
        (image, seen_at(&self.renderer.camera))
    }
}

/// Finds one roundel in pictures of one camera.
pub struct Finder {
    studio: Studio,
    detector: Detector,
    scratch: Scratch,
    print: Print,
    outer_m: f64,
}

impl Finder {
    /// With the detector's default parameters, for roundels of this diameter.
    pub fn new(camera: &PaperCamera, outer_m: f64) -> Self {
        let (kind, print) = printed(outer_m);
        let detector = Detector::new(vec![kind], Params::default()).expect("a print of ratio 0.4");
        let (studio, scratch) = (Studio::new(camera), Scratch::default());
        Self { studio, detector, scratch, print, outer_m }
    }

    /// Whether a search of a single picture finds the roundel.
    pub fn finds(&mut self, pose: &Isometry3<f64>, random: &mut Random) -> bool {
        let (image, at) = self.studio.picture(&self.print, pose, random);
        let frame = Frame::new(&image.pixels, image.width, image.height, image.width)
            .expect("a rendered frame");
        let diameter_px = self.studio.whole.focal_px[0] * self.outer_m / pose.translation.z;
        let is_match = |ring: &Ring| {
            let off = Vector2::new(ring.outer.center.u, ring.outer.center.v) - at;
            let ratio = 2.0 * ring.outer.semi_major_px / diameter_px;
            off.norm() < 1.0 && (0.8..1.25).contains(&ratio)
        };
        self.detector.detect(&frame, &mut self.scratch).iter().any(is_match)
    }
}
