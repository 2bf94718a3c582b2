//! The least-squares problem of one ring, and its solution by Gauss-Newton steps.

pub mod cholesky;
pub mod gauss_newton;
pub mod linearize;
pub mod mirror;
pub mod normal_equation_cache;
pub mod normal_equations;
pub mod solution;
pub mod state;
