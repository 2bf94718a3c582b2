//! Renders the scenes of `tests/compare/run`: roundels, ArUco markers, AprilTags and plain discs of one size at the same
//! poses. With `--poses`, the scenes of `tests/compare/fmac`: one marker each, with coded roundels in place of discs.
//! Writes PGM files and `truth.json`.

use std::{collections::BTreeMap, fs, path::PathBuf, process::ExitCode};

use anyhow::Context;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use roundel_tests::{
    clutter::{Clutter, background},
    coded::{coded_print, words},
    optics::{Distortion, Pinhole},
    other_markers::{Cells, disc, marker, write_pgm},
    random::Random,
    render::{Canvas, Image, Imaging, MovingPrint, Print, Renderer},
};
use serde::Deserialize;
use serde_json::json;

/// Outer diameter of roundels and discs, side of square markers, metres.
const SIZE_M: f64 = 0.16;
/// Inner diameter of the roundels.
const INNER_M: f64 = 0.064;
/// Focal length over the image's width, as in the reference installations.
const FOCAL: f64 = 1100.0 / 1920.0;
const MAX_TILT_RAD: f64 = 50.0 * std::f64::consts::PI / 180.0;
/// Seed of clutter and noise in the scenes of `tests/compare/run`.
const SEED: u64 = 11;
/// Margin of roundels over their outer diameter.
const MARGIN: f64 = 0.2;
/// Bits of the coded roundels.
const BITS: u8 = 8;

/// One scene, rendered once for each family of markers.
struct Scene {
    name: String,
    camera: Pinhole,
    imaging: Imaging,
    clutter: Option<Clutter>,
    poses: Vec<Isometry3<f64>>,
    /// Index of the first marker's identity in its family; the others follow.
    first_id: usize,
    /// Seed of clutter and noise.
    seed: u64,
}

/// The content of `--poses`: one camera, and scenes with one marker.
#[derive(Deserialize)]
struct PosesFile {
    /// Outer diameter of roundels, side of square markers.
    size_m: f64,
    /// Inner diameter of plain roundels.
    inner_m: f64,
    width: usize,
    height: usize,
    focal_px: [f64; 2],
    center_px: [f64; 2],
    plumb_bob: [f64; 5],
    /// Deviation, grey levels.
    noise: f64,
    scenes: Vec<PosedMarker>,
}

#[derive(Deserialize)]
struct PosedMarker {
    position_m: [f64; 3],
    /// camera_from_marker, row by row.
    rotation: [[f64; 3]; 3],
    blur_px: f64,
}

#[derive(clap::Args)]
pub struct Options {
    /// JSON with the cells of each marker by family: rows of 0 (black) and 1, including the black border
    markers: PathBuf,
    folder: PathBuf,
    /// JSON with a camera and poses, in place of the scenes of tests/compare/run
    #[arg(long)]
    poses: Option<PathBuf>,
}

pub fn run(options: &Options) -> anyhow::Result<ExitCode> {
    let Options { markers, folder, poses } = options;
    let markers: BTreeMap<String, Vec<Cells>> =
        serde_json::from_slice(&fs::read(markers)?).context("markers")?;
    let posed: Option<PosesFile> = match poses {
        Some(path) => Some(serde_json::from_slice(&fs::read(path)?).context("poses")?),
        None => None,
    };
    let (size_m, inner_m, scenes) = match &posed {
        Some(posed) => (posed.size_m, posed.inner_m, posed.scenes()),
        None => (SIZE_M, INNER_M, scenes()),
    };
    let words = words(BITS);
    scenes.par_iter().try_for_each(|scene| {
        let prints = |name: &str, print: &dyn Fn(usize) -> Print| {
            let prints: Vec<_> = (0..scene.poses.len()).map(print).collect();
            let path = folder.join(format!("{}-{name}.pgm", scene.name));
            write_pgm(&path, &scene.render(&prints)).with_context(|| path.display().to_string())
        };
        prints("roundel", &|_| Print::plain(size_m, inner_m, MARGIN))?;
        if posed.is_some() {
            let word = |index| words[(scene.first_id + index) % words.len()];
            prints("coded", &|index| coded_print(size_m, BITS, word(index), MARGIN))?;
        } else {
            prints("disc", &|_| disc(size_m))?;
        }
        for (family, cells) in &markers {
            let cells = |index| &cells[(scene.first_id + index) % cells.len()];
            prints(family, &|index| marker(cells(index), size_m))?;
        }
        anyhow::Ok(())
    })?;
    let truth: BTreeMap<&str, _> =
        scenes.iter().map(|scene| (scene.name.as_str(), scene.truth())).collect();
    let all = json!({ "size_m": size_m, "inner_m": inner_m, "scenes": truth });
    fs::write(folder.join("truth.json"), all.to_string())?;
    Ok(ExitCode::SUCCESS)
}

fn scenes() -> Vec<Scene> {
    let crowd = |name: &str, size: [usize; 2], grid: [usize; 2], count, diameter_px| {
        let mut random = Random::new(7, count as u64 + size[0] as u64);
        let focal_px = FOCAL * size[0] as f64;
        let camera = Pinhole::centered(size[0], size[1], focal_px, Distortion::NONE);
        let poses = crowd(&camera, grid, count, diameter_px, &mut random);
        let (imaging, clutter) = (Imaging::default(), Some(Clutter::LAB));
        Scene { name: name.into(), camera, imaging, clutter, poses, first_id: 0, seed: SEED }
    };
    let mut scenes = vec![
        crowd("1080p-100", [1920, 1080], [14, 8], 100, [24.0, 60.0]),
        crowd("1080p-400", [1920, 1080], [24, 17], 400, [26.0, 34.0]),
        crowd("4k-100", [3840, 2160], [14, 8], 100, [24.0, 60.0]),
    ];
    for diameter_px in [20.0, 30.0, 60.0, 100.0] {
        for index in 0..60 {
            scenes.push(single(diameter_px, index));
        }
    }
    scenes
}

