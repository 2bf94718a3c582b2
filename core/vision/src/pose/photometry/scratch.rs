//! Working memory of the fit.

use fearless_simd::Level;

use super::{model::scratch::ModelScratch, robust::RobustScratch};
use crate::frame::Frame;

/// Working memory of fits, reused from fit to fit. The first fit reserves memory for rings as large
/// as the frame, so that later ones allocate nothing (`tests/allocation.rs`).
#[derive(Clone, Debug)]
pub struct FitScratch {
    pub(super) model: ModelScratch,
    pub(super) robust: RobustScratch,
    /// Width and height of the frames that memory is reserved for.
    size: [usize; 2],
}

impl Default for FitScratch {
    fn default() -> Self {
        Self::with_level(Level::new())
    }
}

/// Margin of the window around a ring as large as the frame.
const MARGIN_PX: usize = 64;

impl FitScratch {
    pub(super) fn with_level(level: Level) -> Self {
        Self { model: ModelScratch::new(level), robust: RobustScratch::default(), size: [0; 2] }
    }

    /// Reserves memory for any ring in the frame; pages that no ring uses are not touched.
    pub(super) fn reserve(&mut self, frame: &Frame) {
        let size = [frame.width(), frame.height()];
        if self.size == size {
            return;
        }
        self.size = size;
        let [columns, rows] = size.map(|side| side + MARGIN_PX);
        self.model.window.reserve(columns, rows);
        self.robust.reserve(columns * rows);
    }
}
