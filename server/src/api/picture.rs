//! A camera's frame with what was found in it drawn in, as JPEG.
//!
//! Outer rims green, inner rims cyan, centres of the outer rim red, the tracks' numbers yellow on
//! black. Drawing and encoding take some milliseconds a frame, so they run off the async threads,
//! and once for all who look at the same frame.

use std::sync::Arc;

use axum::body::Bytes;
use jpeg_encoder::{ColorType, Encoder};
use roundel_core::{ellipse::Ellipse, id::CameraId, pose::Detection};
use tokio::sync::Mutex;

use super::error::ApiError;
use crate::hub::Picture;

const QUALITY: u8 = 80;
const GREEN: [u8; 3] = [40, 230, 80];
const CYAN: [u8; 3] = [30, 200, 255];
const RED: [u8; 3] = [255, 50, 50];
const YELLOW: [u8; 3] = [255, 230, 60];
const BLACK: [u8; 3] = [0, 0, 0];
/// Half the length of the cross at a centre, pixels.
const CROSS_PX: i64 = 3;
/// Edge of one dot of a digit, pixels.
const DOT_PX: i64 = 2;
/// Digits 0 to 9, five rows of three dots, the left one in the highest bit.
const DIGITS: [[u8; 5]; 10] = [
    [0b111, 0b101, 0b101, 0b101, 0b111],
    [0b010, 0b110, 0b010, 0b010, 0b111],
    [0b111, 0b001, 0b111, 0b100, 0b111],
    [0b111, 0b001, 0b111, 0b001, 0b111],
    [0b101, 0b101, 0b111, 0b001, 0b001],
    [0b111, 0b100, 0b111, 0b001, 0b111],
    [0b111, 0b100, 0b111, 0b101, 0b111],
    [0b111, 0b001, 0b010, 0b010, 0b010],
    [0b111, 0b101, 0b111, 0b101, 0b111],
    [0b111, 0b101, 0b111, 0b001, 0b111],
];
const DIGIT_COLUMNS: i64 = 3;
const DIGIT_ROWS: i64 = 5;

/// The newest JPEG of each camera, so that it is made once however many look at it.
pub struct Gallery {
    newest: Vec<Mutex<Option<Encoded>>>,
}

/// A picture, and what was made of it.
struct Encoded {
    picture: Arc<Picture>,
    jpeg: Bytes,
}

impl Gallery {
    /// For so many cameras.
    pub fn new(cameras: usize) -> Self {
        Self { newest: (0..cameras).map(|_| Mutex::default()).collect() }
    }

    /// The picture of that camera as JPEG.
    pub async fn jpeg(&self, camera: CameraId, picture: Arc<Picture>) -> Result<Bytes, ApiError> {
        let Some(slot) = self.newest.get(camera.0 as usize) else {
            return Err(ApiError::Internal(format!("camera {} has no place here", camera.0)));
        };
        // Whoever comes second waits here for the first one's work, and takes it.
        let mut newest = slot.lock().await;
        if let Some(encoded) = newest.as_ref()
            && Arc::ptr_eq(&encoded.picture, &picture)
        {
            return Ok(encoded.jpeg.clone());
        }
        let drawn = picture.clone();
        let jpeg =
            tokio::task::spawn_blocking(move || encode(&drawn)).await.map_err(|error| {
                ApiError::Internal(format!("drawing the picture ended early: {error}"))
            })??;
        *newest = Some(Encoded { picture, jpeg: jpeg.clone() });
        Ok(jpeg)
    }
}

/// Draws the detections into the picture and encodes it.
pub fn encode(picture: &Picture) -> Result<Bytes, ApiError> {
    let sides = u16::try_from(picture.width).ok().zip(u16::try_from(picture.height).ok());
    let Some((width, height)) = sides.filter(|&(width, height)| width > 0 && height > 0) else {
        return Err(ApiError::Internal(format!(
            "expected a picture of 1 to 65535 pixels a side, found {} x {}",
            picture.width, picture.height
        )));
    };
    let expected = picture.width * picture.height;
    if picture.pixels.len() != expected {
        return Err(ApiError::Internal(format!(
            "expected {expected} pixels for {width} x {height}, found {}",
            picture.pixels.len()
        )));
    }
    let mut canvas = Canvas::of(picture);
    for detection in &picture.observations.detections {
        canvas.draw_detection(detection);
    }
    let mut jpeg = Vec::with_capacity(expected / 4);
    Encoder::new(&mut jpeg, QUALITY)
        .encode(&canvas.rgb, width, height, ColorType::Rgb)
        .map_err(|error| ApiError::Internal(format!("could not encode the picture: {error}")))?;
    Ok(jpeg.into())
}

