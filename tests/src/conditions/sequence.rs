//! Renders one roundel under a condition, frame by frame, in a window of a camera's image.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};

use super::condition::{Condition, Lamp, Marker};
use crate::{
    arena::Kind,
    bound::{Bound, Scene, Unknowns, bound},
    coded::{coded_print, words},
    half_plane::HalfPlane,
    light::{Glare, Light, Ramp, Shadow, Vignetting},
    optics::Pinhole,
    precision::{FLOOR, NARROW_MARGIN},
    print::{Bend, Printing},
    processing::Processing,
    random::Random,
    render::{Canvas, Image, Imaging, Ink, MovingPrint, Outline, Print, Renderer},
};

pub const RATE_HZ: f64 = 60.0;
const CODE_BITS: u8 = 8;
/// Amplitude of the rotation, so that a period of 24 frames gives about a degree per frame.
const TURN_RAD: f64 = 0.067;
/// Random stream of the first frame's noise.
const FIRST_NOISE: u64 = 1000;
/// Distance of a shadow's edge from the centre at its extremes, in outer radii.
const SHADOW_SWEEP: f64 = 0.9;

/// Where and when a roundel is rendered.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// The whole camera.
    pub whole: Pinhole,
    /// Left, top.
    pub corner_px: [f64; 2],
    pub side_px: usize,
    /// Rows from that which is exposed at a frame's time to the window's centre row.
    pub row_offset: f64,
    /// Frames of one circle.
    pub period: usize,
}

/// The side of a window that holds a roundel of this size on its circle, with some floor around.
pub fn side_px(condition: &Condition, diameter_px: f64, period: usize) -> usize {
    let sheet_px = diameter_px * (1.0 + 2.0 * NARROW_MARGIN);
    let side = sheet_px + 2.0 * circle_px(condition, diameter_px, period) + 40.0;
    (side / 16.0).ceil() as usize * 16
}

/// Radius of the circle.
fn circle_px(condition: &Condition, diameter_px: f64, period: usize) -> f64 {
    let px_per_m = diameter_px / Kind::robot().outer_diameter_m;
    let step_px =
        condition.camera.speed_m_s.map_or(1.0, |speed_m_s| speed_m_s / RATE_HZ * px_per_m);
    step_px * period as f64 / TAU
}

/// A roundel's motion, and all that was drawn about its print and camera.
pub struct Sequence {
    /// The window.
    pub camera: Pinhole,
    pub kind: Kind,
    condition: Condition,
    marker: Marker,
    place: Place,
    print: Print,
    /// The print without dirt.
    clean: Print,
    motion: Motion,
    imaging: Imaging,
    edge: Edge,
    /// Relative error of the focal length that core knows.
    focal_error: f64,
    renderer: Renderer,
    seed: u64,
}

struct Motion {
    central: Isometry3<f64>,
    radius_m: f64,
    /// Amplitude of the rotation.
    turn_rad: Vector3<f64>,
    phase_rad: f64,
    period_s: f64,
}

impl Motion {
    fn at(&self, time_s: f64) -> Isometry3<f64> {
        let angle = self.phase_rad + TAU * time_s / self.period_s;
        let aside = Vector3::new(angle.cos(), angle.sin(), 0.5 * angle.sin()) * self.radius_m;
        let turn = UnitQuaternion::from_scaled_axis(self.turn_rad * (angle + 1.0).sin());
        let translation = Translation3::from(self.central.translation.vector + aside);
        Isometry3::from_parts(translation, turn * self.central.rotation)
    }
}

/// A shadow's edge.
struct Edge {
    loss: f64,
    heading_rad: f64,
    phase_rad: f64,
}

