//! Conditions by name.

use crate::{precision::NARROW_MARGIN, processing::Processing, render::Imaging};

/// Whether prints have a code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Marker {
    Plain,
    /// With a code of 8 bits.
    Coded,
}

impl Marker {
    pub fn name(self) -> &'static str {
        match self {
            Marker::Plain => "plain",
            Marker::Coded => "coded",
        }
    }
}

/// What differs from an ideal print in even light. Pairs are drawn uniformly, minimum to maximum, per roundel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Condition {
    pub name: &'static str,
    /// Angle between normal and line of sight. Roundels that begin face-on rotate about their normal only.
    pub tilt_deg: (f64, f64),
    pub print: PrintFaults,
    pub light: LightFaults,
    pub camera: CameraFaults,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrintFaults {
    /// White margin, as a share of the outer diameter.
    pub margin: f64,
    /// Dark blotches in the margin.
    pub is_dirty: bool,
    pub scale: (f64, f64),
    /// Diameter of the disc over its nominal share of the outer one.
    pub ratio: (f64, f64),
    /// Distance that ink spreads into white.
    pub spread_mm: (f64, f64),
    /// White that spreads into black in the image, as saturated sensors do.
    pub bloom_px: f64,
    /// Radius of the bent paper, convex or concave at random.
    pub bend_m: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightFaults {
    /// Share of the light that is lost beyond an edge that moves across the ring.
    pub shadow: Option<(f64, f64)>,
    pub lamp: Option<Lamp>,
    /// A bright spot near the rim.
    pub has_glare: bool,
    /// Grey level of black and white in full light.
    pub levels: [f64; 2],
}

/// Length over which light falls by half.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lamp {
    AcrossRing,
    AcrossImage,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraFaults {
    pub blur_px: (f64, f64),
    pub processing: Processing,
    pub has_vignetting: bool,
    pub exposure_s: f64,
    /// Time between the exposures of two rows, known to core.
    pub line_time_s: f64,
    /// Speed across the line of sight; `None` for a pixel per frame.
    pub speed_m_s: Option<f64>,
    /// Relative error of the focal length that core knows.
    pub focal_error: (f64, f64),
    /// Share of frames that are lost, in bursts of two.
    pub lost_frames: f64,
}

const fn exactly(value: f64) -> (f64, f64) {
    (value, value)
}

impl Condition {
    /// An ideal print in even light, tilted.
    pub fn plain() -> Self {
        let imaging = Imaging::default();
        Self {
            name: "plain",
            tilt_deg: (15.0, 45.0),
            print: PrintFaults {
                margin: NARROW_MARGIN,
                is_dirty: false,
                scale: exactly(1.0),
                ratio: exactly(1.0),
                spread_mm: exactly(0.0),
                bloom_px: 0.0,
                bend_m: None,
            },
            light: LightFaults {
                shadow: None,
                lamp: None,
                has_glare: false,
                levels: [imaging.black, imaging.white],
            },
            camera: CameraFaults {
                blur_px: exactly(imaging.blur_px),
                processing: Processing::default(),
                has_vignetting: false,
                exposure_s: 1e-3,
                line_time_s: 0.0,
                speed_m_s: None,
                focal_error: exactly(0.0),
                lost_frames: 0.0,
            },
        }
    }

    fn print(name: &'static str, change: impl Fn(&mut PrintFaults)) -> Self {
        let mut condition = Self { name, ..Self::plain() };
        change(&mut condition.print);
        condition
    }

    fn light(name: &'static str, change: impl Fn(&mut LightFaults)) -> Self {
        let mut condition = Self { name, ..Self::plain() };
        change(&mut condition.light);
        condition
    }

    fn camera(name: &'static str, change: impl Fn(&mut CameraFaults)) -> Self {
        let mut condition = Self { name, ..Self::plain() };
        change(&mut condition.camera);
        condition
    }

    /// White at this multiple of the sensor's full scale, black at a tenth of white.
    fn saturated(name: &'static str, multiple: f64) -> Self {
        Self::light(name, |light| light.levels = saturated_levels(multiple))
    }

    fn shadow(name: &'static str, loss: f64) -> Self {
        Self::light(name, |light| light.shadow = Some(exactly(loss)))
    }

    fn processing(name: &'static str, processing: Processing) -> Self {
        Self::camera(name, |camera| camera.processing = processing)
    }

    /// All that DESIGN.md's "Lab realism" names, together.
    fn r4_real() -> Self {
        Self {
            name: "r4-real",
            print: PrintFaults {
                margin: 0.06,
                scale: (0.97, 1.03),
                spread_mm: (-0.4, 0.4),
                bend_m: Some(2.0),
                ..Self::plain().print
            },
            light: LightFaults {
                shadow: Some((0.3, 0.6)),
                lamp: Some(Lamp::AcrossImage),
                levels: saturated_levels(1.2),
                ..Self::plain().light
            },
            camera: CameraFaults {
                blur_px: (0.7, 1.6),
                processing: Processing { jpeg_quality: Some(70), ..Processing::default() },
                focal_error: (-1e-3, 1e-3),
                lost_frames: 0.05,
                ..Self::plain().camera
            },
            ..Self::plain()
        }
    }
}

fn saturated_levels(multiple: f64) -> [f64; 2] {
    [0.1 * 255.0 * multiple, 255.0 * multiple]
}

/// All conditions, `plain` first.
pub fn all() -> Vec<Condition> {
    let none = Processing::default();
    vec![
        Condition::plain(),
        Condition { name: "face-on", tilt_deg: (0.0, 0.0), ..Condition::plain() },
        Condition::print("margin-10", |print| print.margin = 0.1),
        Condition::print("margin-7.5", |print| print.margin = 0.075),
        Condition::print("margin-6", |print| print.margin = 0.06),
        Condition::print("dirty-margin", |print| (print.is_dirty, print.margin) = (true, 0.15)),
        Condition::print("disc-1.5-larger", |print| print.ratio = exactly(1.015)),
        Condition::print("disc-3-smaller", |print| print.ratio = exactly(0.97)),
        Condition::print("scale-0.97", |print| print.scale = exactly(0.97)),
        Condition::print("scale-1.03", |print| print.scale = exactly(1.03)),
        Condition::print("ink-spread-0.4", |print| print.spread_mm = exactly(0.4)),
        Condition::print("ink-shrink-0.4", |print| print.spread_mm = exactly(-0.4)),
        Condition::print("bent-2m", |print| print.bend_m = Some(2.0)),
        Condition::saturated("saturated-1.5", 1.5),
        Condition::saturated("saturated-2.2", 2.2),
        Condition {
            print: PrintFaults { bloom_px: 0.3, ..Condition::plain().print },
            ..Condition::saturated("saturated-bloom", 1.5)
        },
        Condition::shadow("shadow-30", 0.3),
        Condition::shadow("shadow-50", 0.5),
        Condition::shadow("shadow-60", 0.6),
        Condition::light("gradient", |light| {
            // White at the bright rim stays below saturation.
            (light.lamp, light.levels) = (Some(Lamp::AcrossRing), [35.0, 170.0]);
        }),
        Condition::light("glare", |light| light.has_glare = true),
        Condition::processing("jpeg-70", Processing { jpeg_quality: Some(70), ..none }),
        Condition::processing("sharpened", Processing { sharpening: 1.0, ..none }),
        Condition::processing("gain-noise", Processing { photon_noise: 0.15, ..none }),
        Condition::camera("vignetting", |camera| camera.has_vignetting = true),
        Condition::camera("defocus-1.6", |camera| camera.blur_px = exactly(1.6)),
        Condition::camera("rolling-shutter", |camera| {
            (camera.exposure_s, camera.line_time_s) = (4e-3, 16e-6);
            camera.speed_m_s = Some(0.5);
        }),
        Condition::camera("lens-error-0.1", |camera| camera.focal_error = exactly(1e-3)),
        Condition::r4_real(),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_distinct() {
        let mut names: Vec<_> = all().iter().map(|condition| condition.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), all().len());
    }
}