/// A colour image to draw on; what lies outside is left out.
struct Canvas {
    width: i64,
    height: i64,
    rgb: Vec<u8>,
}

impl Canvas {
    fn of(picture: &Picture) -> Self {
        let rgb = picture.pixels.iter().flat_map(|&grey| [grey; 3]).collect();
        Self { width: picture.width as i64, height: picture.height as i64, rgb }
    }

    fn draw_detection(&mut self, detection: &Detection) {
        let outer = &detection.ring.outer;
        self.draw_ellipse(outer, GREEN);
        self.draw_ellipse(&detection.ring.inner, CYAN);
        let (u, v) = (nearest(outer.center.u), nearest(outer.center.v));
        for step in -CROSS_PX..=CROSS_PX {
            self.set(u.saturating_add(step), v, RED);
            self.set(u, v.saturating_add(step), RED);
        }
        let right = u.saturating_add(nearest(outer.semi_major_px)).saturating_add(2 * DOT_PX);
        self.draw_number(detection.track.0, right, v.saturating_sub(DIGIT_ROWS * DOT_PX / 2));
    }

    fn draw_ellipse(&mut self, ellipse: &Ellipse, color: [u8; 3]) {
        let (a, b) = (ellipse.semi_major_px, ellipse.semi_minor_px);
        // Rims that reach far beyond the picture are wrong, and would take long to draw.
        let is_drawable = a.is_finite() && b.is_finite() && a < (self.width + self.height) as f64;
        if !is_drawable {
            return;
        }
        let (sin, cos) = ellipse.angle_rad.sin_cos();
        // Steps of less than a pixel, for 2π a is at least the rim's length.
        let steps = (std::f64::consts::TAU * a * 1.2).ceil().max(8.0) as usize;
        for step in 0..steps {
            let (y, x) = (std::f64::consts::TAU * step as f64 / steps as f64).sin_cos();
            let u = ellipse.center.u + a * x * cos - b * y * sin;
            let v = ellipse.center.v + a * x * sin + b * y * cos;
            self.set(nearest(u), nearest(v), color);
        }
    }

    /// Writes a number with its top left corner there, on a black ground with a margin of one dot.
    fn draw_number(&mut self, number: u64, left: i64, top: i64) {
        let digits = number.to_string().into_bytes();
        let columns = digits.len() as i64 * (DIGIT_COLUMNS + 1) - 1;
        self.fill_dots(left, top, (-1..=columns, -1..=DIGIT_ROWS), BLACK);
        for (place, digit) in (0..).zip(digits) {
            let rows = DIGITS[usize::from(digit - b'0')];
            for (row, dots) in (0..).zip(rows) {
                for column in 0..DIGIT_COLUMNS {
                    if dots >> (DIGIT_COLUMNS - 1 - column) & 1 == 1 {
                        let column = place * (DIGIT_COLUMNS + 1) + column;
                        self.fill_dots(left, top, (column..=column, row..=row), YELLOW);
                    }
                }
            }
        }
    }

    fn fill_dots(
        &mut self,
        left: i64,
        top: i64,
        (columns, rows): (std::ops::RangeInclusive<i64>, std::ops::RangeInclusive<i64>),
        color: [u8; 3],
    ) {
        for v in rows.start() * DOT_PX..(rows.end() + 1) * DOT_PX {
            for u in columns.start() * DOT_PX..(columns.end() + 1) * DOT_PX {
                self.set(left.saturating_add(u), top.saturating_add(v), color);
            }
        }
    }

    fn set(&mut self, u: i64, v: i64, color: [u8; 3]) {
        if (0..self.width).contains(&u) && (0..self.height).contains(&v) {
            let place = 3 * (v * self.width + u) as usize;
            self.rgb[place..place + 3].copy_from_slice(&color);
        }
    }
}

/// The pixel that a coordinate lies in; NaN counts as 0, and what is too far as very far.
fn nearest(coordinate_px: f64) -> i64 {
    coordinate_px.round() as i64
}
