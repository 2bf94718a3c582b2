//! Renders 8-bit frames of printed roundels, with ground truth, independently of core.
//!
//! In: a pinhole camera, its [`Imaging`] (blur, light, shutter), a static background, and roundels with their poses
//! over time. Out: grey values, with or without noise.
//!
//! Each rim is projected forward point by point through pose, lens and rolling shutter: the instant at which a point
//! is moving depends on the row where it appears, and is found by iteration. Pixels get the exact blurred area inside
//! ([`crate::coverage`]). Motion blur is the mean over Gauss-Legendre instants of the exposure. Layers are composed
//! with their blurred coverage, light multiplies smoothly ([`crate::light`]), then Gaussian noise is added and the
//! result rounded to 0..=255 ([`crate::processing`]).
//!
//! A shadow H that takes a share s of the light lies on the print, so the lens blurs their product. With the ideal image
//! ρ and the kernel K, the image is K∗ρ - s K∗(ρ 1_H): the same layers are composed a second time from the part of each
//! area inside H.
//!
//! Accuracy: within 0.1 grey levels anywhere (0.003 rms) before noise and rounding of 32-fold supersampling through
//! the *inverse* projection, for discs of 1.5 px too (`tests/renderer.rs`). The difference shrinks with the square of
//! the grid's spacing, so it is the grid's error. Limits: blur from 0.25 px, the same over the whole image; a
//! textured background is only approximated under the blurred edges of sheets and shadows; overlapping roundels are
//! painted far to near.

use nalgebra::{Isometry3, Point3, Vector2};

pub use crate::print::{Ink, Outline, Print};
use crate::{
    coverage::{Contour, Kernel, MIN_BLUR_PX, Patch},
    half_plane::HalfPlane,
    light::{Light, Shadow},
    optics::Pinhole,
    processing::Processing,
    random::Random,
};

/// Image formation of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Imaging {
    /// Deviation of the lens' Gaussian blur, at least [`crate::coverage::MIN_BLUR_PX`].
    pub blur_px: f64,
    /// Distance that white spreads into black across every rim before the lens blurs. Applies to discs only; polygons
    /// keep their size.
    pub bloom_px: f64,
    /// Deviation of the noise, grey levels.
    pub noise: f64,
    /// Grey level of black ink in full light.
    pub black: f64,
    /// Grey level of white paper in full light.
    pub white: f64,
    /// Relative change of the light from left to right and from top to bottom; 1 at the centre.
    pub gradient: [f64; 2],
    pub exposure_s: f64,
    /// Time between the exposures of two rows; 0 for a global shutter.
    pub line_time_s: f64,
    /// Uneven light, besides the gradient.
    pub light: Light,
    /// From light to the camera's picture, besides the noise.
    pub processing: Processing,
}

impl Default for Imaging {
    fn default() -> Self {
        Self {
            blur_px: 0.7,
            bloom_px: 0.0,
            noise: 2.0,
            black: 40.0,
            white: 200.0,
            gradient: [0.0; 2],
            exposure_s: 0.0,
            line_time_s: 0.0,
            light: Light::default(),
            processing: Processing::default(),
        }
    }
}

/// A roundel in front of the camera.
pub struct MovingPrint<'a> {
    pub print: &'a Print,
    /// camera_from_roundel at a time in seconds after the middle of the centre row's exposure.
    pub motion: &'a (dyn Fn(f64) -> Isometry3<f64> + Sync),
}

#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    pub width: usize,
    pub height: usize,
    /// Row by row.
    pub pixels: Vec<u8>,
}

/// Noise-free grey values of a background. Paint on it once, then use it for every frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Canvas {
    pub width: usize,
    pub height: usize,
    /// Row by row, in full light.
    pub grey: Vec<f32>,
}

impl Canvas {
    pub fn flat(width: usize, height: usize, grey: f64) -> Self {
        Self { width, height, grey: vec![grey as f32; width * height] }
    }

    pub fn paint(&mut self, patch: &Patch, grey: f64) {
        self.blend(patch, |below, share| below + share * (grey as f32 - below));
    }

    /// Adds a grey level times the coverage.
    fn add(&mut self, patch: &Patch, step: f64) {
        self.blend(patch, |below, share| below + share * step as f32);
    }

