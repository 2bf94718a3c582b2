//! A moving ring under a rolling shutter, whose rows are exposed one after another.
//!
//! The pose of a ring is that at the instant t₀ of one row, v₀, that of its centre. What lies in another row v
//! has moved on until then: with V the image velocity and L the time from row to row, s = L V pixels a row,
//!
//! p_obs = p + s (v_obs - v₀)      p = (I - s e_vᵀ) (p_obs - c) + c      A = I + s e_vᵀ/(1 - s_v)
//!
//! for any c in row v₀, exactly so where all of the ring moves alike. The first way brings the rims as seen, and
//! the ends of a code, to where they were at t₀ ([`Skew::seen`]), for the closed form; the other way belongs to
//! the lens, so that a fit of grey levels needs nothing else (`photometry::lens`). V is that of the ring's
//! `course` from frame to frame.
//!
//! What is not known of V widens the covariance (`stretch`). A ring that is seen for the first time may move by
//! metres a second, and its pose says so; from the second frame on little is left.
//!
//! **Accuracy** (`roundel-tests`, `tests/shutter.rs`: 30 to 60 px, 3 m/s, 12 µs a row, accelerations to 3 m/s² and
//! turns to 1 rad/s, 60 Hz; plain, coded and elliptical, both modes): from the third frame on, depths within 4 % of
//! those under a global shutter, and 94 to 98 % of the positions inside their 95 %; in the first frame, 0.5 % of
//! depth, said so by 95 to 100 % of the positions. Without it two thirds of a percent would be left for good.
//!
//! **Bends.** What turns by ω, and whose far side moves less in the image than its near one, is bent by terms of
//! second order in its size: x and y move by ω L y (−y, x). That shifts the centre by ω L r²/4, r the radius in
//! pixels, 0.003 px at 60 px and 1 rad/s. It is not modelled; what moves is thought to go round a circle of
//! [`CIRCLE_M`] metres, so that ω follows from V, and the covariance is widened by that much.
//!
//! **Limits.** Frames' times that jitter make the velocity so much less certain, once it has been seen.

mod image_velocity;
mod skew_covariance;

use nalgebra::{Matrix3, Vector2};

use crate::{
    camera::{Camera, PixelPoint},
    ellipse::{Ellipse, Symmetric2},
    marker::{CodeReading, Kind, Pattern, Ring, TrackedRing},
    pose::{RimNoise, RoundelPose, recent_tracks::RecentTracks},
    time::{Timestamp, row_time},
};
use image_velocity::{CenterMeasurement, ImageMotion};

/// No image moves by more than this share of a row while the next one is exposed.
const MAX_PX_PER_ROW: f64 = 0.2;

/// What moves goes round a circle of about this radius, metres.
const CIRCLE_M: f64 = 3.0;

/// How a ring's motion skews its image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Skew {
    /// v₀.
    pub(super) row_px: f64,
    /// s.
    pub(super) px_per_row: Vector2<f64>,
    /// Of either part of s.
    pub(super) variance: f64,
    /// How far what does not move alike shifts the centre, either way, metres.
    pub(super) bend_m: f64,
}

impl Skew {
    /// Where a point is seen that is at `pixel` when the centre's row is exposed.
    pub fn image(&self, pixel: PixelPoint) -> PixelPoint {
        let rows = (pixel.v - self.row_px) / (1.0 - self.px_per_row.y);
        let moved = self.px_per_row * rows;
        PixelPoint { u: pixel.u + moved.x, v: pixel.v + moved.y }
    }

    /// Where a point that is seen is when the centre's row is exposed.
    fn point(&self, observed: PixelPoint) -> PixelPoint {
        let moved = self.px_per_row * (observed.v - self.row_px);
        PixelPoint { u: observed.u - moved.x, v: observed.v - moved.y }
    }

