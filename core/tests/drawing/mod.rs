//! Draws roundels as seen by a camera: elliptic discs, blurred by a Gaussian and averaged over the pixels' squares.
//! Shares no code with the detector.
//!
//! Along u both integrals have a closed form. Along v the disc is cut into thin strips, each weighted by the same
//! integrals at its centre. The error of this is below 0.001 px of the rim.

// Each test or benchmark uses a part of this.
#![allow(dead_code)]

pub mod projected;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use roundel_core::{
    camera::PixelPoint,
    ellipse::Ellipse,
    frame::Frame,
    marker::{CodeLayout, Tooth},
};

const STRIPS_PER_PX: usize = 16;

/// A canvas of light.
pub struct Drawing {
    pub width: usize,
    pub height: usize,
    light: Vec<f64>,
    blur_px: f64,
}

/// The image of a roundel.
#[derive(Clone, Copy, Debug)]
pub struct Roundel {
    pub outer: Ellipse,
    /// Inner over outer diameter.
    pub ratio: f64,
    /// Radius of the white margin over that of the outer rim.
    pub margin: f64,
    pub black: f64,
    pub white: f64,
}

pub fn ellipse((u, v): (f64, f64), (major, minor): (f64, f64), angle_rad: f64) -> Ellipse {
    let center = PixelPoint { u, v };
    Ellipse { center, semi_major_px: major, semi_minor_px: minor, angle_rad }
}

impl Roundel {
    pub fn inner(&self) -> Ellipse {
        scaled(&self.outer, self.ratio)
    }
}

fn scaled(rim: &Ellipse, by: f64) -> Ellipse {
    Ellipse { semi_major_px: rim.semi_major_px * by, semi_minor_px: rim.semi_minor_px * by, ..*rim }
}

impl Drawing {
    /// An even background.
    pub fn new(width: usize, height: usize, background: f64, blur_px: f64) -> Self {
        Self { width, height, light: vec![background; width * height], blur_px }
    }

    /// Adds a roundel on an even `background`.
    pub fn add(&mut self, roundel: &Roundel, background: f64) {
        let Roundel { outer, margin, black, white, .. } = *roundel;
        self.add_disc(&scaled(&outer, margin), white - background);
        self.add_disc(&outer, black - white);
        self.add_disc(&roundel.inner(), white - black);
    }

    /// Adds a coded roundel, whose `ratio` is that of the white disc between the teeth, with the print's right along
    /// the major axis. The teeth's sides are as sharp as pixels, the round rims blurred.
    pub fn add_coded(&mut self, roundel: &Roundel, background: f64, teeth: &[Tooth]) {
        const FINE: usize = 6;
        let core = roundel.ratio * CodeLayout::CORE_SHARE;
        self.add(&Roundel { ratio: core, ..*roundel }, background);
        let (outer, contrast) = (roundel.outer, roundel.white - roundel.black);
        let (sin, cos) = outer.angle_rad.sin_cos();
        let is_gap = |u: f64, v: f64| {
            let (du, dv) = (u - outer.center.u, v - outer.center.v);
            let x = (du * cos + dv * sin) / outer.semi_major_px;
            // On the print y is up.
            let y = -(dv * cos - du * sin) / outer.semi_minor_px;
            let angle_rad = y.atan2(x).rem_euclid(std::f64::consts::TAU);
            let radius = x.hypot(y);
            let is_between = radius >= core && radius < roundel.ratio;
            is_between && !teeth.iter().any(|t| t.from_rad <= angle_rad && angle_rad < t.to_rad)
        };
        let place = |k: usize| (k as f64 + 0.5) / FINE as f64 - 0.5;
        let columns = self.columns(outer.center.u, outer.semi_major_px);
        for v in self.rows(outer.center.v, outer.semi_major_px) {
            for u in columns.clone() {
                let inside = (0..FINE * FINE)
                    .filter(|k| is_gap(u as f64 + place(k % FINE), v as f64 + place(k / FINE)));
                let share = inside.count() as f64 / (FINE * FINE) as f64;
                self.light[v * self.width + u] += contrast * share;
            }
        }
    }

    /// Adds `level` times the blurred disc.
    pub fn add_disc(&mut self, disc: &Ellipse, level: f64) {
        let (sin, cos) = disc.angle_rad.sin_cos();
        let (a, b) = (disc.semi_major_px, disc.semi_minor_px);
        // Along a row of height y the disc spans x = slope y ± sqrt(...), by its quadratic form.
        let uu = (cos / a).powi(2) + (sin / b).powi(2);
        let vv = (sin / a).powi(2) + (cos / b).powi(2);
        let uv = sin * cos * (1.0 / (a * a) - 1.0 / (b * b));
        let reach = 5.0 * self.blur_px + 1.0;
        let top = (uu / (uu * vv - uv * uv)).sqrt();
        let columns = self.columns(disc.center.u, a + reach);
        let mut line = vec![0.0; columns.len()];
        let strips = (2.0 * top * STRIPS_PER_PX as f64).ceil() as usize;
        let thickness = 2.0 * top / strips as f64;
        for strip in 0..strips {
            let y = -top + (strip as f64 + 0.5) * thickness;
            let half = ((uv * y).powi(2) - uu * (vv * y * y - 1.0)).max(0.0).sqrt() / uu;
            let middle = disc.center.u - uv * y / uu;
            for (value, u) in line.iter_mut().zip(columns.clone()) {
                *value = level * self.along(u as f64 - middle, half);
            }
            let y = disc.center.v + y;
            for v in self.rows(y, reach) {
                let weight = thickness * self.across(v as f64 - y);
                let row = &mut self.light[v * self.width..(v + 1) * self.width];
                for (light, value) in row[columns.clone()].iter_mut().zip(&line) {
                    *light += weight * value;
                }
            }
        }
    }

