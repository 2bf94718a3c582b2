//! Working memory of the fit.

use fearless_simd::Level;

use super::{
    model::{
        blur_kernel::Kernels, column_products::ProductSums, contour::Contours,
        local_lens::SamplingPlan, projection::Nodes, window::Window,
    },
    robust::RobustScratch,
};
use crate::frame::Frame;

/// Working memory of fits, reused from fit to fit. The first fit reserves memory for rings as large
/// as the frame, so that later ones allocate nothing (`tests/allocation.rs`).
#[derive(Clone, Debug)]
pub struct FitScratch {
    pub(super) level: Level,
    /// Frame size that memory is reserved for.
    pub(super) size: (usize, usize),
    pub(super) plan: SamplingPlan,
    pub(super) kernels: Kernels,
    pub(super) contours: Contours,
    pub(super) nodes: Nodes,
    pub(super) window: Window,
    pub(super) sums: ProductSums,
    pub(super) robust: RobustScratch,
}

impl Default for FitScratch {
    fn default() -> Self {
        Self {
            level: Level::new(),
            size: (0, 0),
            plan: SamplingPlan::default(),
            kernels: Kernels::default(),
            contours: Contours::default(),
            nodes: Nodes::default(),
            window: Window::default(),
            sums: ProductSums::default(),
            robust: RobustScratch::default(),
        }
    }
}

/// Margin of the window around a ring as large as the frame.
const MARGIN_PX: usize = 64;

impl FitScratch {
    /// Reserves memory for any ring in the frame; pages that no ring uses are not touched.
    pub(super) fn make_room(&mut self, frame: &Frame) {
        let size = (frame.width(), frame.height());
        if self.size == size {
            return;
        }
        self.size = size;
        let (columns, rows) = (size.0 + MARGIN_PX, size.1 + MARGIN_PX);
        self.window.make_room((columns, rows));
        self.robust.make_room(columns * rows);
    }
}