    /// A ring as it is when its centre's row is exposed.
    pub fn ring(&self, observed: &Ring) -> Ring {
        Ring {
            outer: self.ellipse(&observed.outer),
            inner: self.ellipse(&observed.inner),
            code: observed.code.map(|code| self.code(&code)),
            ..*observed
        }
    }

    /// The same of a code's ends.
    pub fn code(&self, observed: &CodeReading) -> CodeReading {
        CodeReading {
            zero: self.point(observed.zero),
            opposite: self.point(observed.opposite),
            ..*observed
        }
    }

    fn ellipse(&self, observed: &Ellipse) -> Ellipse {
        let Symmetric2 { uu, uv, vv } = observed.matrix();
        // M of B A Aᵀ Bᵀ, B = I - s e_vᵀ.
        let (across, down) = (-self.px_per_row.x, 1.0 - self.px_per_row.y);
        let matrix = Symmetric2 {
            uu: uu + across * (2.0 * uv + across * vv),
            uv: down * (uv + across * vv),
            vv: down * down * vv,
        };
        let (long, short, angle_rad) = matrix.eigen();
        Ellipse {
            center: self.point(observed.center),
            semi_major_px: long.sqrt(),
            // Below the smallest there is, rounding may take it to nothing.
            semi_minor_px: short.max(0.0).sqrt(),
            angle_rad,
        }
    }

    /// Adds to a pose's covariance what is not known of the motion.
    pub fn widen(&self, pose: &mut RoundelPose, camera: &Camera, kind: &Kind) {
        skew_covariance::widen(pose, camera, kind, self.variance.sqrt());
        let sight = pose.position_m.normalize();
        let across = Matrix3::identity() - sight * sight.transpose();
        let mut position = pose.covariance.fixed_view_mut::<3, 3>(0, 0);
        position += across * (self.bend_m * self.bend_m);
    }
}

/// A camera's rolling shutter, and the courses of what it sees.
#[derive(Clone, Debug)]
pub struct Shutter {
    line_time_s: f64,
    motions: RecentTracks<ImageMotion>,
    /// Of the rings of the newest frame, in their order.
    skews: Vec<Skew>,
}

impl Shutter {
    /// Of rows that follow each other by so much.
    pub fn new(line_time_s: f64) -> Self {
        Self { line_time_s, motions: RecentTracks::new(), skews: Vec::new() }
    }

    /// Of the newest frame's rings, in their order.
    pub fn skews(&self) -> &[Skew] {
        &self.skews
    }

    /// Forgets all courses.
    pub fn reset(&mut self) {
        self.motions.clear();
    }

    /// Takes the rings of a frame of so many rows in, whose middle row was exposed at `time`; nothing is known
    /// of their motion if it is not told.
    pub fn update(
        &mut self,
        (time, height): (Option<Timestamp>, usize),
        tracked: &[TrackedRing],
        (kinds, noise): (&[Kind], &RimNoise),
    ) {
        self.skews.clear();
        for TrackedRing { track, ring, .. } in tracked {
            let kind = ring.kind.and_then(|id| kinds.get(usize::from(id.0)));
            let outer = &ring.outer;
            // Without a kind it has no size, and will have no pose.
            let diameter_m = kind.map_or(1.0, |kind| kind.outer_diameter_m);
            let is_coded = kind.is_some_and(|kind| matches!(kind.pattern, Pattern::Coded(_)));
            let observed = CenterMeasurement {
                time: row_time(time.unwrap_or_default(), outer.center.v, height, self.line_time_s),
                center: outer.center,
                variance_px2: noise.center_variance_px2(ring, is_coded),
                px_per_m: 2.0 * outer.semi_major_px / diameter_m,
            };
            let mut motion = ImageMotion::new(&observed);
            if time.is_some() {
                if let Some(before) = self.motions.of(*track) {
                    motion = *before;
                    motion.update(&observed);
                }
                self.motions.renew(*track, Some(motion));
            }
            let size = (outer.semi_major_px, 0.5 * diameter_m);
            self.skews.push(self.skew(&motion, outer.center.v, size));
        }
    }

