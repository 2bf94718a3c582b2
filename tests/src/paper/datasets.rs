//! The datasets of section 6.3.2, rendered: "small", "large" and "fast".
//!
//! Stated in the paper: one static roundel of 700 pixels, about 0.1 % of the image; one of 60 px; and 130 images of a
//! fast one of variable size whose tracking fails once. Chosen here: the Logitech's 1024x768, a lab's clutter behind,
//! a path on which the roundel moves by up to 13 px a frame while its diameter varies between 24 and 80 px, and
//! halfway a jump across a third of the image.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Vector2, Vector3};
use rayon::prelude::*;

use super::{
    Length,
    scene::{PaperCamera, slanted},
};
use crate::{
    clutter::{Clutter, background},
    optics::Pinhole,
    random::Random,
    render::{Image, MovingPrint, Print, Renderer},
};

/// Diameter or side of the marker.
pub const SIDE_M: f64 = 0.15;
/// Images of the fast dataset.
pub const FAST: usize = 130;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dataset {
    /// 30 px, static; the "slow" one of table 8.
    Small,
    /// 60 px, static.
    Large,
    /// Moving, with one jump.
    Fast,
}

impl Dataset {
    /// The paper's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Small => "small",
            Self::Large => "large",
            Self::Fast => "fast",
        }
    }

    /// Mean diameter.
    pub fn diameter_px(self) -> f64 {
        match self {
            Self::Small => 30.0,
            Self::Large => 60.0,
            Self::Fast => 52.0,
        }
    }

    /// Images of the static datasets differ by noise alone, so a few represent the paper's thousand.
    pub fn count(self, length: Length) -> usize {
        if self == Self::Fast { FAST } else { length.pick(8, 50) }
    }

    /// Centre and diameter in one of the images, pixels.
    pub fn place(self, optics: &Pinhole, number: usize) -> (Vector2<f64>, f64) {
        let middle = Vector2::new(optics.width as f64, optics.height as f64) / 2.0;
        if self != Self::Fast {
            return (middle + Vector2::new(40.3, -25.6), self.diameter_px());
        }
        let angle = TAU * number as f64 / FAST as f64;
        let jump = if number >= FAST / 2 { Vector2::new(280.0, -110.0) } else { Vector2::zeros() };
        let way = Vector2::new(90.0 * (2.0 * angle).sin(), 70.0 * (3.0 * angle).cos());
        (middle + Vector2::new(-150.0, 70.0) + way + jump, 52.0 + 28.0 * (5.0 * angle).sin())
    }

    fn pose(self, optics: &Pinhole, number: usize) -> Isometry3<f64> {
        let (pixel, diameter_px) = self.place(optics, number);
        let z = optics.focal_px[0] * SIDE_M / diameter_px;
        let ray: Vector3<f64> = optics.ray(&pixel).expect("a pixel of the image");
        slanted(ray * z, 0.3, 0.7)
    }

    /// Its images of this print.
    pub fn pictures(self, camera: &PaperCamera, print: &Print, length: Length) -> Vec<Image> {
        let renderer = Renderer::new(camera.optics, camera.imaging);
        let behind = background(&renderer, 120.0, &Clutter::LAB, &mut Random::new(20, 0));
        let picture = |number: usize| {
            let pose = self.pose(&camera.optics, number);
            let motion = |_: f64| pose;
            let moving = [MovingPrint { print, motion: &motion }];
            renderer.frame(&behind, &moving, &mut Random::new(21, number as u64))
        };
        (0..self.count(length)).into_par_iter().map(picture).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fast_dataset_jumps_once_and_stays_in_the_image() {
        let optics = PaperCamera::logitech().optics;
        let places: Vec<_> = (0..FAST).map(|number| Dataset::Fast.place(&optics, number)).collect();
        let moved_px = |two: &[(Vector2<f64>, f64)]| (two[1].0 - two[0].0).norm();
        let far: Vec<f64> = places.windows(2).map(moved_px).filter(|px| *px > 14.0).collect();
        assert!(matches!(far[..], [px] if px > 250.0), "{far:?}");
        let near: Vec<f64> = places.windows(2).map(moved_px).filter(|px| *px <= 14.0).collect();
        let mean_px = near.iter().sum::<f64>() / near.len() as f64;
        assert!((3.0..14.0).contains(&mean_px), "{mean_px}");
        for (middle, diameter_px) in places {
            let reach_px = 0.8 * diameter_px;
            assert!(middle.x > reach_px && middle.x < optics.width as f64 - reach_px);
            assert!(middle.y > reach_px && middle.y < optics.height as f64 - reach_px);
        }
    }
}
