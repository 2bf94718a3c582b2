//! The teeth of a coded roundel as they are painted: each the wedge between two half planes.

use roundel_vision::marker::{CodeLayout, Tooth};

/// Teeth of the longest code.
const MOST: usize = CodeLayout::BITS.1 as usize;

/// Teeth between the rim of the white disc and its core.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Teeth {
    pub inner_radius_m: f32,
    pub core_radius_m: f32,
    /// Cosine and sine of the angles where a tooth begins and where it ends.
    edges: [[f32; 4]; MOST],
    count: usize,
}

impl Teeth {
    /// Of a word; `inner_radius_m` is the white disc's between the teeth.
    pub fn new(layout: CodeLayout, word: u16, inner_radius_m: f32) -> Self {
        let mut edges = [[0.0; 4]; MOST];
        let teeth = layout.teeth(word);
        for (edge, Tooth { from_rad, to_rad }) in edges.iter_mut().zip(&teeth) {
            let (from, to) = (from_rad.sin_cos(), to_rad.sin_cos());
            *edge = [from.1, from.0, to.1, to.0].map(|number| number as f32);
        }
        let core_radius_m = inner_radius_m * CodeLayout::CORE_SHARE as f32;
        Self { inner_radius_m, core_radius_m, edges, count: teeth.len() }
    }

    /// Cosine and sine of the angles where each tooth begins and where it ends.
    pub fn edges(&self) -> &[[f32; 4]] {
        &self.edges[..self.count]
    }
}
