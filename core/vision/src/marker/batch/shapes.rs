//! Levels and weighed rims from the sums, one ring per lane.

use crate::{
    camera::PixelPoint,
    ellipse::{Ellipse, Symmetric2, semiaxes_px},
    marker::{
        batch::table::{Row, Table},
        ring::{
            pixels::edge_band::WIDE_PX,
            subpixel::{
                blur::{Cuts, LevelSample, RimSpread, rim_radius_px},
                levels::{MARGIN_DEVIATION, MARGIN_FALL, Slope},
            },
        },
    },
    simd::Lane,
};
/// An ellipse per lane.
#[derive(Clone, Copy)]
pub(super) struct LaneEllipse<T> {
    pub u: T,
    pub v: T,
    pub a: T,
    pub b: T,
    pub angle_rad: T,
    /// Cosine and sine of twice the angle.
    pub along: (T, T),
}

impl<T: Lane> LaneEllipse<T> {
    #[inline(always)]
    pub fn at(&self, lane: usize) -> Ellipse {
        Ellipse {
            center: PixelPoint { u: self.u.lane(lane), v: self.v.lane(lane) },
            semi_major_px: self.a.lane(lane),
            semi_minor_px: self.b.lane(lane),
            angle_rad: self.angle_rad.lane(lane),
        }
    }

    /// [`Ellipse::matrix`].
    #[inline(always)]
    pub fn matrix_at(&self, lane: usize) -> Symmetric2 {
        let (a, b) = (self.a.lane(lane), self.b.lane(lane));
        let (mean, half) = (0.5 * (a * a + b * b), 0.5 * (a * a - b * b));
        let (cos, sin) = (self.along.0.lane(lane), self.along.1.lane(lane));
        Symmetric2 { uu: mean + half * cos, uv: half * sin, vv: mean - half * cos }
    }

    /// As [`Ellipse::grown`].
    #[inline(always)]
    pub fn grown(&self, by_px: T) -> Self {
        let min = by_px.splat(0.01);
        Self { a: (self.a + by_px).larger(min), b: (self.b + by_px).larger(min), ..*self }
    }
}

/// A weighed rim; see [`crate::ellipse::Shape`].
pub(super) struct Shape<T: Lane> {
    pub area_px2: T,
    /// Pixels of its band.
    pub band: T,
    covariance: [T; 3],
    pub rim: LaneEllipse<T>,
    /// [`Ellipse::matrix`].
    pub matrix: [T; 3],
    pub valid: T::Mask,
}

/// Grey levels of the parts.
pub(super) struct Levels<T: Lane> {
    pub black: LevelSample<T>,
    pub white: LevelSample<T>,
    pub margin: LevelSample<T>,
    pub slopes: (Slope<T>, Slope<T>),
    pub valid: T::Mask,
}

/// A row of the table.
#[inline(always)]
pub(super) fn read<T: Lane>(zero: T, table: &Table, row: Row, after: usize) -> T {
    let row = table.row(row, after);
    let [value] = zero.each(
        #[inline(always)]
        |lane| [row[lane]],
    );
    value
}

/// Sum and number of a set of pixels, or of its left or upper half.
struct Half<T> {
    sum: T,
    pixels: T,
}

impl<T: Lane> Half<T> {
    #[inline(always)]
    fn of(zero: T, table: &Table, (sum, pixels): (Row, Row)) -> Self {
        Self { sum: read(zero, table, sum, 0), pixels: read(zero, table, pixels, 0) }
    }

    #[inline(always)]
    fn mean(&self) -> T {
        self.sum / self.pixels
    }

    /// Mean of the rest minus that of `half`.
    #[inline(always)]
    fn slope(&self, half: &Self) -> T {
        (self.sum - half.sum) / (self.pixels - half.pixels) - half.mean()
    }
}

impl<T: Lane> Levels<T> {
    /// As [`crate::marker::ring::subpixel::levels::Levels`].
    #[inline(always)]
    pub fn of(zero: T, table: &Table) -> Self {
        let disc_pixels = read(zero, table, Row::Ellipses, 0);
        let black_pixels =
            read(zero, table, Row::Ellipses, 12) - read(zero, table, Row::Ellipses, 6);
        let disc_size = read(zero, table, Row::Disc, 0);
        let of_black = read(zero, table, Row::Black, 0);
        let (white, black) = (disc_size / disc_pixels, of_black / black_pixels);
        let contrast = white - black;
        let near = Half::of(zero, table, (Row::Near, Row::NearPixels));
        let far = Half::of(zero, table, (Row::Far, Row::FarPixels));
        let far_mean = far.mean();
        let square = read(zero, table, Row::FarSquare, 0);
        let variance = square / far.pixels - far_mean * far_mean;
        let (share, levels) = MARGIN_DEVIATION;
        let limit = (contrast * share).squared() + levels * levels;
        let fall = near.mean() - far_mean;
        let falls = (contrast * MARGIN_FALL.0 + MARGIN_FALL.1).below(fall);
        let both = Half { sum: near.sum + far.sum, pixels: near.pixels + far.pixels };
        let is_near = fall.is_positive();
        let margin = LevelSample {
            level: T::choose(is_near, near.mean(), both.mean()),
            pixels: T::choose(is_near, near.pixels, both.pixels),
            distance_px: WIDE_PX,
        };
        let whole = Half { sum: of_black, pixels: black_pixels };
        let left = Half::of(zero, table, (Row::BlackLeft, Row::BlackLeftPixels));
        let top = Half::of(zero, table, (Row::BlackTop, Row::BlackTopPixels));
        let of_black = (whole.slope(&left), whole.slope(&top));
        let left = Half::of(zero, table, (Row::MarginLeft, Row::MarginLeftPixels));
        let top = Half::of(zero, table, (Row::MarginTop, Row::MarginTopPixels));
        let of_margin = (both.slope(&left), both.slope(&top));
        Self {
            black: LevelSample { level: black, pixels: black_pixels, distance_px: WIDE_PX },
            white: LevelSample { level: white, pixels: disc_pixels, distance_px: WIDE_PX },
            margin,
            slopes: (of_black, of_margin),
            valid: variance.at_most(limit) & !falls,
        }
    }
}

