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
pub mod scratch;
pub mod teeth;
pub mod window;
