//! 8-bit frames of printed roundels as a camera sees them.
//!
//! In: a [`Camera`](Imaging) with its blur, light and shutter, a static background, and the roundels
//! with their poses over time. Out: grey values, and the noise-free image beside them.
//!
//! Each rim is projected forward point by point (pose, lens, rolling shutter: the instant at which a
//! point is seen depends on the row where it appears, found by iteration), and pixels get the exact
//! blurred area inside ([`crate::coverage`]). Motion during the exposure is the mean over instants at
//! Gauss-Legendre nodes. Layers are composed with their blurred coverage, light multiplies smoothly,
//! then come Gaussian noise and rounding to 0..=255.
//!
//! Accuracy: within 0.1 grey levels anywhere (0.003 rms) before noise and rounding, discs of 1.5 px
//! included, of 32-fold supersampling through the *inverse* projection (`tests/renderer.rs`); that
//! difference shrinks with the grid's square, so it is the grid's and not the renderer's. Limits: blur from 0.25 px,
//! the same over the whole image; a textured background is composed at the sheet's edge only to the
//! extent that it is even there; roundels that overlap are painted far to near.

use nalgebra::{Isometry3, Point3, Vector2};

use crate::{
    coverage::{Contour, Kernel, Patch},
    normal::Random,
    optics::Pinhole,
};

/// The outline of one printed area, in the roundel's plane (x right, y up), metres.
#[derive(Clone, Debug, PartialEq)]
pub enum Outline {
    /// A disc about the centre.
    Disc {
        /// Metres.
        diameter_m: f64,
    },
    /// An elliptical disc about the centre.
    Ellipse {
        /// Diameter along the print's x, metres.
        along_m: f64,
        /// Diameter along its y, metres.
        across_m: f64,
    },
    /// A closed polygon; curved outlines are given by as many corners as they need.
    Polygon(Vec<[f64; 2]>),
}

impl Outline {
    /// How far from the origin it reaches.
    pub fn radius_m(&self) -> f64 {
        match self {
            Outline::Disc { diameter_m } => diameter_m / 2.0,
            Outline::Ellipse { along_m, across_m } => along_m.max(*across_m) / 2.0,
            Outline::Polygon(corners) => {
                corners.iter().map(|c| c[0].hypot(c[1])).fold(0.0, f64::max)
            }
        }
    }
}

/// One area of even ink, printed over what lies below it.
///
/// An area must lie wholly inside one area of the other ink: then blur adds up exactly.
#[derive(Clone, Debug, PartialEq)]
pub struct Ink {
    /// Where.
    pub outline: Outline,
    /// White or black.
    pub white: bool,
}

/// What is printed: the white sheet first, then what lies on it, each inside one before.
#[derive(Clone, Debug, PartialEq)]
pub struct Print {
    /// The sheet, white.
    pub sheet: Outline,
    /// From below to above.
    pub inks: Vec<Ink>,
}

impl Print {
    /// A plain roundel on a round sheet whose margin is `margin` of the outer diameter all around.
    pub fn plain(outer_diameter_m: f64, inner_diameter_m: f64, margin: f64) -> Self {
        let disc = |diameter_m, white| Ink { outline: Outline::Disc { diameter_m }, white };
        Self {
            sheet: Outline::Disc { diameter_m: outer_diameter_m * (1.0 + 2.0 * margin) },
            inks: vec![disc(outer_diameter_m, false), disc(inner_diameter_m, true)],
        }
    }

    /// A plain roundel's sheet and ring with an elliptical disc, its longer diameter along x.
    pub fn elliptical(outer_diameter_m: f64, disc_m: (f64, f64), margin: f64) -> Self {
        let mut print = Self::plain(outer_diameter_m, disc_m.0, margin);
        print.inks[1].outline = Outline::Ellipse { along_m: disc_m.0, across_m: disc_m.1 };
        print
    }

    /// The negative: a white ring round a black disc, on a black sheet.
    pub fn inverted(mut self) -> Self {
        let sheet = Ink { outline: self.sheet.clone(), white: false };
        self.inks.iter_mut().for_each(|ink| ink.white = !ink.white);
        self.inks.insert(0, sheet);
        self
    }

    /// How far from the centre the ink reaches; the sheet does not count.
    pub fn radius_m(&self) -> f64 {
        self.inks.iter().map(|ink| ink.outline.radius_m()).fold(0.0, f64::max)
    }
}

