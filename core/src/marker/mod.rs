//! Rings found in a frame, and followed from frame to frame.

use crate::{
    ellipse::Ellipse,
    id::{KindId, TrackNumber},
};

/// The print: a plain roundel's diameters. Kinds are told apart by their ratio (paper, section 3.4).
#[derive(Clone, Debug, PartialEq)]
pub struct Kind {
    /// Name in the configuration.
    pub name: String,
    /// Black ring's outer diameter, metres.
    pub outer_diameter_m: f64,
    /// White disc's diameter, metres, below the outer one.
    pub inner_diameter_m: f64,
}

/// One roundel as imaged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ring {
    /// Black ring's outer rim.
    pub outer: Ellipse,
    /// White disc's rim.
    pub inner: Ellipse,
    /// The kind whose ratio of diameters it has; `None` if no kinds are configured.
    pub kind: Option<KindId>,
    /// Grey level that parted black from white; the next frame's start.
    pub threshold: u8,
    /// Mean grey level of the black ring.
    pub black: f64,
    /// Mean grey level of the white disc.
    pub white: f64,
}

/// A ring with the number of the track that it continues or begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackedRing {
    /// This tracker's number for the roundel.
    pub track: TrackNumber,
    /// Where it is now.
    pub ring: Ring,
}