impl Sequence {
    /// Draws the same pose for the same `seed` under all conditions. `central` is the middle of its motion.
    pub fn new(
        condition: &Condition,
        marker: Marker,
        central: Isometry3<f64>,
        place: Place,
        seed: u64,
    ) -> Self {
        let mut random = Random::new(seed, 1);
        let diameter_px =
            place.whole.focal_px[0] * Kind::robot().outer_diameter_m / central.translation.vector.z;
        let (kind, design) = design(marker, condition.print.margin, &mut random);
        let motion = motion(condition, central, &place, &mut random);
        let edge = Edge {
            loss: drawn(condition.light.shadow.unwrap_or_default(), &mut random),
            heading_rad: random.uniform(0.0, TAU),
            phase_rad: random.uniform(0.0, TAU),
        };
        let clean = printed(condition, &design, diameter_px, &mut random);
        let print = if condition.print.is_dirty {
            dirty(&clean, kind.outer_diameter_m, condition.print.margin, &mut random)
        } else {
            clean.clone()
        };
        let [left, top] = place.corner_px;
        let [u, v] = place.whole.center_px;
        let (width, height) = (place.side_px, place.side_px);
        let camera = Pinhole { width, height, center_px: [u - left, v - top], ..place.whole };
        let imaging = imaging(condition, &camera, &place.whole, &central, diameter_px, &mut random);
        let focal_error = drawn(condition.camera.focal_error, &mut random);
        Self {
            camera,
            kind,
            condition: *condition,
            marker,
            place,
            print,
            clean,
            motion,
            imaging,
            edge,
            focal_error,
            renderer: Renderer::new(camera, imaging),
            seed,
        }
    }

    /// The camera that core knows, for the window.
    pub fn known_camera(&self) -> Pinhole {
        Pinhole {
            focal_px: self.camera.focal_px.map(|focal_px| focal_px * (1.0 + self.focal_error)),
            ..self.camera
        }
    }

    /// camera_from_roundel at a time after the middle of the window's centre row of frame 0.
    pub fn pose(&self, time_s: f64) -> Isometry3<f64> {
        self.motion.at(time_s + self.place.row_offset * self.imaging.line_time_s)
    }

    pub fn frame(&mut self, index: usize) -> Image {
        let time_s = index as f64 / RATE_HZ;
        self.renderer.imaging.light.shadow = self.shadow(index);
        let motion = |offset_s: f64| self.pose(time_s + offset_s);
        let moving = [MovingPrint { print: &self.print, motion: &motion }];
        let floor = Canvas::flat(self.camera.width, self.camera.height, FLOOR);
        self.renderer.frame(
            &floor,
            &moving,
            &mut Random::new(self.seed, FIRST_NOISE + index as u64),
        )
    }

    fn shadow(&self, index: usize) -> Option<Shadow> {
        self.condition.light.shadow?;
        let center =
            self.camera.project(&self.pose(index as f64 / RATE_HZ).translation.vector.into())?;
        let radius_px = 0.5 * self.kind.outer_diameter_m * self.camera.focal_px[0]
            / self.motion.central.translation.vector.z;
        let angle = self.edge.phase_rad + TAU * index as f64 / self.place.period as f64;
        let across = Vector2::new(-self.edge.heading_rad.sin(), self.edge.heading_rad.cos());
        let through = center + across * (SHADOW_SWEEP * radius_px * angle.cos());
        let area = HalfPlane { through_px: through.into(), heading_rad: self.edge.heading_rad };
        Some(Shadow { area, loss: self.edge.loss })
    }

    /// The bound of a frame's pixels in even light.
    pub fn bound(&self, index: usize) -> Option<Bound> {
        let Processing { photon_noise, .. } = self.imaging.processing;
        let middle = 0.5 * (self.imaging.black + self.imaging.white);
        let noise = (self.imaging.noise.powi(2) + photon_noise * middle).sqrt();
        let imaging = Imaging {
            noise,
            line_time_s: 0.0,
            light: Light::default(),
            processing: Processing::default(),
            ..self.imaging
        };
        let pose = self.pose(index as f64 / RATE_HZ);
        let scene =
            Scene { camera: self.camera, imaging, print: &self.clean, pose, motion_px: [0.0; 2] };
        let yaw = self.marker == Marker::Coded;
        bound(&scene, Unknowns { yaw, ..Unknowns::default() })
    }
}

fn drawn((low, high): (f64, f64), random: &mut Random) -> f64 {
    random.uniform(low, high)
}

fn design(marker: Marker, margin: f64, random: &mut Random) -> (Kind, Print) {
    let words = words(CODE_BITS);
    let word = words[(random.next_u64() % words.len() as u64) as usize];
    match marker {
        Marker::Plain => {
            let kind = Kind::robot();
            let print = Print::plain(kind.outer_diameter_m, kind.inner_diameter_m, margin);
            (kind, print)
        }
        Marker::Coded => {
            let kind = Kind::coded(CODE_BITS);
            let print = coded_print(kind.outer_diameter_m, CODE_BITS, word, margin);
            (kind, print)
        }
    }
}