/// How a camera forms its grey values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Imaging {
    /// Deviation of the lens' Gaussian blur, pixels, at least [`crate::coverage::MIN_BLUR_PX`].
    pub blur_px: f64,
    /// How far white spreads into black across every rim before the lens blurs, pixels. Discs only:
    /// polygons keep their size.
    pub bloom_px: f64,
    /// Deviation of the noise, grey levels.
    pub noise: f64,
    /// Grey level of black ink in full light.
    pub black: f64,
    /// Grey level of white paper in full light.
    pub white: f64,
    /// Light's relative change from the image's left to its right, and from top to bottom; 1 in the
    /// middle.
    pub gradient: [f64; 2],
    /// Exposure, seconds.
    pub exposure_s: f64,
    /// From one row's exposure to the next, seconds; 0: global shutter.
    pub line_time_s: f64,
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
        }
    }
}

/// A roundel in front of the camera.
pub struct Seen<'a> {
    /// What is printed.
    pub print: &'a Print,
    /// camera_from_roundel, as many seconds after the middle of the middle row's exposure.
    pub motion: &'a (dyn Fn(f64) -> Isometry3<f64> + Sync),
}

/// One frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row.
    pub pixels: Vec<u8>,
}

/// Noise-free grey values of a background: paint on it, then use it for every frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Canvas {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row, in full light.
    pub grey: Vec<f32>,
}

impl Canvas {
    /// All of one grey level.
    pub fn flat(width: usize, height: usize, grey: f64) -> Self {
        Self { width, height, grey: vec![grey as f32; width * height] }
    }

    /// Paints what a patch covers.
    pub fn paint(&mut self, patch: &Patch, grey: f64) {
        self.blend(patch, |below, share| below + share * (grey as f32 - below));
    }

    /// Adds a grey level times the coverage.
    fn add(&mut self, patch: &Patch, step: f64) {
        self.blend(patch, |below, share| below + share * step as f32);
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
    /// Geometry.
    pub camera: Pinhole,
    /// Grey values.
    pub imaging: Imaging,
    kernel: Kernel,
}

impl Renderer {
    /// A renderer for this camera.
    pub fn new(camera: Pinhole, imaging: Imaging) -> Self {
        Self { camera, imaging, kernel: Kernel::new(imaging.blur_px) }
    }

    /// The blur's kernel, for painting backgrounds as sharp as the roundels.
    pub fn kernel(&self) -> &Kernel {
        &self.kernel
    }

