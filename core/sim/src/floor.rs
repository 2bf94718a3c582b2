//! Static background: a lab floor with joints, stains, tape and stickers, boxes at its edge, under uneven light.

use nalgebra::{Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{
    light::{Light, falloff},
    noise::{STEPS_PER_LEVEL, smooth_noise},
    params::ScenarioParams,
    ray::{RayGrid, RayRow},
    sim_camera::SimCamera,
};

/// Side of the slabs and half the width of their joints, metres.
const SLAB_M: f64 = 1.25;
const JOINT_HALF_M: f64 = 0.004;
/// Half the width of the tape around the arena, metres.
const TAPE_HALF_M: f64 = 0.025;

pub(super) struct Floor {
    seed: u64,
    half_m: [f64; 2],
    marks: Vec<Mark>,
    boxes: Vec<Crate>,
}

struct Mark {
    center_m: [f64; 2],
    axis: [f64; 2],
    half_m: f64,
    albedo: f64,
    style: MarkStyle,
}

#[derive(Clone, Copy, PartialEq)]
enum MarkStyle {
    Square,
    Disc,
    Cross,
    Stain,
}

/// A box on the floor, aligned with the arena.
struct Crate {
    low_m: [f64; 3],
    high_m: [f64; 3],
    albedo: f64,
}

impl Floor {
    pub fn new(params: &ScenarioParams) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(params.seed);
        rng.set_stream(4);
        let half_m = params.arena_m.map(|side| side / 2.0);
        let area_m2 = params.arena_m[0] * params.arena_m[1];
        let mut marks = Vec::new();
        let styles = [
            (MarkStyle::Stain, 0.25),
            (MarkStyle::Square, 0.2),
            (MarkStyle::Disc, 0.15),
            (MarkStyle::Cross, 0.1),
        ];
        for (style, per_m2) in styles {
            for _ in 0..(per_m2 * area_m2).min(400.0) as usize {
                marks.push(Mark::random(style, half_m, &mut rng));
            }
        }
        let boxes = (0..(area_m2 / 10.0).min(40.0) as usize)
            .map(|_| Crate::random(half_m, params.roundel_height_m, &mut rng))
            .collect();
        Self { seed: params.seed, half_m, marks, boxes }
    }

    /// The background in the image of a camera, in levels of the working image.
    pub fn picture(
        &self,
        camera: &SimCamera,
        grid: &RayGrid,
        light: &Light,
        blur_px: f64,
    ) -> Vec<i16> {
        let (width, height) = (camera.camera.width(), camera.camera.height());
        let eye = Point3::from(camera.world_from_camera.translation.vector);
        let pixel_m = 1.0 / camera.camera.intrinsics().fx_px;
        let marks = MarkIndex::new(&self.marks, self.half_m);
        let mut rays = RayRow::default();
        let mut picture = Vec::with_capacity(width * height);
        for v in 0..height {
            grid.row(v, 0, width, &mut rays);
            picture.extend(rays.x.iter().zip(&rays.y).map(|(&x, &y)| {
                let (x, y) = (f64::from(x), f64::from(y));
                let ray = camera.world_from_camera.rotation * Vector3::new(x, y, 1.0);
                let level = self.brightness(&eye, &ray, pixel_m, &marks, light);
                let scale = 255.0 * f64::from(STEPS_PER_LEVEL);
                (scale * (level * falloff(x, y)).clamp(0.0, 1.0)) as f32
            }));
        }
        blur(&mut picture, width, blur_px);
        picture.into_iter().map(|level| level.round() as i16).collect()
    }

    /// Brightness along a ray with unit depth increment, as a share of full scale.
    fn brightness(
        &self,
        eye: &Point3<f64>,
        ray: &Vector3<f64>,
        pixel_m: f64,
        marks: &MarkIndex,
        light: &Light,
    ) -> f64 {
        let hits = self.boxes.iter().filter_map(|item| item.hit(eye, ray));
        if let Some((depth, albedo)) = hits.min_by(|a, b| a.0.total_cmp(&b.0)) {
            let at = eye + ray * depth;
            return albedo * light.at(at.x, at.y);
        }
        if ray.z > -0.05 {
            // A distant wall.
            return 0.3 * light.at(0.0, 0.0);
        }
        let depth = -eye.z / ray.z;
        let at = eye + ray * depth;
        self.albedo(at.x, at.y, pixel_m * depth, marks) * light.at(at.x, at.y)
    }

    fn albedo(&self, x_m: f64, y_m: f64, pixel_m: f64, marks: &MarkIndex) -> f64 {
        let noise = |wavelength: f64, salt: u64| {
            smooth_noise(self.seed ^ salt, x_m / wavelength, y_m / wavelength)
        };
        let mut albedo =
            0.46 + 0.035 * noise(1.9, 1) + 0.02 * noise(0.4, 2) + 0.018 * noise(0.05, 3);
        let to_joint = |x: f64| (x / SLAB_M - (x / SLAB_M).round()).abs() * SLAB_M;
        let joint = soft_step(JOINT_HALF_M - to_joint(x_m).min(to_joint(y_m)), pixel_m);
        albedo *= 1.0 - 0.45 * joint;
        let beyond = (x_m.abs() - self.half_m[0]).max(y_m.abs() - self.half_m[1]);
        let tape = soft_step(TAPE_HALF_M - beyond.abs(), pixel_m);
        albedo += tape * (0.72 - albedo);
        if beyond > TAPE_HALF_M {
            albedo *= 0.75;
        }
        for &mark in marks.near(x_m, y_m) {
            let mark = &self.marks[mark];
            let coverage = mark.coverage(x_m, y_m, pixel_m);
            albedo += coverage * (mark.albedo - albedo);
        }
        albedo
    }
}

