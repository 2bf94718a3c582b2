//! What DESIGN.md calls lab realism, for a whole arena.

use std::f64::consts::TAU;

use super::{Arena, Kind, Robot, Site};
use crate::{
    coded::{coded_print, words},
    half_plane::HalfPlane,
    light::{Light, Ramp, Shadow},
    print::{Bend, Printing},
    processing::Processing,
    random::Random,
    render::{Imaging, Print},
};

/// Level of white as a multiple of what the sensor holds.
const SATURATION: f64 = 1.2;
/// Black reflects a tenth of the light.
const BLACK_SHARE: f64 = 0.1;
const BEND_M: f64 = 2.0;
const SPREAD_M: f64 = 4e-4;
/// White margin, as a share of the outer diameter.
const MARGIN: f64 = 0.06;
const WIDE_MARGIN: f64 = 0.25;

/// Conditions of a lab, one by one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum LabCondition {
    /// Ink that spreads, or is missing.
    Spread,
    /// Thin margins.
    Margin,
    /// Bent paper.
    Bend,
    /// Lamps on one side.
    Lamp,
    /// The hard edge of a shadow across each picture.
    Shadow,
    /// Saturated white.
    Saturation,
    Jpeg,
    Defocus,
}

impl Arena {
    /// Prints each plain roundel as a printer does: `scale` times as large, with discs `ratio` times as large as well, and
    /// a margin of 6 %.
    pub fn print_all(&mut self, scale: f64, ratio: f64) {
        let printing = Printing { scale, ratio, spread_m: 0.0 };
        let kind = self.kinds[0].clone();
        for robot in &mut self.robots {
            robot.print = design(&kind, robot, MARGIN).as_printed(&printing);
        }
    }

    /// A lab with prints `scale` times as large as designed, and all conditions but those in `without`. Lens files are up
    /// to the caller.
    pub fn make_real(&mut self, scale: f64, without: &[LabCondition]) {
        let has = |condition| !without.contains(&condition);
        let mut random = Random::new(self.seed, 77);
        let spread_m = random.uniform(-SPREAD_M, SPREAD_M);
        let spread_m = if has(LabCondition::Spread) { spread_m } else { 0.0 };
        let printing = Printing { scale, ratio: 1.0, spread_m };
        let margin = if has(LabCondition::Margin) { MARGIN } else { WIDE_MARGIN };
        let kind = self.kinds[0].clone();
        for robot in &mut self.robots {
            let axis_rad = random.uniform(0.0, TAU);
            let radius_m = BEND_M * random.uniform(-1.0, 1.0).signum();
            let bend = has(LabCondition::Bend).then_some(Bend { radius_m, axis_rad });
            robot.print = Print { bend, ..design(&kind, robot, margin).as_printed(&printing) };
        }
        self.sites.iter_mut().for_each(|site| site.imaging = imaging(site, &has, &mut random));
    }
}

fn design(kind: &Kind, robot: &Robot, margin: f64) -> Print {
    match kind.code_bits.zip(robot.code) {
        Some((bits, number)) => {
            let word = words(bits)[usize::from(number) - 1];
            coded_print(kind.outer_diameter_m, bits, word, margin)
        }
        None => Print::plain(kind.outer_diameter_m, kind.inner_diameter_m, margin),
    }
}

fn imaging(site: &Site, has: &dyn Fn(LabCondition) -> bool, random: &mut Random) -> Imaging {
    let optics = &site.optics;
    let through_px =
        [optics.width, optics.height].map(|side| side as f64 * random.uniform(0.3, 0.7));
    let area = HalfPlane { through_px, heading_rad: random.uniform(0.0, TAU) };
    let ramp = Ramp {
        center_px: optics.center_px,
        heading_rad: random.uniform(0.0, TAU),
        length_px: optics.width as f64,
    };
    let shadow = Shadow { area, loss: random.uniform(0.3, 0.6) };
    let light = Light {
        shadow: has(LabCondition::Shadow).then_some(shadow),
        ramp: has(LabCondition::Lamp).then_some(ramp),
        ..Light::default()
    };
    let white = if has(LabCondition::Saturation) { 255.0 * SATURATION } else { site.imaging.white };
    let blur_px = random.uniform(0.7, 1.6);
    let jpeg_quality = has(LabCondition::Jpeg).then_some(70);
    Imaging {
        blur_px: if has(LabCondition::Defocus) { blur_px } else { site.imaging.blur_px },
        black: BLACK_SHARE * white,
        white,
        light,
        processing: Processing { jpeg_quality, ..Processing::default() },
        ..site.imaging
    }
}