/// Markers near the centres of a grid's cells, each at its own distance.
fn crowd(
    camera: &Pinhole,
    grid: [usize; 2],
    count: usize,
    diameter_px: [f64; 2],
    random: &mut Random,
) -> Vec<Isometry3<f64>> {
    (0..count)
        .map(|index| {
            let mut at = |place: usize, cells: usize, side: usize| {
                let jitter = random.uniform(-0.03, 0.03);
                ((place as f64 + 0.5 + jitter) / cells as f64 - 0.5) * side as f64
            };
            let x = at(index % grid[0], grid[0], camera.width);
            let y = at(index / grid[0], grid[1], camera.height);
            pose(camera, [x, y], random.uniform(diameter_px[0], diameter_px[1]), random)
        })
        .collect()
}

/// One marker near the centre of a small image, with the light and lens of the precision bars.
fn single(diameter_px: f64, index: u64) -> Scene {
    let mut random = Random::new(diameter_px as u64, index);
    let camera = Pinhole::centered(320, 240, 1100.0, Distortion::NONE);
    let imaging = Imaging {
        blur_px: random.uniform(0.5, 1.1),
        noise: random.uniform(1.0, 4.0),
        ..Imaging::default()
    };
    let at = [random.uniform(-20.0, 20.0), random.uniform(-15.0, 15.0)];
    let poses = vec![pose(&camera, at, diameter_px, &mut random)];
    let name = format!("single-{diameter_px:03}-{index:03}");
    Scene { name, camera, imaging, clutter: None, poses, first_id: 0, seed: SEED }
}

/// A pose that appears at this offset from the image centre, with random rotation and tilt.
fn pose(
    camera: &Pinhole,
    at_px: [f64; 2],
    diameter_px: f64,
    random: &mut Random,
) -> Isometry3<f64> {
    let focal_px = camera.focal_px[0];
    let z = focal_px * SIZE_M / diameter_px;
    let position = Vector3::new(at_px[0] / focal_px, at_px[1] / focal_px, 1.0) * z;
    let tilt = random.uniform(MAX_TILT_RAD.cos(), 1.0).acos();
    let axis = random.uniform(0.0, std::f64::consts::TAU);
    let lean = UnitQuaternion::from_scaled_axis(Vector3::new(axis.cos(), axis.sin(), 0.0) * tilt);
    let turn = random.uniform(0.0, std::f64::consts::TAU);
    let spin = UnitQuaternion::from_scaled_axis(Vector3::z() * turn);
    // Half a turn about x makes the print face the camera; the rest follows the line of sight.
    let facing = UnitQuaternion::from_scaled_axis(Vector3::x() * std::f64::consts::PI);
    let aside = UnitQuaternion::rotation_between(&Vector3::z(), &position)
        .expect("a place in front of the camera");
    Isometry3::from_parts(Translation3::from(position), aside * facing * lean * spin)
}

impl PosesFile {
    /// On a flat background, named by their numbers from 0.
    fn scenes(&self) -> Vec<Scene> {
        let camera = Pinhole {
            width: self.width,
            height: self.height,
            focal_px: self.focal_px,
            center_px: self.center_px,
            distortion: Distortion::PlumbBob(self.plumb_bob),
        };
        let scene = |(index, marker): (usize, &PosedMarker)| {
            let rows = Matrix3::from_columns(&marker.rotation.map(Vector3::from));
            let rotation = Rotation3::from_matrix_unchecked(rows.transpose());
            let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
            let position = Translation3::from(marker.position_m);
            Scene {
                name: format!("{index:05}"),
                camera,
                imaging: Imaging {
                    blur_px: marker.blur_px,
                    noise: self.noise,
                    ..Imaging::default()
                },
                clutter: None,
                poses: vec![Isometry3::from_parts(position, rotation)],
                first_id: index,
                seed: index as u64,
            }
        };
        self.scenes.iter().enumerate().map(scene).collect()
    }
}

impl Scene {
    fn render(&self, prints: &[Print]) -> Image {
        let renderer = Renderer::new(self.camera, self.imaging);
        let mut random = Random::new(self.seed, self.poses.len() as u64);
        let canvas = match &self.clutter {
            Some(clutter) => background(&renderer, 120.0, clutter, &mut random),
            None => Canvas::flat(self.camera.width, self.camera.height, 120.0),
        };
        let motions: Vec<_> = self.poses.iter().map(|pose| move |_: f64| *pose).collect();
        let moving: Vec<_> = prints
            .iter()
            .zip(&motions)
            .map(|(print, motion)| MovingPrint { print, motion })
            .collect();
        renderer.frame(&canvas, &moving, &mut random)
    }

    /// The focal length, and the position and image of every marker's centre.
    fn truth(&self) -> serde_json::Value {
        let marker = |pose: &Isometry3<f64>| {
            let p = pose.translation.vector;
            let pixel = self.camera.project(&Point3::from(p)).expect("in front of the camera");
            json!({ "center_px": [pixel.x, pixel.y], "position_m": [p.x, p.y, p.z] })
        };
        let markers: Vec<_> = self.poses.iter().map(marker).collect();
        json!({ "focal_px": self.camera.focal_px[0], "markers": markers })
    }
}
