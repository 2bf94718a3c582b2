//! One ring: its pixels, its tests, and both rims to a fraction of a pixel (paper, sections 3.1 to 3.3).
//!
//! | module | content |
//! | --- | --- |
//! | `probe` | where to measure, and the limits for a ring |
//! | `pixels` | which pixels belong to disc, ring, edge bands and margin |
//! | `checks` | sizes, boxes, concentricity, roundness, similarity, levels |
//! | `subpixel` | levels, weighed moments, removal of blur |
//! | `weighed_rim` | a rim by its weighed moments |
//! | `measure` | all steps in order |
//! | `hard_edges` | pictures without blur, softened |
//! | `shadow` | rings across the edge of a shadow: the light evened out |

pub(crate) mod checks;
pub(crate) mod hard_edges;
pub(crate) mod measure;
pub(crate) mod pixels;
pub(crate) mod probe;
pub(crate) mod shadow;
pub(crate) mod subpixel;
pub(crate) mod weighed_rim;
