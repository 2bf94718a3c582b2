//! What DESIGN.md calls lab realism, for a whole arena.

use std::f64::consts::TAU;

use super::{Arena, Site};
use crate::{
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

impl Arena {
    /// Prints each plain roundel as a printer does: `scale` times as large, with discs `ratio` times as large as well, and
    /// a margin of 6 %.
    pub fn print_all(&mut self, scale: f64, ratio: f64) {
        let kind = &self.kinds[0];
        let design = Print::plain(kind.outer_diameter_m, kind.inner_diameter_m, MARGIN);
        let print = design.as_printed(&Printing { scale, ratio, spread_m: 0.0 });
        self.robots.iter_mut().for_each(|robot| robot.print = print.clone());
    }

    /// A lab: prints `scale` times as large as designed, with ink that spreads, on bent paper with thin margins; lamps on
    /// one side, the hard edge of a shadow across each picture, saturated white, JPEG and defocus. Lens files are up to the
    /// export ([`crate::export::Export::lens_error`]).
    pub fn make_real(&mut self, scale: f64) {
        let mut random = Random::new(self.seed, 77);
        let spread_m = random.uniform(-SPREAD_M, SPREAD_M);
        self.print_all(scale, 1.0);
        for robot in &mut self.robots {
            let axis_rad = random.uniform(0.0, TAU);
            let radius_m = BEND_M * random.uniform(-1.0, 1.0).signum();
            let spread = Printing { spread_m, ..Printing::default() };
            robot.print = Print {
                bend: Some(Bend { radius_m, axis_rad }),
                ..robot.print.as_printed(&spread)
            };
        }
        self.sites.iter_mut().for_each(|site| site.imaging = imaging(site, &mut random));
    }
}

fn imaging(site: &Site, random: &mut Random) -> Imaging {
    let optics = &site.optics;
    let through_px =
        [optics.width, optics.height].map(|side| side as f64 * random.uniform(0.3, 0.7));
    let area = HalfPlane { through_px, heading_rad: random.uniform(0.0, TAU) };
    let ramp = Ramp {
        center_px: optics.center_px,
        heading_rad: random.uniform(0.0, TAU),
        length_px: optics.width as f64,
    };
    let light = Light {
        shadow: Some(Shadow { area, loss: random.uniform(0.3, 0.6) }),
        ramp: Some(ramp),
        ..Light::default()
    };
    let white = 255.0 * SATURATION;
    Imaging {
        blur_px: random.uniform(0.7, 1.6),
        black: BLACK_SHARE * white,
        white,
        light,
        processing: Processing { jpeg_quality: Some(70), ..Processing::default() },
        ..site.imaging
    }
}
