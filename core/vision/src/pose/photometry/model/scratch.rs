//! Working memory of linearizations.

use fearless_simd::Level;

use super::{
    blur_kernel::Kernels, column_products::ProductSums, contour::Contours,
    local_lens::SamplingPlan, projection::Nodes, window::Window,
};

/// Tables, contours and images that linearizations reuse.
#[derive(Clone, Debug)]
pub struct ModelScratch {
    pub level: Level,
    pub plan: SamplingPlan,
    pub kernels: Kernels,
    pub contours: Contours,
    pub nodes: Nodes,
    pub window: Window,
    pub sums: ProductSums,
}

impl ModelScratch {
    pub fn new(level: Level) -> Self {
        Self {
            level,
            plan: SamplingPlan::default(),
            kernels: Kernels::default(),
            contours: Contours::default(),
            nodes: Nodes::default(),
            window: Window::default(),
            sums: ProductSums::default(),
        }
    }
}