    /// Paints the part of a sheet inside a shadow: adds its difference from what the sheet covers.
    fn lay(&mut self, part: &Patch, grey: f64, below: &Canvas) {
        for (row, shares) in part.coverage.chunks(part.width).enumerate() {
            let start = (part.top + row) * self.width + part.left;
            for (column, share) in shares.iter().enumerate() {
                let index = start + column;
                self.grey[index] += *share as f32 * (grey as f32 - below.grey[index]);
            }
        }
    }

    fn blend(&mut self, patch: &Patch, mix: impl Fn(f32, f32) -> f32) {
        for (row, shares) in patch.coverage.chunks(patch.width).enumerate() {
            let start = (patch.top + row) * self.width + patch.left;
            for (grey, share) in self.grey[start..start + patch.width].iter_mut().zip(shares) {
                *grey = mix(*grey, *share as f32);
            }
        }
    }
}

/// A camera with its kernel tabulated, ready to render any number of frames.
#[derive(Clone, Debug)]
pub struct Renderer {
    pub camera: Pinhole,
    pub imaging: Imaging,
    kernel: Kernel,
}

impl Renderer {
    pub fn new(camera: Pinhole, imaging: Imaging) -> Self {
        Self { camera, imaging, kernel: Kernel::new(imaging.blur_px) }
    }

    /// The blur's kernel, for painting backgrounds that are as sharp as the roundels.
    pub fn kernel(&self) -> &Kernel {
        &self.kernel
    }

