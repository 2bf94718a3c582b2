//! Rings of one frame.
//!
//! A [`Detector`] is immutable and may be shared; memory that grows with the frame is the caller's
//! [`Scratch`]. [`Detector::detect`] searches the whole frame once; [`crate::marker::Tracker`] uses
//! the same steps in parts.

use crate::{
    ellipse::Ellipse,
    frame::Frame,
    marker::{
        Ring,
        examine::{Probe, Rules},
        kind::{Kind, RATIO_LIMITS},
        measure::{MeasureScratch, measure},
        param::{self, DetectorError, Params},
        reject::{Reject, RejectCounts},
        scan::{Candidate, Peak, ROW_STEP, cross, find_peaks, pair_of_rows},
        threshold::BinarySearch,
    },
    segment::Window,
};

/// Depth of the binary search that a promising candidate is given.
const SEARCH_DEPTH: u32 = 2;

/// Finds rings of the given kinds.
#[derive(Clone, Debug)]
pub struct Detector {
    kinds: Vec<Kind>,
    params: Params,
    rules: Rules,
}

/// Memory of detection, kept from frame to frame; nothing is allocated once it has grown.
#[derive(Debug, Default)]
pub struct Scratch {
    pub(crate) measure: MeasureScratch,
    pub(crate) line: Vec<u8>,
    pub(crate) peaks: Vec<Peak>,
    pub(crate) found: Vec<Ring>,
    pub(crate) claims: Vec<Claim>,
    pub(crate) in_row: Vec<usize>,
    pub(crate) rejects: RejectCounts,
}

impl Scratch {
    /// Candidates of the newest frame that died, by stage.
    pub fn rejects(&self) -> &RejectCounts {
        &self.rejects
    }
}

/// Pixels that belong to a roundel already found: the paper paints them over (section 3.6), which
/// would change the caller's image.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Claim {
    outer: Ellipse,
    top: f64,
    bottom: f64,
}

impl Claim {
    pub fn new(ring: &Ring) -> Self {
        let half_v = ring.outer.half_box_px().1;
        let v = ring.outer.center.v;
        Self { outer: ring.outer, top: v - half_v, bottom: v + half_v }
    }

    pub fn covers(&self, ring: &Ring) -> bool {
        self.outer.contains(ring.outer.center)
    }
}

impl Detector {
    /// A detector of these kinds; without any, every plausible ring is found and has no kind.
    pub fn new(kinds: Vec<Kind>, params: Params) -> Result<Self, DetectorError> {
        param::check(&kinds, &params)?;
        let ratios = kinds.iter().map(Kind::ratio).fold(None, |range: Option<(f64, f64)>, r| {
            Some(range.map_or((r, r), |(least, most)| (least.min(r), most.max(r))))
        });
        let rules = Rules {
            ratios: ratios.unwrap_or(RATIO_LIMITS),
            min_semi_minor_px: params.min_semi_minor_px,
            min_axis_ratio: params.min_axis_ratio,
            min_contrast: f64::from(params.min_contrast),
        };
        Ok(Self { kinds, params, rules })
    }

    /// The kinds, in the order that [`crate::id::KindId`] counts them.
    pub fn kinds(&self) -> &[Kind] {
        &self.kinds
    }

    /// The limits.
    pub fn params(&self) -> &Params {
        &self.params
    }

