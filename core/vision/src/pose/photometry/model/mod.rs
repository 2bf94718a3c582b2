//! The image that a roundel gives, and how it follows each unknown.

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
