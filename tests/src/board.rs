//! Calibration boards as prints and as rendered views: Roundel's board, and a chessboard and a ChArUco board of the
//! same size. Roundel's has 7 by 5 coded roundels of 30 mm, 36 mm apart, numbered row by row from the top left.
//! Written from the specification of the prints alone.

#[cfg(feature = "chessboard")]
use anyhow::Context;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use roundel_core::{
    calib::{
        board::Board,
        lens::{LensCalibration, LensCalibrationError, Target, View, ViewSelector, calibrate},
    },
    frame::Frame,
    marker::{CodeLayout, Detector, Mode, Params, Scratch},
};

use crate::{
    coded::{coded_print, words},
    optics::{Distortion, Pinhole},
    random::Random,
    render::{Canvas, Image, Imaging, Ink, MovingPrint, Outline, Print, Renderer},
};

/// Roundels across and down.
pub const SIDES: (usize, usize) = (7, 5);
pub const OUTER_M: f64 = 0.03;
/// Distance between neighbouring centres.
pub const PITCH_M: f64 = 0.036;
const BITS: u8 = 9;
/// Corners of the polygon for a ring's rim.
const RIM: usize = 180;
/// Squares of the chessboard across and down.
pub const SQUARES: (usize, usize) = (10, 7);
pub const SQUARE_M: f64 = 0.025;
/// The chessboard as described on the command line.
pub const CHESSBOARD: &str = "chessboard:9x6:25";
/// The ChArUco board as described on the command line.
pub const CHARUCO: &str = "charuco:10x7:25:17.5:DICT_4X4_50";
/// The first 35 markers of OpenCV's DICT_4X4_50, as `cv2.aruco.generateImageMarker` draws them: bits row by row,
/// white ones set.
const MARKERS: [u16; 35] = [
    0xb532, 0x0f9a, 0x332d, 0x9946, 0x549e, 0x79cd, 0x9e2e, 0xc4f2, 0xfeda, 0xcf56, 0xf991, 0x11a7,
    0x0eb7, 0x2a0f, 0x24b1, 0x263e, 0x4665, 0x6600, 0x6c5e, 0x76af, 0x868b, 0xb02b, 0xccd5, 0xdd82,
    0xfe47, 0x9471, 0xace4, 0xa554, 0x2123, 0x346f, 0x4415, 0x57b2, 0x9ecf, 0xf0cb, 0x08ae,
];
/// A marker's side over a square's side.
pub const MARKER_SHARE: f64 = 0.7;
const CELLS: usize = 6;
/// Paper beyond the squares or roundels of a board.
const EDGE_M: f64 = 0.012;

pub fn board_print() -> Print {
    let words = words(BITS);
    let half = |count: usize| (count as f64 * PITCH_M) / 2.0 + EDGE_M;
    let mut inks = Vec::new();
    for (index, word) in words.iter().take(SIDES.0 * SIDES.1).enumerate() {
        let from_middle = |place: usize, count: usize| place as f64 - (count - 1) as f64 / 2.0;
        let (x, y) = (
            from_middle(index % SIDES.0, SIDES.0) * PITCH_M,
            -from_middle(index / SIDES.0, SIDES.1) * PITCH_M,
        );
        let coded = coded_print(OUTER_M, BITS, *word, 0.1);
        for ink in coded.inks {
            let corners = match ink.outline {
                Outline::Polygon(corners) => corners,
                Outline::Disc { diameter_m } => circle(diameter_m / 2.0),
                Outline::Ellipse { .. } => continue,
            };
            let moved = corners.into_iter().map(|[right, up]| [x + right, y + up]).collect();
            inks.push(Ink { outline: Outline::Polygon(moved), white: ink.white });
        }
    }
    Print { sheet: sheet(half(SIDES.0), half(SIDES.1)), inks, bend: None }
}

/// The chessboard; its top left square is black.
pub fn chessboard_print() -> Print {
    squares_print(|_, _| Vec::new())
}

