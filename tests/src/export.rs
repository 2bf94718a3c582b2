//! Writes an arena as an installation on disk: frames, capture times, camera files and the configuration for `roundel
//! serve`. Camera poses are written as known, or relative to the robot that carries the camera.

use std::{
    fmt::Write as _,
    fs::{self, File},
    io::{self, BufWriter},
    path::{Path, PathBuf},
};

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::{
    arena::{Arena, Landmark, Site},
    clutter::{Clutter, background},
    coded::{coded_print, words},
    optics::Pinhole,
    random::Random,
    render::{Canvas, Image, MovingPrint, Print, Renderer},
};

/// White margin, as a share of the outer diameter.
const MARGIN: f64 = 0.25;

/// Options of an exported installation.
#[derive(Clone, Debug, PartialEq)]
pub struct Export {
    /// Frames of each camera.
    pub frames: usize,
    /// Grey level of the floor.
    pub floor: f64,
    pub clutter: Clutter,
    /// Lines appended to the `[fusion]` table, e.g. `acceleration_m_s2 = 1.5`.
    pub fusion: String,
    /// Relative error of the focal lengths in camera files, of alternating sign.
    pub lens_error: f64,
}

/// An exported installation.
#[derive(Clone, Debug, PartialEq)]
pub struct Installation {
    /// The configuration file.
    pub config: PathBuf,
    /// The folder with all files.
    pub folder: PathBuf,
}

/// One camera with its background painted; renders any of its frames.
pub struct Studio<'a> {
    arena: &'a Arena,
    site: &'a Site,
    stream: u64,
    renderer: Renderer,
    background: Canvas,
    /// Prints on walls.
    landmarks: Vec<Print>,
}

impl<'a> Studio<'a> {
    /// The `index`-th camera of the arena before a floor with clutter.
    pub fn new(arena: &'a Arena, index: usize, floor: f64, clutter: &Clutter) -> Self {
        let site = &arena.sites[index];
        let renderer = Renderer::new(site.optics, site.imaging);
        let stream = (index as u64 + 1) << 32;
        let mut random = Random::new(arena.seed, stream);
        let background = background(&renderer, floor, clutter, &mut random);
        let landmarks = arena.landmarks.iter().map(|it| landmark_print(arena, it)).collect();
        Self { arena, site, stream, renderer, background, landmarks }
    }

    /// The `frame`-th frame, from 0. The same frame has the same noise each time.
    pub fn frame(&self, frame: usize) -> Image {
        let capture_ns = self.arena.capture_time_ns(self.site, frame);
        let start_s = (capture_ns - self.arena.start_ns) as f64 * 1e-9;
        let (arena, site) = (self.arena, self.site);
        let camera_from_world =
            move |after_s: f64| arena.camera_pose(site, start_s + after_s).inverse();
        let carrier = site.mount.map(|mount| mount.robot);
        let robots: Vec<_> = arena
            .robots
            .iter()
            .enumerate()
            // A camera does not see the robot that carries it, and a fixed one does not see between shelves.
            .filter(|&(index, robot)| {
                carrier != Some(index) && (carrier.is_some() || !robot.is_hidden_from_fixed_cameras)
            })
            .map(|(_, robot)| robot)
            .collect();
        let robots_move: Vec<_> = robots
            .iter()
            .map(|robot| {
                move |after_s: f64| camera_from_world(after_s) * robot.path.pose(start_s + after_s)
            })
            .collect();
        let landmarks_move: Vec<_> = arena
            .landmarks
            .iter()
            .map(|landmark| move |after_s: f64| camera_from_world(after_s) * landmark.pose)
            .collect();
        let robots = std::iter::zip(&robots, &robots_move)
            .map(|(robot, motion)| MovingPrint { print: &robot.print, motion });
        let landmarks = std::iter::zip(&self.landmarks, &landmarks_move)
            .map(|(print, motion)| MovingPrint { print, motion });
        let moving: Vec<_> = robots.chain(landmarks).collect();
        let mut random = Random::new(self.arena.seed, self.stream + 1 + frame as u64);
        self.renderer.frame(&self.background, &moving, &mut random)
    }
}

