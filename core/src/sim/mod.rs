//! Simulated scenarios, rendered to pixels.