    /// All rings of one frame, in the order of the rows that they were found in.
    pub fn detect<'s>(&self, frame: &Frame, scratch: &'s mut Scratch) -> &'s [Ring] {
        scratch.rejects = RejectCounts::default();
        scratch.claims.clear();
        scratch.found.clear();
        self.search(frame, Window::of(frame), self.params.max_roundels, scratch);
        &scratch.found
    }

    /// Appends to `found` the rings whose disc crosses `window` and that no claim covers, and claims
    /// them, until there are `most` of them.
    pub(crate) fn search(&self, frame: &Frame, window: Window, most: usize, scratch: &mut Scratch) {
        let mut peaks = std::mem::take(&mut scratch.peaks);
        let mut line = std::mem::take(&mut scratch.line);
        for v in (window.top..window.bottom).step_by(ROW_STEP) {
            if scratch.found.len() >= most {
                break;
            }
            pair_of_rows(frame, v, &window, &mut line);
            find_peaks(&line, self.params.min_contrast, &mut peaks);
            claims_of_row(scratch, v);
            for peak in &peaks {
                let u = window.left + peak.u;
                if scratch.found.len() >= most || is_claimed(scratch, u, v) {
                    continue;
                }
                match self.try_peak(frame, (u, v), peak, scratch) {
                    Ok(ring) => {
                        scratch.in_row.push(scratch.claims.len());
                        scratch.claims.push(Claim::new(&ring));
                        scratch.found.push(ring);
                    }
                    Err(reject) => scratch.rejects.add(reject),
                }
            }
        }
        (scratch.peaks, scratch.line) = (peaks, line);
    }

    /// The ring whose disc a peak is, at the first threshold of the binary search that shows it.
    fn try_peak(
        &self,
        frame: &Frame,
        at: (usize, usize),
        peak: &Peak,
        scratch: &mut Scratch,
    ) -> Result<Ring, Reject> {
        let mut first = None;
        for threshold in BinarySearch::new(peak.black, peak.white, SEARCH_DEPTH) {
            let tried =
                cross(frame, at, threshold, self.params.min_axis_ratio).and_then(|candidate| {
                    self.measure_candidate(frame, &candidate, threshold, scratch)
                });
            match tried {
                Ok(ring) => {
                    let covered = scratch.claims.iter().any(|claim| claim.covers(&ring));
                    return if covered { Err(Reject::Claimed) } else { Ok(ring) };
                }
                // A further threshold helps only where rims were bridged.
                Err(reject)
                    if reject != Reject::BlackTooLarge && reject != Reject::WhiteTooLarge =>
                {
                    return Err(first.unwrap_or(reject));
                }
                Err(reject) => first = first.or(Some(reject)),
            }
        }
        Err(first.unwrap_or(Reject::Contrast))
    }

    fn measure_candidate(
        &self,
        frame: &Frame,
        candidate: &Candidate,
        threshold: u8,
        scratch: &mut Scratch,
    ) -> Result<Ring, Reject> {
        // An ellipse's box is up to (1/k + k)/2 times its central chords, k the axes' ratio.
        let k = self.params.min_axis_ratio;
        let scale = 0.5 * (1.0 / k + k);
        let half = candidate.half_chords_px;
        let center = (candidate.center.0 as f64, candidate.center.1 as f64);
        let probe = Probe {
            center: candidate.center,
            black: candidate.black,
            threshold,
            bounds: Window::around(frame, center, (half.0 * scale + 3.0, half.1 * scale + 3.0)),
        };
        self.measure(frame, &probe, &mut scratch.measure)
    }

    /// The ring at a probe.
    pub(crate) fn measure(
        &self,
        frame: &Frame,
        probe: &Probe,
        scratch: &mut MeasureScratch,
    ) -> Result<Ring, Reject> {
        measure(frame, probe, &self.rules, &self.kinds, scratch)
    }
}

/// Lists the claims that row `v` crosses.
fn claims_of_row(scratch: &mut Scratch, v: usize) {
    let v = v as f64;
    scratch.in_row.clear();
    let crossing = scratch.claims.iter().enumerate();
    let crossing = crossing.filter(|(_, claim)| claim.top <= v && v <= claim.bottom);
    scratch.in_row.extend(crossing.map(|(index, _)| index));
}

fn is_claimed(scratch: &Scratch, u: usize, v: usize) -> bool {
    let point = crate::camera::PixelPoint { u: u as f64, v: v as f64 };
    scratch.in_row.iter().any(|&index| scratch.claims[index].outer.contains(point))
}
