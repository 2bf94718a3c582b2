//! How much of a camera's image roundels were seen in.

use roundel_vision::camera::{Camera, PixelPoint};

/// Fields of an image, across and down.
const FIELDS: (usize, usize) = (8, 6);

/// The fields of an image in which roundels were seen.
#[derive(Clone, Debug)]
pub struct Coverage([bool; FIELDS.0 * FIELDS.1]);

impl Coverage {
    /// Something was seen there; what lies outside counts to the nearest field.
    pub fn add(&mut self, lens: &Camera, at: PixelPoint) {
        let field = |value: f64, size: usize, count: usize| {
            ((value / size as f64 * count as f64).max(0.0) as usize).min(count - 1)
        };
        let column = field(at.u, lens.width(), FIELDS.0);
        self.0[field(at.v, lens.height(), FIELDS.1) * FIELDS.0 + column] = true;
    }

    /// Of all fields, 0 to 1.
    pub fn share(&self) -> f64 {
        self.0.iter().filter(|&&is_seen| is_seen).count() as f64 / self.0.len() as f64
    }
}

impl Default for Coverage {
    fn default() -> Self {
        Self([false; FIELDS.0 * FIELDS.1])
    }
}