    /// Of a ring of this radius in the image and in metres.
    fn skew(&self, motion: &ImageMotion, row_px: f64, (radius_px, radius_m): (f64, f64)) -> Skew {
        let (velocity_px_s, variance) = motion.velocity();
        let speed_m_s =
            (velocity_px_s.norm_squared() + 2.0 * variance).sqrt() * radius_m / radius_px;
        let turn_rad = self.line_time_s.abs() * speed_m_s / CIRCLE_M;
        Skew {
            row_px,
            px_per_row: (velocity_px_s * self.line_time_s).cap_magnitude(MAX_PX_PER_ROW),
            variance: (self.line_time_s.powi(2) * variance).min(MAX_PX_PER_ROW * MAX_PX_PER_ROW),
            bend_m: 0.25 * turn_rad * radius_px * radius_m,
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::marker::Code;

    pub fn skew(row_px: f64, px_per_row: [f64; 2]) -> Skew {
        Skew { row_px, px_per_row: px_per_row.into(), variance: 0.0, bend_m: 0.0 }
    }

    #[test]
    fn rims_come_back_to_where_they_were() {
        let center = PixelPoint { u: 1200.0, v: 300.0 };
        let rim = |scale: f64| Ellipse {
            center,
            semi_major_px: 20.0 * scale,
            semi_minor_px: 14.0 * scale,
            angle_rad: 0.4,
        };
        let ring = Ring::of_rims(rim(1.0), rim(0.4));
        let skew = skew(ring.outer.center.v - 3.0, [0.02, -0.03]);
        let Ellipse { center, semi_major_px, semi_minor_px, angle_rad } = ring.outer;
        let (sin, cos) = angle_rad.sin_cos();
        let points: Vec<_> = (0..32)
            .map(|i| {
                let (y, x) = (f64::from(i) * 0.2).sin_cos();
                let (a, b) = (semi_major_px * x, semi_minor_px * y);
                let at =
                    PixelPoint { u: center.u + cos * a - sin * b, v: center.v + sin * a + cos * b };
                let observed = skew.image(at);
                let back = skew.point(observed);
                assert!((back.u - at.u).hypot(back.v - at.v) < 1e-9);
                observed
            })
            .collect();
        // The rim through these is the one that is straightened to the old one.
        let long =
            PixelPoint { u: center.u + cos * semi_major_px, v: center.v + sin * semi_major_px };
        let code = CodeReading::certain(Code { bits: 8, number: 1 }, skew.image(long));
        let image = observed(&skew, &ring.outer);
        for point in &points {
            let m = image.matrix();
            let (du, dv) = (point.u - image.center.u, point.v - image.center.v);
            let square = (m.vv * du * du - 2.0 * m.uv * du * dv + m.uu * dv * dv) / m.determinant();
            assert!((square - 1.0).abs() < 1e-9, "{square}");
        }
        let observed = Ring { outer: image, inner: image, code: Some(code), ..ring };
        let found = skew.ring(&observed);
        for found in [found.outer, found.inner] {
            assert!((found.center.u - center.u).hypot(found.center.v - center.v) < 1e-9);
            assert!((found.semi_major_px - semi_major_px).abs() < 1e-9);
            assert!((found.semi_minor_px - semi_minor_px).abs() < 1e-9);
            assert!((found.angle_rad - angle_rad).sin().abs() < 1e-9);
        }
        let zero = found.code.unwrap().zero;
        assert!((zero.u - long.u).hypot(zero.v - long.v) < 1e-9);
    }

    /// An ellipse as it is seen: by the skew that takes this one back.
    pub fn observed(by: &Skew, ellipse: &Ellipse) -> Ellipse {
        let back = Skew { px_per_row: -by.px_per_row / (1.0 - by.px_per_row.y), ..*by };
        back.ellipse(ellipse)
    }
}