fn printed(condition: &Condition, design: &Print, diameter_px: f64, random: &mut Random) -> Print {
    let faults = condition.print;
    let m_per_px = Kind::robot().outer_diameter_m / diameter_px;
    let printing = Printing {
        scale: drawn(faults.scale, random),
        ratio: drawn(faults.ratio, random),
        spread_m: 1e-3 * drawn(faults.spread_mm, random) - faults.bloom_px * m_per_px,
    };
    let axis_rad = random.uniform(0.0, TAU);
    let side = random.uniform(-1.0, 1.0).signum();
    let bend = faults.bend_m.map(|radius_m| Bend { radius_m: side * radius_m, axis_rad });
    Print { bend, ..design.as_printed(&printing) }
}

/// The print with dark blotches in its margin, one in each of some sectors, of 1 % to 3 % of the outer diameter.
fn dirty(print: &Print, outer_m: f64, margin: f64, random: &mut Random) -> Print {
    const BLOTCHES: usize = 7;
    const CORNERS: usize = 12;
    let mut dirty = print.clone();
    for sector in 0..BLOTCHES {
        let radius_m = outer_m * random.uniform(0.01, 0.03);
        let (near, far) =
            (0.5 * outer_m + 1.2 * radius_m, outer_m * (0.5 + margin) - 1.2 * radius_m);
        let away_m = random.uniform(near, far);
        let angle = (sector as f64 + random.uniform(0.2, 0.8)) / BLOTCHES as f64 * TAU;
        let corner = |i: usize| {
            let at = angle + TAU * i as f64 / CORNERS as f64;
            [away_m * angle.cos() + radius_m * at.cos(), away_m * angle.sin() + radius_m * at.sin()]
        };
        let outline = Outline::Polygon((0..CORNERS).map(corner).collect());
        dirty.inks.push(Ink { outline, white: false });
    }
    dirty
}

fn motion(
    condition: &Condition,
    central: Isometry3<f64>,
    place: &Place,
    random: &mut Random,
) -> Motion {
    let z = central.translation.vector.z;
    let diameter_px = place.whole.focal_px[0] * Kind::robot().outer_diameter_m / z;
    let axis = random.uniform(0.0, TAU);
    let normal = central.rotation * Vector3::z();
    let turn_rad = if condition.tilt_deg.1 == 0.0 {
        normal
    } else {
        Vector3::new(axis.cos(), axis.sin(), 0.5)
    };
    Motion {
        central,
        radius_m: circle_px(condition, diameter_px, place.period) * z / place.whole.focal_px[0],
        turn_rad: turn_rad * TURN_RAD,
        phase_rad: random.uniform(0.0, TAU),
        period_s: place.period as f64 / RATE_HZ,
    }
}

/// Image formation without the shadow, which moves.
fn imaging(
    condition: &Condition,
    camera: &Pinhole,
    whole: &Pinhole,
    central: &Isometry3<f64>,
    diameter_px: f64,
    random: &mut Random,
) -> Imaging {
    let center = camera.project(&central.translation.vector.into()).expect("a place in the image");
    let heading_rad = random.uniform(0.0, TAU);
    let beside = 0.4 * diameter_px * random.uniform(0.5, 1.0);
    let spot = center + Vector2::new(heading_rad.cos(), heading_rad.sin()) * beside;
    let ramp = condition.light.lamp.map(|lamp| match lamp {
        Lamp::AcrossRing => Ramp { center_px: center.into(), heading_rad, length_px: diameter_px },
        Lamp::AcrossImage => {
            Ramp { center_px: camera.center_px, heading_rad, length_px: whole.width as f64 }
        }
    });
    let glare = Glare { center_px: spot.into(), radius_px: 0.3 * diameter_px, peak: 80.0 };
    let vignetting = Vignetting { center_px: camera.center_px, focal_px: camera.focal_px[0] };
    let faults = condition.camera;
    let [black, white] = condition.light.levels;
    Imaging {
        blur_px: drawn(faults.blur_px, random),
        black,
        white,
        exposure_s: faults.exposure_s,
        line_time_s: faults.line_time_s,
        light: Light {
            shadow: None,
            ramp,
            glare: condition.light.has_glare.then_some(glare),
            vignetting: faults.has_vignetting.then_some(vignetting),
        },
        processing: faults.processing,
        ..Imaging::default()
    }
}