impl Mark {
    fn random(style: MarkStyle, half_m: [f64; 2], rng: &mut ChaCha8Rng) -> Self {
        let (sine, cosine) = rng.random_range(0.0..std::f64::consts::TAU).sin_cos();
        let size_m = match style {
            MarkStyle::Stain => 0.1..0.45,
            MarkStyle::Square => 0.02..0.14,
            MarkStyle::Disc => 0.015..0.09,
            MarkStyle::Cross => 0.08..0.15,
        };
        let albedo = match style {
            MarkStyle::Stain => rng.random_range(0.25..0.38),
            MarkStyle::Cross => 0.75,
            _ if rng.random_bool(0.5) => rng.random_range(0.06..0.25),
            _ => rng.random_range(0.6..0.88),
        };
        let center_m = half_m.map(|half| rng.random_range(-half..half));
        Self { center_m, axis: [cosine, sine], half_m: rng.random_range(size_m), albedo, style }
    }

    fn coverage(&self, x_m: f64, y_m: f64, pixel_m: f64) -> f64 {
        let (dx, dy) = (x_m - self.center_m[0], y_m - self.center_m[1]);
        let [cosine, sine] = self.axis;
        let (along, across) = ((cosine * dx + sine * dy).abs(), (cosine * dy - sine * dx).abs());
        match self.style {
            MarkStyle::Square => soft_step(self.half_m - along.max(across), pixel_m),
            MarkStyle::Disc => soft_step(self.half_m - along.hypot(across), pixel_m),
            MarkStyle::Cross => {
                let bar = self.half_m * 0.14;
                let first = (self.half_m - along).min(bar - across);
                let second = (self.half_m - across).min(bar - along);
                soft_step(first.max(second), pixel_m)
            }
            MarkStyle::Stain => {
                // Elongated and irregular.
                let ragged = 1.0 + 0.35 * smooth_noise(17, x_m / 0.12, y_m / 0.12);
                0.6 * soft_step(
                    self.half_m - along.hypot(1.7 * across) * ragged,
                    0.25 * self.half_m,
                )
            }
        }
    }

    fn reach_m(&self) -> f64 {
        self.half_m * 1.8 + 0.05
    }
}

/// Grid of the marks near each square of the floor.
struct MarkIndex {
    half_m: [f64; 2],
    columns: usize,
    cells: Vec<Vec<usize>>,
}

impl MarkIndex {
    const CELL_M: f64 = 0.5;

    fn new(marks: &[Mark], half_m: [f64; 2]) -> Self {
        let half_m = half_m.map(|half| half + 1.0);
        let [columns, rows] = half_m.map(|half| (2.0 * half / Self::CELL_M).ceil() as usize);
        let mut index = Self { half_m, columns, cells: vec![Vec::new(); columns * rows] };
        for (number, mark) in marks.iter().enumerate() {
            let reach = mark.reach_m();
            let range = |axis: usize, count: usize| {
                let cell = |place: f64| {
                    ((place + half_m[axis]) / Self::CELL_M).clamp(0.0, count as f64 - 1.0) as usize
                };
                cell(mark.center_m[axis] - reach)..=cell(mark.center_m[axis] + reach)
            };
            for row in range(1, rows) {
                for column in range(0, columns) {
                    index.cells[row * columns + column].push(number);
                }
            }
        }
        index
    }

