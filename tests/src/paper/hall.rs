//! The hall of section 6.2: a floor of tiles of 0.625 x 1.25 m with roundels on their corners, seen from two
//! positions by one of the paper's cameras.
//!
//! Stated in the paper: the tiles, their precision of 0.6 mm, four roundels that define the frame, distances of about
//! six metres (errors in centimetres over errors in per cent). Chosen here: 25 roundels of 15 cm in five rows, which
//! fits the paper's predictions for its cameras; the outermost four define the frame and the others are measured; the
//! "side" view from a height of 3.2 m, with lines of sight 38° to 66° off the normals, the "top" view from 5.6 m.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};

use super::scene::PaperCamera;
use crate::{
    arena::look_at,
    coverage::{Contour, Patch},
    random::Random,
    render::{Canvas, Image, MovingPrint, Print, Renderer},
};

/// Diameter of the roundels, side of square markers.
pub const OUTER_M: f64 = 0.15;
/// Deviation of a tile's corner from its nominal position along each axis.
pub const TILES_M: f64 = 0.0006;
/// Across and along the hall.
const TILE_M: [f64; 2] = [1.25, 0.625];
const COLUMNS: usize = 5;
const ROWS: usize = 5;
const FLOOR: f64 = 150.0;
const JOINT: f64 = 95.0;
const JOINT_M: f64 = 0.006;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum View {
    /// The paper's "side".
    Side,
    /// The paper's "top".
    Top,
}

impl View {
    /// The paper's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Side => "side",
            Self::Top => "top",
        }
    }
}

/// One picture's camera pose and roundel positions.
pub struct Hall {
    pub camera: PaperCamera,
    pub camera_from_world: Isometry3<f64>,
    /// Nominal positions of the roundels.
    pub stated_m: Vec<Vector3<f64>>,
    /// True positions of the roundels.
    pub true_m: Vec<Vector3<f64>>,
    yaws_rad: Vec<f64>,
    seed: u64,
}

impl Hall {
    /// The same for the same `seed`, which moves the camera by centimetres and the tiles by [`TILES_M`].
    pub fn new(camera: PaperCamera, view: View, seed: u64) -> Self {
        let mut random = Random::new(seed, 1);
        let middle = Vector3::new(0.0, TILE_M[1] * (ROWS - 1) as f64 / 2.0, 0.0);
        let place = match view {
            View::Side => Vector3::new(0.0, -3.5, 3.2),
            View::Top => Vector3::new(0.0, -0.9, 5.6),
        };
        let moved = Vector3::from_fn(|_, _| random.uniform(-0.05, 0.05));
        let stated = |index: usize| {
            let (column, row) = (index % COLUMNS, index / COLUMNS);
            let across = column as f64 - (COLUMNS - 1) as f64 / 2.0;
            Vector3::new(across * TILE_M[0], row as f64 * TILE_M[1], 0.0)
        };
        let stated_m: Vec<_> = (0..COLUMNS * ROWS).map(stated).collect();
        let mut laid = || TILES_M * f64::from(random.normal());
        let true_m = stated_m.iter().map(|at| at + Vector3::new(laid(), laid(), 0.0)).collect();
        let yaws_rad =
            stated_m.iter().map(|_| random.uniform(0.0, std::f64::consts::TAU)).collect();
        let camera_from_world = look_at(place + moved, middle).inverse();
        Self { camera, camera_from_world, stated_m, true_m, yaws_rad, seed }
    }

    /// Whether a roundel is one of the four that define the frame.
    pub fn is_reference(index: usize) -> bool {
        let (column, row) = (index % COLUMNS, index / COLUMNS);
        (column == 0 || column == COLUMNS - 1) && (row == 0 || row == ROWS - 1)
    }

    /// camera_from_roundel.
    pub fn pose(&self, index: usize) -> Isometry3<f64> {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.yaws_rad[index]);
        self.camera_from_world * Isometry3::from_parts(Translation3::from(self.true_m[index]), turn)
    }

    /// The roundel at this pixel, if any.
    pub fn at(&self, pixel: Vector2<f64>) -> Option<usize> {
        (0..self.true_m.len()).find(|&index| {
            let place = Point3::from(self.pose(index).translation.vector);
            let size_px = self.camera.optics.focal_px[0] * OUTER_M / place.z;
            let image = self.camera.optics.project(&place);
            image.is_some_and(|image| (image - pixel).norm() < 0.25 * size_px)
        })
    }

    /// Approximate semiaxes of a roundel's image, accurate enough for the model.
    pub fn semiaxes_px(&self, index: usize) -> [f64; 2] {
        let pose = self.pose(index);
        let place = pose.translation.vector;
        let major = self.camera.optics.focal_px[0] * OUTER_M / (2.0 * place.norm());
        let facing = (pose.rotation * Vector3::z()).dot(&place.normalize()).abs();
        [major, major * facing]
    }

    /// The picture with these prints at the roundels' positions.
    pub fn picture(&self, print: &(dyn Fn(usize) -> Print + Sync)) -> Image {
        let renderer = Renderer::new(self.camera.optics, self.camera.imaging);
        let floor = self.floor(&renderer);
        let prints: Vec<_> = (0..self.true_m.len()).map(print).collect();
        let motions: Vec<_> = (0..prints.len())
            .map(|index| self.pose(index))
            .map(|pose| move |_: f64| pose)
            .collect();
        let moving: Vec<_> = prints
            .iter()
            .zip(&motions)
            .map(|(print, motion)| MovingPrint { print, motion })
            .collect();
        renderer.frame(&floor, &moving, &mut Random::new(self.seed, 2))
    }

    /// Tiles with their joints.
    fn floor(&self, renderer: &Renderer) -> Canvas {
        let optics = &self.camera.optics;
        let mut canvas = Canvas::flat(optics.width, optics.height, FLOOR);
        for column in -5..=5 {
            for row in -4..=12 {
                let corner =
                    Vector2::new(f64::from(column) * TILE_M[0], f64::from(row) * TILE_M[1]);
                for length_m in [Vector2::new(TILE_M[0], JOINT_M), Vector2::new(JOINT_M, TILE_M[1])]
                {
                    if let Some(patch) = self.joint(renderer, corner, length_m) {
                        canvas.paint(&patch, JOINT);
                    }
                }
            }
        }
        canvas
    }

    /// A strip of the floor from its corner on, or `None` if it is outside the picture.
    fn joint(
        &self,
        renderer: &Renderer,
        corner: Vector2<f64>,
        size: Vector2<f64>,
    ) -> Option<Patch> {
        let optics = &self.camera.optics;
        let at = |p: Vector2<f64>| {
            let place = self.camera_from_world * Point3::new(p.x, p.y, 0.0);
            // Farther out, the lens' polynomial is not valid.
            let near = place.z > 0.5 && place.x.hypot(place.y) < 1.2 * place.z;
            near.then(|| optics.project(&place)).flatten()
        };
        let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
            .map(|[x, y]| corner + Vector2::new(x * size.x, y * size.y));
        let contour = Contour::polygon(&corners, 2.0, at)?;
        Patch::of(&[(contour, 1.0)], renderer.kernel(), optics.width, optics.height)
    }
}