fn landmark_print(arena: &Arena, landmark: &Landmark) -> Print {
    let kind = &arena.kinds[landmark.kind];
    match kind.code_bits {
        Some(bits) => {
            let word = words(bits)[usize::from(landmark.code) - 1];
            coded_print(kind.outer_diameter_m, bits, word, MARGIN)
        }
        None => Print::plain(kind.outer_diameter_m, kind.inner_diameter_m, MARGIN),
    }
}

impl Export {
    /// A number of frames per camera, before a lab's floor.
    pub fn lab(frames: usize) -> Self {
        let (fusion, lens_error) = (String::new(), 0.0);
        Self { frames, floor: 120.0, clutter: Clutter::LAB, fusion, lens_error }
    }

    /// Writes the installation into an existing `folder`, on all cores.
    pub fn write(&self, arena: &Arena, folder: &Path) -> io::Result<Installation> {
        for index in 0..arena.sites.len() {
            self.write_camera(arena, index, folder)?;
        }
        let config = folder.join("roundel.toml");
        fs::write(&config, self.config(arena, folder))?;
        fs::write(folder.join("truth.csv"), self.truth(arena))?;
        Ok(Installation { config, folder: folder.into() })
    }

    fn write_camera(&self, arena: &Arena, index: usize, folder: &Path) -> io::Result<()> {
        let site = &arena.sites[index];
        let frames = folder.join(&site.name);
        fs::create_dir_all(&frames)?;
        let studio = Studio::new(arena, index, self.floor, &self.clutter);
        (0..self.frames).into_par_iter().try_for_each(|frame| {
            write_png(&frames.join(format!("{frame:06}.png")), &studio.frame(frame))
        })?;
        let times: String =
            (0..self.frames).map(|i| format!("{}\n", arena.capture_time_ns(site, i))).collect();
        fs::write(folder.join(format!("{}-times.txt", site.name)), times)?;
        let error = if index.is_multiple_of(2) { self.lens_error } else { -self.lens_error };
        let focal_px = site.optics.focal_px.map(|focal_px| focal_px * (1.0 + error));
        let yaml = camera_yaml(&site.name, &Pinhole { focal_px, ..site.optics });
        fs::write(folder.join(format!("{}.yaml", site.name)), yaml)
    }

    fn config(&self, arena: &Arena, folder: &Path) -> String {
        let mut text = String::from("name = \"rendered arena\"\n\n[server]\n");
        text.push_str("listen = \"127.0.0.1:0\"\n");
        for kind in &arena.kinds {
            let (outer_mm, inner_mm) = (kind.outer_diameter_m * 1e3, kind.inner_diameter_m * 1e3);
            let _ = write!(
                text,
                "\n[[roundel]]\nname = \"{}\"\nouter_mm = {outer_mm:?}\ninner_mm = {inner_mm:?}\n",
                kind.name
            );
            if let Some(minor_m) = kind.inner_minor_m {
                let _ = writeln!(text, "inner_minor_mm = {:?}", minor_m * 1e3);
            }
            if let Some(bits) = kind.code_bits {
                let _ = writeln!(text, "code = {{ bits = {bits}, min_distance = 1 }}");
            }
        }
        for site in &arena.sites {
            let times = folder.join(format!("{}-times.txt", site.name));
            let pattern = folder.join(&site.name).join("*.png");
            let source =
                format!("images:{}?times={}&clock=file", pattern.display(), times.display());
            let _ = write!(
                text,
                "\n[[camera]]\nname = \"{name}\"\nsource = '{source}'\n\
                 calibration = \"{name}.yaml\"\n\
                 pose = {{ {} }}\nline_time_us = {:?}\n",
                pose(arena, site),
                site.imaging.line_time_s * 1e6,
                name = site.name,
            );
        }
        text.push_str(&references(arena));
        text.push_str(&carriers(arena));
        if !self.fusion.is_empty() {
            let _ = write!(text, "\n[fusion]\n{}\n", self.fusion);
        }
        text
    }

    /// Ground truth at each capture time of any camera, in order.
    fn truth(&self, arena: &Arena) -> String {
        let mut times: Vec<i64> = arena
            .sites
            .iter()
            .flat_map(|site| (0..self.frames).map(|i| arena.capture_time_ns(site, i)))
            .collect();
        times.sort_unstable();
        times.dedup();
        let mut text = String::from("time_ns,robot,x_m,y_m,z_m,qx,qy,qz,qw,vx_m_s,vy_m_s,vz_m_s\n");
        for time in times {
            for (robot, truth) in std::iter::zip(&arena.robots, arena.truth(time)) {
                let (p, q) = (truth.pose.translation.vector, truth.pose.rotation);
                let v = truth.velocity_m_s;
                let _ = writeln!(
                    text,
                    "{time},{},{},{},{},{},{},{},{},{},{},{}",
                    robot.name, p.x, p.y, p.z, q.i, q.j, q.k, q.w, v.x, v.y, v.z
                );
            }
        }
        text
    }
}