    /// Adds light by pixel, unblurred.
    pub fn stripe(&mut self, light: impl Fn(usize, usize) -> f64) {
        for (v, row) in self.light.chunks_exact_mut(self.width).enumerate() {
            row.iter_mut().enumerate().for_each(|(u, value)| *value += light(u, v));
        }
    }

    /// Multiplies the light by pixel.
    pub fn light(&mut self, share: impl Fn(usize, usize) -> f64) {
        for (v, row) in self.light.chunks_exact_mut(self.width).enumerate() {
            row.iter_mut().enumerate().for_each(|(u, value)| *value *= share(u, v));
        }
    }

    /// Multiplies the light by 1 + (u - centre) × `share` / width.
    pub fn shade(&mut self, share: f64) {
        let middle = 0.5 * self.width as f64;
        for row in self.light.chunks_exact_mut(self.width) {
            for (u, light) in row.iter_mut().enumerate() {
                *light *= 1.0 + (u as f64 - middle) * share / middle;
            }
        }
    }

    /// Leaves a share of the light beyond a line at `offset_px` from a point, along the direction `towards_rad`.
    pub fn shadow(&mut self, (u0, v0): (f64, f64), towards_rad: f64, offset_px: f64, share: f64) {
        let (sin, cos) = towards_rad.sin_cos();
        for (v, row) in self.light.chunks_exact_mut(self.width).enumerate() {
            for (u, light) in row.iter_mut().enumerate() {
                let beyond_px = (u as f64 - u0) * cos + (v as f64 - v0) * sin - offset_px;
                *light *= 1.0 + (share - 1.0) * normal_cdf(beyond_px / self.blur_px);
            }
        }
    }

    /// The 8-bit picture, with noise of this deviation.
    pub fn picture(&self, noise: f64, seed: u64) -> Vec<u8> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let normal = Normal::new(0.0, noise).unwrap();
        self.light.iter().map(|&light| (light + normal.sample(&mut rng)).round() as u8).collect()
    }

    fn columns(&self, u: f64, half: f64) -> std::ops::Range<usize> {
        let first = (u - half).floor().max(0.0) as usize;
        first..((u + half).ceil().max(0.0) as usize + 1).clamp(first, self.width.max(first))
    }

    fn rows(&self, v: f64, half: f64) -> std::ops::Range<usize> {
        let first = (v - half).floor().max(0.0) as usize;
        first..((v + half).ceil().max(0.0) as usize + 1).clamp(first, self.height.max(first))
    }

    /// Share of the pixel at distance x from the centre of a blurred chord of ± half that the chord covers.
    fn along(&self, x: f64, half: f64) -> f64 {
        let edge = |x: f64| self.blur_px * ramp(x / self.blur_px);
        edge(x + 0.5 + half) - edge(x + 0.5 - half) - edge(x - 0.5 + half) + edge(x - 0.5 - half)
    }

    /// Density of a line at distance y from the pixel's centre, integrated over the pixel.
    fn across(&self, y: f64) -> f64 {
        normal_cdf((y + 0.5) / self.blur_px) - normal_cdf((y - 0.5) / self.blur_px)
    }
}

/// Side of [`nine`].
pub const SIDE: usize = 300;

/// Nine roundels, moved by `shift` pixels, one of them `missing`.
pub fn nine(shift: f64, missing: Option<u32>, seed: u64) -> Vec<u8> {
    let mut drawing = Drawing::new(SIDE, SIDE, 90.0, 0.7);
    for place in (0..9).filter(|&place| Some(place) != missing) {
        let at = (
            50.0 + 95.0 * f64::from(place % 3) + shift,
            50.0 + 95.0 * f64::from(place / 3) - shift,
        );
        let outer = ellipse(at, (12.0 + f64::from(place), 11.0), 0.3);
        let roundel = Roundel { outer, ratio: 0.5, margin: 1.4, black: 40.0, white: 200.0 };
        drawing.add(&roundel, 90.0);
    }
    drawing.picture(2.0, seed)
}

/// A picture as a frame.
pub fn frame(picture: &[u8], width: usize) -> Frame<'_> {
    Frame::new(picture, width, picture.len() / width, width).unwrap()
}

/// ∫ Φ.
fn ramp(z: f64) -> f64 {
    if z < -8.0 {
        return 0.0;
    }
    if z > 8.0 {
        return z;
    }
    z * normal_cdf(z) + (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt()
}

/// Φ, to 1e-7 (Abramowitz and Stegun, 7.1.26).
fn normal_cdf(z: f64) -> f64 {
    let x = z.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let series = [1.061_405_429, -1.453_152_027, 1.421_413_741, -0.284_496_736, 0.254_829_592];
    let tail = 0.5 * t * series.iter().fold(0.0, |sum, c| sum * t + c) * (-x * x).exp();
    if z > 0.0 { 1.0 - tail } else { tail }
}