    /// The frame with noise and rounding; `random` is the frame's own stream.
    pub fn frame(&self, background: &Canvas, seen: &[Seen<'_>], random: &mut Random) -> Image {
        let ideal = self.ideal(background, seen);
        let noise = self.imaging.noise as f32;
        let level = |grey: &f32| (grey + noise * random.normal()).round().clamp(0.0, 255.0) as u8;
        let pixels = ideal.grey.iter().map(level).collect();
        Image { width: ideal.width, height: ideal.height, pixels }
    }

    /// The frame before noise and rounding.
    pub fn ideal(&self, background: &Canvas, seen: &[Seen<'_>]) -> Canvas {
        let mut canvas = background.clone();
        let mut order: Vec<&Seen<'_>> = seen.iter().collect();
        let depth = |seen: &Seen<'_>| (seen.motion)(0.0).translation.z;
        order.sort_by(|one, other| depth(other).total_cmp(&depth(one)));
        for roundel in order {
            self.draw(&mut canvas, roundel);
        }
        self.light(&mut canvas);
        canvas
    }

    fn draw(&self, canvas: &mut Canvas, seen: &Seen<'_>) {
        let (white, black) = (self.imaging.white, self.imaging.black);
        let Some(sheet) = self.patch(&seen.print.sheet, true, seen) else { return };
        canvas.paint(&sheet, white);
        for ink in &seen.print.inks {
            let step = if ink.white { white - black } else { black - white };
            if let Some(patch) = self.patch(&ink.outline, ink.white, seen) {
                canvas.add(&patch, step);
            }
        }
    }

    /// Mean coverage over the exposure; `None` if it is not in the image, faces away or is behind.
    fn patch(&self, outline: &Outline, white: bool, seen: &Seen<'_>) -> Option<Patch> {
        let spread_px = if white { self.imaging.bloom_px } else { -self.imaging.bloom_px };
        let contours = self
            .instants(outline, seen)
            .into_iter()
            .map(|(offset_s, weight)| {
                Some((self.contour(outline, spread_px, seen, offset_s)?, weight))
            })
            .collect::<Option<Vec<_>>>()?;
        Patch::of(&contours, &self.kernel, self.camera.width, self.camera.height)
    }

    /// Instants of the exposure with their weights, as many as the motion in it asks for.
    fn instants(&self, outline: &Outline, seen: &Seen<'_>) -> Vec<(f64, f64)> {
        let half_s = self.imaging.exposure_s / 2.0;
        let edge = |t: f64| {
            self.camera.project(&((seen.motion)(t) * Point3::new(outline.radius_m(), 0.0, 0.0)))
        };
        let moved_px = match (edge(-half_s), edge(half_s)) {
            (Some(start), Some(end)) => (end - start).norm(),
            _ => 0.0,
        };
        let ratio = moved_px / self.imaging.blur_px.max(crate::coverage::MIN_BLUR_PX);
        if ratio < 0.02 {
            return vec![(0.0, 1.0)];
        }
        // Five Gauss-Legendre nodes over each stretch that the blur smooths well.
        let panels = (ratio / 3.0).ceil();
        let in_panel = |panel: usize| {
            GAUSS_5.iter().map(move |(node, weight)| {
                let place = (2.0 * panel as f64 + 1.0 + node) / panels - 1.0;
                (place * half_s, weight / panels)
            })
        };
        (0..panels as usize).flat_map(in_panel).collect()
    }

    fn contour(
        &self,
        outline: &Outline,
        spread_px: f64,
        seen: &Seen<'_>,
        offset_s: f64,
    ) -> Option<Contour> {
        let pose = (seen.motion)(offset_s);
        let facing = (pose.rotation * nalgebra::Vector3::z()).dot(&pose.translation.vector);
        if facing >= 0.0 {
            return None;
        }
        let at = |x: f64, y: f64| self.seen_at(&pose, seen, offset_s, &Point3::new(x, y, 0.0));
        let spacing_px = self.imaging.blur_px.max(crate::coverage::MIN_BLUR_PX);
        let round = |[x_m, y_m]: [f64; 2]| {
            let center = at(0.0, 0.0)?;
            let rim = |angle: f64| at(x_m * angle.cos(), y_m * angle.sin());
            let mut reach_px: f64 = 0.0;
            for i in 0..8 {
                let on_rim = rim(f64::from(i) * std::f64::consts::FRAC_PI_4)?;
                reach_px = reach_px.max((on_rim - center).norm());
            }
            // The chord of eight directions may miss the longest one by 8 %.
            let around_px = std::f64::consts::TAU * reach_px * 1.1;
            let count = (around_px / spacing_px).ceil().max(48.0) as usize;
            if spread_px == 0.0 {
                return Contour::smooth(count, rim);
            }
            Contour::smooth(count, |angle| {
                let along = rim(angle + 1e-4)? - rim(angle - 1e-4)?;
                let across = Vector2::new(along.y, -along.x).normalize();
                let (place, side) = (rim(angle)?, across.dot(&(rim(angle)? - center)));
                Some(place + across * side.signum() * spread_px)
            })
        };
        match outline {
            Outline::Disc { diameter_m } => round([diameter_m / 2.0; 2]),
            Outline::Ellipse { along_m, across_m } => round([along_m / 2.0, across_m / 2.0]),
            Outline::Polygon(corners) => {
                let corners: Vec<_> = corners.iter().map(|c| Vector2::from(*c)).collect();
                Contour::polygon(&corners, 2.0 * spacing_px, |p| at(p.x, p.y))
            }
        }
    }

    /// Where a printed point appears, given that each row is exposed at its own time.
    fn seen_at(
        &self,
        pose: &Isometry3<f64>,
        seen: &Seen<'_>,
        offset_s: f64,
        point: &Point3<f64>,
    ) -> Option<Vector2<f64>> {
        let mut pixel = self.camera.project(&(pose * point))?;
        if self.imaging.line_time_s != 0.0 {
            // Contracts by (image speed × line time) a round, below 1/50 for anything that could be
            // followed.
            for _ in 0..5 {
                let row_s =
                    (pixel.y - (self.camera.height as f64 - 1.0) / 2.0) * self.imaging.line_time_s;
                pixel = self.camera.project(&((seen.motion)(offset_s + row_s) * point))?;
            }
        }
        Some(pixel)
    }

    fn light(&self, canvas: &mut Canvas) {
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

/// Gauss-Legendre on [-1, 1], weights to a sum of 1.
const GAUSS_5: [(f64, f64); 5] = [
    (-0.906_179_845_938_664, 0.118_463_442_528_094_5),
    (-0.538_469_310_105_683_1, 0.239_314_335_249_683_2),
    (0.0, 0.284_444_444_444_444_45),
    (0.538_469_310_105_683_1, 0.239_314_335_249_683_2),
    (0.906_179_845_938_664, 0.118_463_442_528_094_5),
];
