//! Both rims of a ring: their errors, and their images in a plane in front of the camera.
//!
//! In: the ellipses of a ring in the image. Out: the rims in the frame of the outer rim's cone,
//! with information.
//!
//! [`noise`] gives the errors of rims as detected, [`information`] those of an ellipse's five
//! harmonics. [`rim_pair`] arranges one ring, or several, for vectors. [`projection`] takes rims
//! through the lens, by [`lens_series`] where distortion is small and else by [`lens_iteration`].

pub mod information;
pub mod lens_iteration;
pub mod lens_series;
pub mod noise;
pub mod plane_ellipse;
pub mod projection;
pub mod rim_pair;