/// Six rows of the table.
#[inline(always)]
fn read_six<T: Lane>(zero: T, table: &Table, row: Row, after: usize) -> [T; 6] {
    let mut six = [zero; 6];
    for (k, to) in six.iter_mut().enumerate() {
        *to = read(zero, table, row, after + k);
    }
    six
}

/// Sums of 1, v, v², u, uv, u² over an ellipse's pixels.
#[inline(always)]
fn sizes<T: Lane>(zero: T, table: &Table, ellipse: usize) -> [T; 6] {
    let [n, nv, nvv, nm, nmv, squares] = read_six(zero, table, Row::Ellipses, 6 * ellipse);
    [n, nv, nvv, nm * 0.5, nmv * 0.5, squares * (1.0 / 12.0)]
}

/// Where the sums of a rim are.
pub(super) struct RimRows {
    pub band: Row,
    pub reach: Row,
    /// The ellipses that bound its core and its band.
    pub ellipses: (usize, usize),
}

impl<T: Lane> Shape<T> {
    /// With weight 0 at the first level and 1 at the second.
    #[inline(always)]
    pub fn of(table: &Table, place: &RimRows, (from, to): (T, T)) -> Self {
        let gain = (to - from).under(1.0);
        let offset = -(gain * from);
        let reach = read(gain, table, place.reach, 0);
        // From rows counted from the last one to rows counted from the middle.
        let [n, t, tt, nu, tu, uu] = read_six(gain, table, place.band, 0);
        let vv = reach * reach * n - reach * t * 2.0 + tt * 2.0 - t;
        let grey = [n, reach * n - t, vv, nu, reach * nu - tu, uu];
        let core = sizes(gain, table, place.ellipses.0);
        let both = sizes(gain, table, place.ellipses.1);
        let mut sums = core;
        for (k, sum) in sums.iter_mut().enumerate() {
            *sum = grey[k] * gain + (both[k] - core[k]) * offset + core[k];
        }
        let [n, nv, nvv, nu, nuv, nuu] = sums;
        let area_px2 = n;
        let per = area_px2.under(1.0);
        let (u, v) = (nu * per, nv * per);
        let (uu, uv, vv) = (nuu * per - u * u, nuv * per - u * v, nvv * per - v * v);
        let valid = area_px2.is_positive() & uu.is_positive() & (uu * vv - uv * uv).is_positive();
        let (x, y) = ((uu - vv) * 0.5, uv);
        let radius = (x * x + y * y).root();
        let [a, b] = semiaxes_px(area_px2, radius * 2.0);
        let is_long = radius.is_positive();
        let along = (
            T::choose(is_long, x / radius, radius.splat(1.0)),
            T::choose(is_long, y / radius, radius.splat(0.0)),
        );
        let turned = y.angle_from(x) * 0.5;
        let quarter = std::f64::consts::FRAC_PI_2;
        let is_back = turned.at_most(turned.splat(-quarter));
        let rim = LaneEllipse {
            u: read(gain, table, Row::MiddleU, 0) + u,
            v: read(gain, table, Row::MiddleV, 0) + v,
            a,
            b,
            angle_rad: T::choose(is_back, turned.splat(quarter), turned),
            along,
        };
        let mean = (a * a + b * b) * 0.5;
        let half = (uu - vv) * 2.0;
        let matrix = [mean + half, uv * 4.0, mean - half];
        Self { area_px2, band: both[0] - core[0], covariance: [uu, uv, vv], rim, matrix, valid }
    }

    /// The quantities that determine its blur.
    #[inline(always)]
    pub fn spread(&self) -> RimSpread<T> {
        let (a, b) = (self.rim.a, self.rim.b);
        let [uu, _, vv] = self.covariance;
        let cuts = Cuts { inside_px: WIDE_PX, outside_px: WIDE_PX };
        let spread_px2 = (uu + vv) * 0.5 - (a * a + b * b) * 0.125;
        RimSpread { radius_px: rim_radius_px(a, b), spread_px2, cuts }
    }
}
