//! Teeth of a coded roundel for painting: each is the wedge between two half planes.

use roundel_vision::marker::{CodeLayout, Tooth};

/// Maximum number of teeth.
const MAX_TEETH: usize = CodeLayout::BITS.1 as usize;

/// Teeth between the rim of the white disc and its core.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Teeth {
    pub inner_radius_m: f32,
    pub core_radius_m: f32,
    /// Cosine and sine of the angles where a tooth begins and ends.
    edges: [[f32; 4]; MAX_TEETH],
    count: usize,
}

impl Teeth {
    /// `inner_radius_m` is the radius of the white disc between the teeth.
    pub fn new(layout: CodeLayout, word: u16, inner_radius_m: f32) -> Self {
        let mut edges = [[0.0; 4]; MAX_TEETH];
        let teeth = layout.teeth(word);
        for (edge, Tooth { from_rad, to_rad }) in edges.iter_mut().zip(&teeth) {
            let (from, to) = (from_rad.sin_cos(), to_rad.sin_cos());
            *edge = [from.1, from.0, to.1, to.0].map(|number| number as f32);
        }
        let core_radius_m = inner_radius_m * CodeLayout::CORE_SHARE as f32;
        Self { inner_radius_m, core_radius_m, edges, count: teeth.len() }
    }

    /// Cosine and sine of the angles where each tooth begins and ends.
    pub fn edges(&self) -> &[[f32; 4]] {
        &self.edges[..self.count]
    }
}