    fn near(&self, x_m: f64, y_m: f64) -> &[usize] {
        if x_m.abs() >= self.half_m[0] || y_m.abs() >= self.half_m[1] {
            return &[];
        }
        let column = ((x_m + self.half_m[0]) / Self::CELL_M) as usize;
        let row = ((y_m + self.half_m[1]) / Self::CELL_M) as usize;
        self.cells.get(row * self.columns + column).map_or(&[], |cell| cell)
    }
}

impl Crate {
    /// A box outside of the arena, lower than the roundels.
    fn random(half_m: [f64; 2], roundel_height_m: f64, rng: &mut ChaCha8Rng) -> Self {
        let size_m = [rng.random_range(0.2..0.6), rng.random_range(0.2..0.6)];
        let side = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let across = usize::from(rng.random_bool(0.3));
        let mut center_m = half_m.map(|half| rng.random_range(-half..half));
        // Most are along the sides y = ±, since images are wider than high.
        let axis = 1 - across;
        center_m[axis] = side * (half_m[axis] + size_m[axis] / 2.0 - 0.1);
        let height_m = rng.random_range(0.3..0.8) * roundel_height_m;
        Self {
            low_m: [center_m[0] - size_m[0] / 2.0, center_m[1] - size_m[1] / 2.0, 0.0],
            high_m: [center_m[0] + size_m[0] / 2.0, center_m[1] + size_m[1] / 2.0, height_m],
            albedo: rng.random_range(0.15..0.7),
        }
    }

    /// Depth at which a ray enters, and albedo of the face it meets, darker at the sides (slab method).
    fn hit(&self, eye: &Point3<f64>, ray: &Vector3<f64>) -> Option<(f64, f64)> {
        let (mut enter, mut leave, mut face) = (0.0, f64::INFINITY, 2);
        for axis in 0..3 {
            let (a, b) = (
                (self.low_m[axis] - eye[axis]) / ray[axis],
                (self.high_m[axis] - eye[axis]) / ray[axis],
            );
            if a.min(b) > enter {
                (enter, face) = (a.min(b), axis);
            }
            leave = a.max(b).min(leave);
        }
        (enter < leave).then(|| (enter, [0.55, 0.7, 1.0][face] * self.albedo))
    }
}

/// Coverage at a signed distance from an edge of width `width_m`.
fn soft_step(inside_m: f64, width_m: f64) -> f64 {
    let t = (inside_m / width_m + 0.5).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Separable Gaussian blur with replicated borders.
fn blur(picture: &mut [f32], width: usize, blur_px: f64) {
    let reach = (3.5 * blur_px).ceil() as usize;
    if blur_px < 0.05 {
        return;
    }
    let mut kernel: Vec<f32> = (0..=2 * reach)
        .map(|i| {
            let off = i as f64 - reach as f64;
            (-off * off / (2.0 * blur_px * blur_px)).exp() as f32
        })
        .collect();
    let sum: f32 = kernel.iter().sum();
    kernel.iter_mut().for_each(|weight| *weight /= sum);

    let height = picture.len() / width;
    let mut padded = vec![0.0; width + 2 * reach];
    for row in picture.chunks_exact_mut(width) {
        padded[..reach].fill(row[0]);
        padded[reach..reach + width].copy_from_slice(row);
        padded[reach + width..].fill(row[width - 1]);
        row.fill(0.0);
        for (i, weight) in kernel.iter().enumerate() {
            row.iter_mut().zip(&padded[i..]).for_each(|(out, x)| *out += weight * x);
        }
    }
    let source = picture.to_vec();
    for (v, row) in picture.chunks_exact_mut(width).enumerate() {
        row.fill(0.0);
        for (i, weight) in kernel.iter().enumerate() {
            let from = (v + i).saturating_sub(reach).min(height - 1) * width;
            let above = &source[from..from + width];
            row.iter_mut().zip(above).for_each(|(out, x)| *out += weight * x);
        }
    }
}