    /// The frame with noise and rounding. `random` is the frame's own stream.
    pub fn frame(
        &self,
        background: &Canvas,
        moving: &[MovingPrint<'_>],
        random: &mut Random,
    ) -> Image {
        let ideal = self.ideal(background, moving);
        let Imaging { noise, processing, .. } = self.imaging;
        if processing != Processing::default() {
            let pixels = processing.apply(&ideal.grey, ideal.width, noise, random);
            return Image { width: ideal.width, height: ideal.height, pixels };
        }
        let noise = noise as f32;
        let level = |grey: &f32| (grey + noise * random.normal()).round().clamp(0.0, 255.0) as u8;
        let pixels = ideal.grey.iter().map(level).collect();
        Image { width: ideal.width, height: ideal.height, pixels }
    }

    /// The frame before noise and rounding.
    pub fn ideal(&self, background: &Canvas, moving: &[MovingPrint<'_>]) -> Canvas {
        let mut layers = self.layers(background);
        let mut order: Vec<&MovingPrint<'_>> = moving.iter().collect();
        let depth = |moving: &MovingPrint<'_>| (moving.motion)(0.0).translation.z;
        order.sort_by(|one, other| depth(other).total_cmp(&depth(one)));
        for roundel in order {
            self.draw(&mut layers, roundel);
        }
        let mut canvas = layers.shaded();
        self.light(&mut canvas);
        canvas
    }

    fn layers(&self, background: &Canvas) -> Layers {
        let shadow = self.imaging.light.shadow.map(|shadow| {
            let (width, height) = (background.width, background.height);
            let mut inside = Canvas::flat(width, height, 0.0);
            // Edges beyond the kernel's reach do not show.
            let (right, bottom) = (width as f64 + AROUND_PX, height as f64 + AROUND_PX);
            let frame =
                [[-AROUND_PX; 2], [right, -AROUND_PX], [right, bottom], [-AROUND_PX, bottom]];
            let corners = shadow.area.clip(&frame.map(Vector2::from));
            let contour = Contour::polygon(&corners, 2.0 * self.spacing_px(), Some);
            let patch = contour
                .and_then(|contour| Patch::of(&[(contour, 1.0)], &self.kernel, width, height));
            if let Some(patch) = patch {
                for (index, (inside, grey)) in
                    inside.grey.iter_mut().zip(&background.grey).enumerate()
                {
                    *inside = grey * patch.at(index % width, index / width) as f32;
                }
            }
            (shadow, inside)
        });
        Layers { whole: background.clone(), shadow }
    }

    fn draw(&self, layers: &mut Layers, moving: &MovingPrint<'_>) {
        let (white, black) = (self.imaging.white, self.imaging.black);
        let Some(sheet) = self.patch(&moving.print.sheet, true, moving, None) else { return };
        if let Some((shadow, inside)) = &mut layers.shadow
            && let Some(part) = self.patch(&moving.print.sheet, true, moving, Some(&shadow.area))
        {
            inside.lay(&part, white, &layers.whole);
        }
        layers.whole.paint(&sheet, white);
        for ink in &moving.print.inks {
            let step = if ink.white { white - black } else { black - white };
            if let Some(patch) = self.patch(&ink.outline, ink.white, moving, None) {
                layers.whole.add(&patch, step);
            }
            if let Some((shadow, inside)) = &mut layers.shadow
                && let Some(part) = self.patch(&ink.outline, ink.white, moving, Some(&shadow.area))
            {
                inside.add(&part, step);
            }
        }
    }

    /// Mean coverage over the exposure, of the part in a half-plane if one is given. `None` if the outline is outside
    /// the image, faces away or is behind the camera.
    fn patch(
        &self,
        outline: &Outline,
        white: bool,
        moving: &MovingPrint<'_>,
        part: Option<&HalfPlane>,
    ) -> Option<Patch> {
        let spread_px = if white { self.imaging.bloom_px } else { -self.imaging.bloom_px };
        let traced = Traced { outline, spread_px, part };
        let contours = self
            .instants(outline, moving)
            .into_iter()
            .map(|(offset_s, weight)| Some((self.contour(&traced, moving, offset_s)?, weight)))
            .collect::<Option<Vec<_>>>()?;
        Patch::of(&contours, &self.kernel, self.camera.width, self.camera.height)
    }

    /// Instants of the exposure with their weights; more for faster motion.
    fn instants(&self, outline: &Outline, moving: &MovingPrint<'_>) -> Vec<(f64, f64)> {
        let half_s = self.imaging.exposure_s / 2.0;
        let edge = |t: f64| {
            self.camera.project(&((moving.motion)(t) * Point3::new(outline.radius_m(), 0.0, 0.0)))
        };
        let moved_px = match (edge(-half_s), edge(half_s)) {
            (Some(start), Some(end)) => (end - start).norm(),
            _ => 0.0,
        };
        let ratio = moved_px / self.spacing_px();
        if ratio < 0.02 {
            return vec![(0.0, 1.0)];
        }
        // Five Gauss-Legendre nodes for each interval that the blur smooths well.
        let panels = (ratio / 3.0).ceil();
        let in_panel = |panel: usize| {
            GAUSS_5.iter().map(move |(node, weight)| {
                let place = (2.0 * panel as f64 + 1.0 + node) / panels - 1.0;
                (place * half_s, weight / panels)
            })
        };
        (0..panels as usize).flat_map(in_panel).collect()
    }

    /// Spacing of a contour's nodes.
    fn spacing_px(&self) -> f64 {
        self.imaging.blur_px.max(MIN_BLUR_PX)
    }

    fn contour(
        &self,
        traced: &Traced<'_>,
        moving: &MovingPrint<'_>,
        offset_s: f64,
    ) -> Option<Contour> {
        let Traced { outline, spread_px, part } = *traced;
        let pose = (moving.motion)(offset_s);
        let facing = (pose.rotation * nalgebra::Vector3::z()).dot(&pose.translation.vector);
        if facing >= 0.0 {
            return None;
        }
        let at = |x, y| self.seen_at(&pose, moving, offset_s, &moving.print.point(x, y));
        let spacing_px = self.spacing_px();
        let chord_px = spacing_px / 4.0;
        let round = |[x_m, y_m]: [f64; 2]| {
            let center = at(0.0, 0.0)?;
            let rim = |angle: f64| at(x_m * angle.cos(), y_m * angle.sin());
            let mut reach_px: f64 = 0.0;
            for i in 0..8 {
                let on_rim = rim(f64::from(i) * std::f64::consts::FRAC_PI_4)?;
                reach_px = reach_px.max((on_rim - center).norm());
            }
            // The chord of eight directions may be 8 % shorter than the longest one.
            let around_px = std::f64::consts::TAU * reach_px * 1.1;
            let spread = |angle: f64| {
                if spread_px == 0.0 {
                    return rim(angle);
                }
                let along = rim(angle + 1e-4)? - rim(angle - 1e-4)?;
                let across = Vector2::new(along.y, -along.x).normalize();
                let (place, side) = (rim(angle)?, across.dot(&(rim(angle)? - center)));
                Some(place + across * side.signum() * spread_px)
            };
            if let Some(half_plane) = part {
                return Contour::part_of_smooth(half_plane, around_px, chord_px, spread);
            }
            let count = (around_px / spacing_px).ceil().max(48.0) as usize;
            Contour::smooth(count, spread)
        };
        match outline {
            Outline::Disc { diameter_m } => round([diameter_m / 2.0; 2]),
            Outline::Ellipse { along_m, across_m } => round([along_m / 2.0, across_m / 2.0]),
            Outline::Polygon(corners) => {
                let corners: Vec<_> = corners.iter().map(|c| Vector2::from(*c)).collect();
                let at = |p: Vector2<f64>| at(p.x, p.y);
                if let Some(half_plane) = part {
                    return Contour::part_of_polygon(half_plane, &corners, chord_px, at);
                }
                Contour::polygon(&corners, 2.0 * spacing_px, at)
            }
        }
    }

    /// Image of a printed point, given that each row is exposed at its own time.
    fn seen_at(
        &self,
        pose: &Isometry3<f64>,
        moving: &MovingPrint<'_>,
        offset_s: f64,
        point: &Point3<f64>,
    ) -> Option<Vector2<f64>> {
        let mut pixel = self.camera.project(&(pose * point))?;
        if self.imaging.line_time_s != 0.0 {
            // Each iteration contracts by image speed × line time, below 1/50 for any motion that can be tracked.
            for _ in 0..5 {
                let row_s =
                    (pixel.y - (self.camera.height as f64 - 1.0) / 2.0) * self.imaging.line_time_s;
                pixel = self.camera.project(&((moving.motion)(offset_s + row_s) * point))?;
            }
        }
        Some(pixel)
    }

    fn light(&self, canvas: &mut Canvas) {
        let light = self.imaging.light;
        if !light.is_even() {
            let width = canvas.width;
            for (index, grey) in canvas.grey.iter_mut().enumerate() {
                let pixel = Vector2::new((index % width) as f64, (index / width) as f64);
                *grey = light.at(f64::from(*grey), pixel) as f32;
            }
        }
        let [across, down] = self.imaging.gradient;
        if across == 0.0 && down == 0.0 {
            return;
        }
        let place = |i: usize, count: usize| (i as f64 + 0.5) / count as f64 - 0.5;
        let (width, height) = (canvas.width, canvas.height);
        for (v, row) in canvas.grey.chunks_mut(width).enumerate() {
            let left = 1.0 + down * place(v, height);
            for (u, grey) in row.iter_mut().enumerate() {
                *grey *= (left + across * place(u, width)) as f32;
            }
        }
    }
}

/// The image in even light, and its part inside a shadow.
struct Layers {
    whole: Canvas,
    shadow: Option<(Shadow, Canvas)>,
}

impl Layers {
    fn shaded(self) -> Canvas {
        let mut canvas = self.whole;
        if let Some((shadow, inside)) = self.shadow {
            for (grey, inside) in canvas.grey.iter_mut().zip(inside.grey) {
                *grey -= shadow.loss as f32 * inside;
            }
        }
        canvas
    }
}

/// An outline on its way into the image.
struct Traced<'a> {
    outline: &'a Outline,
    /// Distance that a rim moves outwards in the image.
    spread_px: f64,
    /// The part that counts.
    part: Option<&'a HalfPlane>,
}

/// Width of a border around the image that no blur reaches across.
const AROUND_PX: f64 = 20.0;

/// Gauss-Legendre on [-1, 1], with weights that sum to 1.
const GAUSS_5: [(f64, f64); 5] = [
    (-0.906_179_845_938_664, 0.118_463_442_528_094_5),
    (-0.538_469_310_105_683_1, 0.239_314_335_249_683_2),
    (0.0, 0.284_444_444_444_444_45),
    (0.538_469_310_105_683_1, 0.239_314_335_249_683_2),
    (0.906_179_845_938_664, 0.118_463_442_528_094_5),
];