/// The chessboard with markers in its white squares, numbered row by row.
pub fn charuco_print() -> Print {
    let mut markers = MARKERS.iter();
    squares_print(|left, top| {
        let side_m = SQUARE_M * MARKER_SHARE;
        let (left, top) = (left + (SQUARE_M - side_m) / 2.0, top - (SQUARE_M - side_m) / 2.0);
        let cell_m = side_m / CELLS as f64;
        let mut inks = vec![square([left, top], side_m, false)];
        let word = markers.next().copied().unwrap_or_default();
        for bit in (0..16).filter(|bit| word >> (15 - bit) & 1 == 1) {
            let (column, row) = (bit % 4 + 1, bit / 4 + 1);
            let corner = [left + column as f64 * cell_m, top - row as f64 * cell_m];
            inks.push(square(corner, cell_m, true));
        }
        inks
    })
}

/// Black squares, and the given content of each white square, by its top left corner.
fn squares_print(mut white: impl FnMut(f64, f64) -> Vec<Ink>) -> Print {
    let (across, down) = (SQUARES.0 as f64 * SQUARE_M, SQUARES.1 as f64 * SQUARE_M);
    let mut inks = Vec::new();
    for index in 0..SQUARES.0 * SQUARES.1 {
        let (column, row) = (index % SQUARES.0, index / SQUARES.0);
        let (left, top) =
            (column as f64 * SQUARE_M - across / 2.0, down / 2.0 - row as f64 * SQUARE_M);
        if (column + row).is_multiple_of(2) {
            inks.push(square([left, top], SQUARE_M, false));
        } else {
            inks.extend(white(left, top));
        }
    }
    Print { sheet: sheet(across / 2.0 + EDGE_M, down / 2.0 + EDGE_M), inks, bend: None }
}

fn square([left, top]: [f64; 2], side_m: f64, white: bool) -> Ink {
    let (right, bottom) = (left + side_m, top - side_m);
    let corners = [[left, top], [left, bottom], [right, bottom], [right, top]];
    Ink { outline: Outline::Polygon(straight(&corners)), white }
}

fn sheet(half_across_m: f64, half_down_m: f64) -> Outline {
    let (x, y) = (half_across_m, half_down_m);
    Outline::Polygon(straight(&[[-x, y], [-x, -y], [x, -y], [x, y]]))
}

/// A polygon with extra corners along its sides, since a lens bends them.
fn straight(corners: &[[f64; 2]]) -> Vec<[f64; 2]> {
    const PARTS: usize = 16;
    let count = corners.len();
    let between = |index: usize| {
        let (from, to) = (corners[index / PARTS], corners[(index / PARTS + 1) % count]);
        let share = (index % PARTS) as f64 / PARTS as f64;
        [0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis]))
    };
    (0..count * PARTS).map(between).collect()
}

/// A circle as a polygon of the same area.
fn circle(radius_m: f64) -> Vec<[f64; 2]> {
    let step_rad = std::f64::consts::TAU / RIM as f64;
    let radius_m = radius_m * (step_rad / step_rad.sin()).sqrt();
    let corner = |index: usize| {
        let (sin, cos) = (step_rad * index as f64).sin_cos();
        [radius_m * cos, radius_m * sin]
    };
    (0..RIM).map(corner).collect()
}

/// The camera that is calibrated: 1280x720, 70° across, barrel distortion, principal point off the centre.
pub fn camera() -> Pinhole {
    Pinhole {
        width: 1280,
        height: 720,
        focal_px: [912.0, 909.5],
        center_px: [652.3, 348.8],
        distortion: Distortion::PlumbBob([-0.14, 0.05, 0.0009, -0.0006, 0.0]),
    }
}

/// Noise 2, blur 0.8 px.
pub fn imaging() -> Imaging {
    Imaging { blur_px: 0.8, noise: 2.0, gradient: [0.1, -0.05], ..Imaging::default() }
}

