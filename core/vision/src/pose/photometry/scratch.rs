//! Memory of the fit.

use fearless_simd::Level;

use super::{
    model::{
        blur_kernel::Kernels, column_products::ProductSums, contour::Contours,
        local_lens::SamplingPlan, projection::Nodes, window::Window,
    },
    robust::RobustScratch,
};
use crate::frame::Frame;

/// Memory of the fit, to be used again and again: from the first fit on there is room for rings as large as
/// the frame, so that none is taken later (`tests/allocation.rs`).
#[derive(Clone, Debug)]
pub struct FitScratch {
    pub(super) level: Level,
    /// Of the frames that there is room for.
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

/// By so many pixels the window of a ring as large as the frame may be wider than the frame.
const MARGIN_PX: usize = 64;

impl FitScratch {
    /// Room for what a frame can show. Memory that no ring comes to use is asked for, but not touched.
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