/// A fixed camera's pose, or its mount. With landmarks, the camera is localized by them.
fn pose(arena: &Arena, site: &Site) -> String {
    let place = site.mount.map_or(site.world_from_camera, |mount| mount.robot_from_camera);
    let (p, q) = (place.translation.vector, place.rotation);
    let ride = site.mount.map_or(String::new(), |mount| {
        let object = &arena.robots[mount.robot].name;
        format!(", object = \"{object}\", localizes = {}", !arena.landmarks.is_empty())
    });
    format!(
        "position_m = [{:?}, {:?}, {:?}], orientation_xyzw = [{:?}, {:?}, {:?}, {:?}]{ride}",
        p.x, p.y, p.z, q.i, q.j, q.k, q.w
    )
}

fn references(arena: &Arena) -> String {
    let reference = |landmark: &Landmark| {
        let (p, turn) = (landmark.pose.translation.vector, landmark.pose.rotation);
        let [right, top] = [turn * Vector3::x(), turn * Vector3::y()];
        format!(
            "\n[[reference]]\nroundel = \"{}\"\ncode = {}\nposition_m = [{:?}, {:?}, {:?}]\n\
             right = [{:?}, {:?}, {:?}]\ntop = [{:?}, {:?}, {:?}]\n",
            arena.kinds[landmark.kind].name,
            landmark.code,
            p.x,
            p.y,
            p.z,
            right.x,
            right.y,
            right.z,
            top.x,
            top.y,
            top.z
        )
    };
    arena.landmarks.iter().map(reference).collect()
}

/// The robots that carry cameras, by their codes.
fn carriers(arena: &Arena) -> String {
    let mut carriers: Vec<usize> =
        arena.sites.iter().filter_map(|site| Some(site.mount?.robot)).collect();
    carriers.dedup();
    let object = |index: usize| {
        let robot = &arena.robots[index];
        let code = robot.code.map_or(String::new(), |code| format!("code = {code}\n"));
        format!("\n[[object]]\nname = \"{}\"\nroundel = \"{}\"\n{code}", robot.name, robot.kind)
    };
    carriers.into_iter().map(object).collect()
}

/// A ROS `camera_info` YAML file, as calibration tools write it.
pub fn camera_yaml(name: &str, optics: &Pinhole) -> String {
    let [fx, fy] = optics.focal_px;
    let [cx, cy] = optics.center_px;
    let d = optics.distortion.coefficients();
    format!(
        "image_width: {}\nimage_height: {}\ncamera_name: {name}\n\
         camera_matrix:\n  rows: 3\n  cols: 3\n  data: [{fx}, 0.0, {cx}, 0.0, {fy}, {cy}, 0.0, 0.0, 1.0]\n\
         distortion_model: {}\n\
         distortion_coefficients:\n  rows: 1\n  cols: {}\n  data: {d:?}\n\
         rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]\n\
         projection_matrix:\n  rows: 3\n  cols: 4\n  data: [{fx}, 0.0, {cx}, 0.0, 0.0, {fy}, {cy}, 0.0, 0.0, 0.0, 1.0, 0.0]\n",
        optics.width,
        optics.height,
        optics.distortion.name(),
        d.len(),
    )
}

/// Writes a grey PNG with fast compression.
pub fn write_png(path: &Path, image: &Image) -> io::Result<()> {
    let file = BufWriter::with_capacity(1 << 20, File::create(path)?);
    let mut encoder = png::Encoder::new(file, image.width as u32, image.height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    // The filter is set after the compression, which selects one that does not help with noise.
    encoder.set_compression(png::Compression::Fastest);
    encoder.set_filter(png::Filter::NoFilter);
    let mut writer = encoder.write_header().map_err(io::Error::other)?;
    writer.write_image_data(&image.pixels).map_err(io::Error::other)?;
    writer.finish().map_err(io::Error::other)
}
