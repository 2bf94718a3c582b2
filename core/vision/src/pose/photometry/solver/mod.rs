//! The least-squares problem of one ring, and its solution.
//!
//! [`linearize`] turns a [`state`] into [`normal_equations`], reusing those of a state nearby where
//! possible. [`gauss_newton`] steps to the minimum with [`cholesky`]. [`mirror`] estimates the
//! mirrored pose from the same equations. [`solution`] gives covariance and rims.

pub mod cholesky;
pub mod gauss_newton;
pub mod linearize;
pub mod mirror;
pub mod normal_equations;
pub mod solution;
pub mod state;