/// camera_from_board of views as taken by hand: all over the image, tilted to 45°, as close as the board fits.
pub fn poses(camera: &Pinhole, count: usize, random: &mut Random) -> Vec<Isometry3<f64>> {
    let mut poses = Vec::with_capacity(count);
    let half = [SIDES.0 as f64 * PITCH_M / 2.0, SIDES.1 as f64 * PITCH_M / 2.0];
    while poses.len() < count {
        let mut within = |range: f64| random.uniform(-range, range);
        let lean_axis = Vector3::new(within(1.0), within(1.0), 0.0);
        let Some(lean_axis) = lean_axis.try_normalize(1e-3) else { continue };
        let lean = UnitQuaternion::from_scaled_axis(lean_axis * within(0.75));
        let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * within(0.3));
        let faced = UnitQuaternion::from_scaled_axis(Vector3::x() * std::f64::consts::PI);
        let place = Vector3::new(within(0.14), within(0.08), 0.34 + within(0.1));
        let pose = Isometry3::from_parts(Translation3::from(place), lean * turn * faced);
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        let is_seen = corners.iter().all(|(x, y)| {
            let corner = pose * Point3::new(x * half[0], y * half[1], 0.0);
            camera.project(&corner).is_some_and(|pixel| {
                (4.0..camera.width as f64 - 5.0).contains(&pixel.x)
                    && (4.0..camera.height as f64 - 5.0).contains(&pixel.y)
            })
        });
        if is_seen {
            poses.push(pose);
        }
    }
    poses
}

/// Pictures of a board at these poses, each with its own noise.
pub fn pictures(
    camera: &Pinhole,
    imaging: Imaging,
    print: &Print,
    poses: &[Isometry3<f64>],
    seed: u64,
) -> Vec<Image> {
    let renderer = Renderer::new(*camera, imaging);
    let background = Canvas::flat(camera.width, camera.height, 120.0);
    poses
        .par_iter()
        .enumerate()
        .map(|(index, pose)| {
            let motion = |_: f64| *pose;
            let moving = [MovingPrint { print, motion: &motion }];
            renderer.frame(&background, &moving, &mut Random::new(seed, index as u64 + 1))
        })
        .collect()
}

/// Roundel's board in core's type.
pub fn board() -> Board {
    board_of(SIDES)
}

/// The same with other numbers of columns and rows.
pub fn board_of(sides: (usize, usize)) -> Board {
    let layout = CodeLayout { bits: BITS, min_distance: 1 };
    Board::new(sides, PITCH_M, OUTER_M, layout).expect("a board like the one that is printed")
}

/// Calibrates from pictures of the board, including detection and selection of views.
pub fn lens(pictures: &[Image]) -> Result<LensCalibration, LensCalibrationError> {
    lens_by(board(), pictures)
}

/// The same with another description of the board.
pub fn lens_by(board: Board, pictures: &[Image]) -> Result<LensCalibration, LensCalibrationError> {
    let params = Params { mode: Mode::Precise, ..Params::default() };
    let detector = Detector::new(vec![board.kind()], params).expect("the board's kind");
    let views: Vec<View> = pictures
        .par_iter()
        .map_init(Scratch::default, |scratch, image| {
            let frame = Frame::new(&image.pixels, image.width, image.height, image.width)
                .expect("a rendered frame");
            View::of_rings(&board, &frame, detector.detect(&frame, scratch))
        })
        .collect();
    let size = pictures.first().map_or((0, 0), |image| (image.width, image.height));
    let target = Target::from(board);
    let mut selector = ViewSelector::new(target.clone(), size, false);
    for view in views {
        selector.offer(view);
    }
    if let Some(other) = selector.other_board() {
        return Err(other);
    }
    calibrate(&target, size, selector.taken(), None)
}

/// Calibrates from pictures of a chessboard, described as on the command line.
#[cfg(feature = "chessboard")]
pub fn lens_of_chessboard(text: &str, pictures: &[Image]) -> anyhow::Result<LensCalibration> {
    use roundel_server::lab::lens::{
        board_search::{BoardSearch, CalibrationTarget},
        chessboard,
    };
    let described = chessboard::parse(text).and_then(Result::ok);
    let sought =
        CalibrationTarget::Chessboard(described.with_context(|| format!("no chessboard: {text}"))?);
    let mut search = BoardSearch::new(&sought, false)?;
    for image in pictures {
        search.look(&Frame::new(&image.pixels, image.width, image.height, image.width)?)?;
    }
    let gathered = search.into_gathered().context("no pictures")?;
    if let Some(other) = gathered.other_print(true) {
        return Err(other.into());
    }
    let selector = &gathered.selector;
    Ok(calibrate(selector.target(), gathered.size, selector.taken(), None)?)
}
