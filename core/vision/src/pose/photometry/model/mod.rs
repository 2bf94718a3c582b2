//! The image of a roundel, and its derivatives by the unknowns.
//!
//! Contour nodes of the print ([`contour`], [`teeth`]) are projected into a window of the frame
//! ([`projection`], [`local_lens`]), and their blurred contributions summed to the image
//! ([`blur_kernel`], [`scatter`], [`window`]). Differences of the image ([`differences`]) give the
//! columns of the linear problem ([`columns`]), whose products are summed over the pixels
//! ([`column_products`], [`residual_patches`]). Motion within the exposure: [`motion`].

pub mod blur_kernel;
pub mod column_products;
pub mod columns;
pub mod contour;
pub mod differences;
pub mod local_lens;
pub mod motion;
pub mod projection;
pub mod residual_patches;
pub mod scatter;
pub mod teeth;
pub mod window;

use fearless_simd::Level;

use blur_kernel::Kernels;
use column_products::ProductSums;
use contour::Contours;
use local_lens::SamplingPlan;
use projection::Nodes;
use window::Window;

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
    /// Work of all linearizations so far, see [`super::FitScratch::work`].
    pub work: u64,
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
            work: 0,
        }
    }
}
