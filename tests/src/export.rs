//! An arena as an installation on disk: frames, capture times, camera files and the configuration
//! that `roundel serve` takes, with every camera's pose known.

use std::{
    fmt::Write as _,
    fs::{self, File},
    io::{self, BufWriter},
    path::{Path, PathBuf},
};

use rayon::prelude::*;

use crate::{
    arena::{Arena, Site},
    clutter::{Clutter, background},
    normal::Random,
    optics::Pinhole,
    render::{Canvas, Image, Renderer, Seen},
};

/// How an installation is written.
#[derive(Clone, Debug, PartialEq)]
pub struct Export {
    /// Frames of each camera.
    pub frames: usize,
    /// Grey level of the floor.
    pub floor: f64,
    /// What else stands about.
    pub clutter: Clutter,
    /// Lines appended to the `[fusion]` table, e.g. `acceleration_m_s2 = 1.5`.
    pub fusion: String,
}

/// An installation that was written.
#[derive(Clone, Debug, PartialEq)]
pub struct Installation {
    /// The configuration file.
    pub config: PathBuf,
    /// The folder that holds it all.
    pub folder: PathBuf,
}

/// One camera with its background painted: renders any of its frames.
pub struct Studio<'a> {
    arena: &'a Arena,
    site: &'a Site,
    stream: u64,
    renderer: Renderer,
    background: Canvas,
}

impl<'a> Studio<'a> {
    /// The `index`-th camera of the arena before a floor with clutter.
    pub fn new(arena: &'a Arena, index: usize, floor: f64, clutter: &Clutter) -> Self {
        let site = &arena.sites[index];
        let renderer = Renderer::new(site.optics, site.imaging);
        let stream = (index as u64 + 1) << 32;
        let mut random = Random::new(arena.seed, stream);
        let background = background(&renderer, floor, clutter, &mut random);
        Self { arena, site, stream, renderer, background }
    }

    /// The `frame`-th frame, from 0. The same frame has the same noise each time.
    pub fn frame(&self, frame: usize) -> Image {
        let capture_ns = self.arena.capture_time_ns(self.site, frame);
        let start_s = (capture_ns - self.arena.start_ns) as f64 * 1e-9;
        let camera_from_world = self.site.world_from_camera.inverse();
        let motions: Vec<_> = self
            .arena
            .robots
            .iter()
            .map(|robot| move |after_s: f64| camera_from_world * robot.path.pose(start_s + after_s))
            .collect();
        let seen: Vec<_> = std::iter::zip(&self.arena.robots, &motions)
            .map(|(robot, motion)| Seen { print: &robot.print, motion })
            .collect();
        let mut random = Random::new(self.arena.seed, self.stream + 1 + frame as u64);
        self.renderer.frame(&self.background, &seen, &mut random)
    }
}

impl Export {
    /// `frames` frames a camera before a lab's floor.
    pub fn lab(frames: usize) -> Self {
        Self { frames, floor: 120.0, clutter: Clutter::LAB, fusion: String::new() }
    }

    /// Writes the installation into `folder`, which must exist; uses all cores.
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
        fs::write(folder.join(format!("{}.yaml", site.name)), camera_yaml(&site.name, &site.optics))
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
            let p = site.world_from_camera.translation.vector;
            let q = site.world_from_camera.rotation;
            let times = folder.join(format!("{}-times.txt", site.name));
            let pattern = folder.join(&site.name).join("*.png");
            let source =
                format!("images:{}?times={}&clock=file", pattern.display(), times.display());
            let _ = write!(
                text,
                "\n[[camera]]\nname = \"{name}\"\nsource = '{source}'\n\
                 calibration = \"{name}.yaml\"\n\
                 pose = {{ position_m = [{:?}, {:?}, {:?}], \
                 orientation_xyzw = [{:?}, {:?}, {:?}, {:?}] }}\nline_time_us = {:?}\n",
                p.x,
                p.y,
                p.z,
                q.i,
                q.j,
                q.k,
                q.w,
                site.imaging.line_time_s * 1e6,
                name = site.name,
            );
        }
        if !self.fusion.is_empty() {
            let _ = write!(text, "\n[fusion]\n{}\n", self.fusion);
        }
        text
    }

    /// The truth at each instant at which a camera took a frame, in order.
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

/// Writes a grey PNG, compressed as fast as it goes.
pub fn write_png(path: &Path, image: &Image) -> io::Result<()> {
    let file = BufWriter::with_capacity(1 << 20, File::create(path)?);
    let mut encoder = png::Encoder::new(file, image.width as u32, image.height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    // Fast first: it chooses a filter as well, which noise does not reward.
    encoder.set_compression(png::Compression::Fastest);
    encoder.set_filter(png::Filter::NoFilter);
    let mut writer = encoder.write_header().map_err(io::Error::other)?;
    writer.write_image_data(&image.pixels).map_err(io::Error::other)?;
    writer.finish().map_err(io::Error::other)
}
