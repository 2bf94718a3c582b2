//! Detection of all rings in one frame.
//!
//! A [`Detector`] is immutable and can be shared; the caller owns the [`Scratch`], whose memory grows with the frame.
//! [`Detector::detect`] searches the whole frame once; [`crate::marker::Tracker`] uses the same steps on parts of it.

use fearless_simd::Level;

use crate::{
    camera::PixelPoint,
    frame::{Frame, Window},
    id::KindId,
    marker::{
        Ring,
        batch::{self, BATCH_SIZE, BatchScratch},
        coded::{
            measure::{self as coded, CodedKind},
            reader::CodeReader,
        },
        kind::{Kind, Pattern, Polarity, RATIO_LIMITS},
        mask::Mask,
        params::{self, DetectorError, Params},
        reject::{Reject, RejectCounts, Rejected, Rejects},
        ring::{
            checks::MAX_SPREAD_PX2,
            hard_edges::{SOFTENING_PX2, are_hard, soften},
            measure::{MeasureScratch, UNEVEN, measure, own_threshold},
            probe::{Probe, Rules},
            shadow::{LightSample, MAX_SAMPLES, find_edge},
        },
        search::{
            SearchRules, SearchScratch,
            claim::Claim,
            cross::{Candidate, cross},
            hits::{Hit, find_hits},
            row_edges::ROW_STEP,
            threshold::BinarySearch,
        },
        validate::{
            disc_center::check_center, elliptical_disc::check_disc, letter::check_letter,
            outline::check_rims,
        },
    },
    scratch::reserve_total,
};

/// Depth of the binary search for the threshold of a candidate.
const SEARCH_DEPTH: u32 = 2;
/// Level that separates white in a shadow from black in the light, as a share of the contrast in the light.
const SHADOW_SHARE: f64 = 0.25;
/// Share of the light left in the darkest shadow.
const SHADOW_LEFT: f64 = 0.4;
/// Tolerance of steps along the rims of a softened ring, as a share of the contrast.
const STEPS_SHARE: f64 = 0.08;
/// Margin of the window around a candidate: a factor, and pixels.
const WINDOW_MARGIN: (f64, f64) = (1.25, 3.0);

/// Finds rings of the given kinds.
#[derive(Clone, Debug)]
pub struct Detector {
    kinds: Vec<Kind>,
    coded: Vec<CodedKind>,
    params: Params,
    rules: Rules,
    search_rules: SearchRules,
    /// Polarities of the kinds; black rings if there are none.
    polarities: Vec<Polarity>,
    mask: Mask,
    /// Instruction set, detected once.
    level: Level,
}

/// Rings per frame for which capacity is reserved in advance.
pub(crate) const RESERVED_RINGS: usize = 1024;

/// Memory of detection, reused from frame to frame. The first frame of a size reserves address
/// space of about three frames for the worst case; nothing is allocated afterwards, and pages are
/// used only as far as rings fill them.
#[derive(Debug, Default)]
pub struct Scratch {
    /// Width and height of the frames for which memory is reserved.
    size: (usize, usize),
    pub(crate) measure: MeasureScratch,
    pub(crate) batch: BatchScratch,
    pub(crate) search: SearchScratch,
    /// A corrected window of the frame.
    corrected: Vec<u8>,
    /// Pixels that show the light.
    samples: Vec<LightSample>,
    pub(crate) found: Vec<Ring>,
    pub(crate) claims: Vec<Claim>,
    pub(crate) rejects: Rejects,
}

impl Scratch {
    /// Reserves memory for rings as large as the frame and an edge at each pixel of a row.
    pub(crate) fn reserve(&mut self, frame: &Frame, max_roundels: usize) {
        let size = (frame.width(), frame.height());
        if self.size == size {
            return;
        }
        self.size = size;
        self.measure.reserve(size);
        self.batch.reserve(size.1);
        self.search.reserve(size.0);
        reserve_total(&mut self.corrected, size.0 * size.1);
        reserve_total(&mut self.samples, MAX_SAMPLES);
        let max = max_roundels.min(RESERVED_RINGS);
        reserve_total(&mut self.found, max);
        reserve_total(&mut self.claims, max);
    }

    /// Rejected candidates of the newest frame, by stage.
    pub fn rejects(&self) -> &RejectCounts {
        &self.rejects.counts
    }

    /// Enables keeping rejected candidates with their positions, at most
    /// [`crate::marker::MAX_REJECTED`] a frame; off by default.
    pub fn explain(&mut self, on: bool) {
        self.rejects.keep(on);
    }

    /// Rejected candidates of the newest frame, if they are kept.
    pub fn rejected(&self) -> &[Rejected] {
        self.rejects.list.as_deref().unwrap_or_default()
    }
}

impl Detector {
    /// A detector of these kinds. Without kinds, every plausible black ring is found and has no
    /// kind.
    pub fn new(kinds: Vec<Kind>, params: Params) -> Result<Self, DetectorError> {
        params::check(&kinds, &params)?;
        let ratios = kinds
            .iter()
            .map(Kind::ratios)
            .reduce(|range, of_kind| (range.0.min(of_kind.0), range.1.max(of_kind.1)));
        let elliptical = |kind: &Kind| matches!(kind.pattern, Pattern::Elliptical { .. });
        let rules = Rules {
            ratios: ratios.unwrap_or(RATIO_LIMITS),
            similar: !kinds.iter().any(elliptical),
            min_semi_minor_px: params.min_semi_minor_px,
            min_axis_ratio: params.min_axis_ratio,
            min_contrast: f64::from(params.min_contrast),
            max_spread_px2: MAX_SPREAD_PX2,
            steps_share: 0.0,
            fits_paper_edge: true,
        };
        let search_rules = SearchRules::new(&kinds, &rules, params.min_contrast);
        let has = |polarity| kinds.iter().any(|kind| kind.polarity == polarity);
        let mut polarities = vec![Polarity::BlackRing, Polarity::WhiteRing];
        polarities.retain(|&polarity| {
            has(polarity) || kinds.is_empty() && polarity == Polarity::BlackRing
        });
        let (mask, level) = (Mask::default(), Level::new());
        let coded = coded_kinds(&kinds)?;
        Ok(Self { kinds, coded, params, rules, search_rules, polarities, mask, level })
    }

    /// The same detector, ignoring roundels whose centre lies in the mask.
    pub fn with_mask(self, mask: Mask) -> Self {
        Self { mask, ..self }
    }

    /// The same detector; without kinds, it finds rings of this polarity instead of black ones.
    pub fn with_default_polarity(mut self, polarity: Polarity) -> Self {
        if self.kinds.is_empty() {
            self.polarities = vec![polarity];
        }
        self
    }

    /// The kinds, indexed by [`crate::id::KindId`].
    pub fn kinds(&self) -> &[Kind] {
        &self.kinds
    }

    /// The limits of detection.
    pub fn params(&self) -> &Params {
        &self.params
    }

    /// All rings of one frame, in the order of the rows in which they were found.
    pub fn detect<'s>(&self, frame: &Frame, scratch: &'s mut Scratch) -> &'s [Ring] {
        scratch.rejects.clear();
        scratch.claims.clear();
        scratch.found.clear();
        self.search(frame, Window::of(frame), self.params.max_roundels, scratch);
        &scratch.found
    }

    /// Measures rings at the scratch's probes that are where predicted, several at once; the rest
    /// needs [`Detector::measure`].
    pub(crate) fn measure_batch(&self, frame: &Frame, scratch: &mut BatchScratch) {
        scratch.found = [None; BATCH_SIZE];
        if !self.coded.is_empty() || self.kinds.is_empty() || !self.rules.similar {
            return;
        }
        batch::measure_batch(frame, &self.rules, &self.kinds, scratch);
        for found in &mut scratch.found {
            *found = found.filter(|found| !self.mask.covers(found.ring.outer.center));
        }
    }

    /// The ring at a probe.
    pub(crate) fn measure(
        &self,
        frame: &Frame,
        probe: &Probe,
        scratch: &mut MeasureScratch,
    ) -> Result<Ring, Reject> {
        let ring = self.measure_any(frame, probe, &self.rules, scratch)?;
        if self.mask.covers(ring.outer.center) { Err(Reject::Masked) } else { Ok(ring) }
    }

    /// A tracked ring at a probe; `last` is the one of the frame before.
    pub(crate) fn measure_tracked(
        &self,
        frame: &Frame,
        probe: &Probe,
        last: &Ring,
        scratch: &mut Scratch,
    ) -> Result<Ring, Reject> {
        let measured = self.measure(frame, probe, &mut scratch.measure);
        let unevenness = measured.map_or(f64::INFINITY, |ring| ring.unevenness);
        if unevenness <= UNEVEN {
            return measured;
        }
        let levels = (last.black, last.white);
        let again =
            self.measure_again(frame, probe, levels, scratch, |frame, probe, rules, scratch| {
                self.measure_any(frame, probe, rules, scratch)
            });
        match again {
            Ok(ring) if ring.unevenness < unevenness => Ok(ring),
            _ => measured,
        }
    }

    /// The ring at a probe in a corrected picture of its surroundings: softened where pixels are hard steps, and with
    /// even light where the edge of a shadow crosses it. `levels` are those of black and white in the light.
    fn measure_again(
        &self,
        frame: &Frame,
        probe: &Probe,
        (dark, bright): (f64, f64),
        scratch: &mut Scratch,
        measure: impl Fn(&Frame, &Probe, &Rules, &mut MeasureScratch) -> Result<Ring, Reject>,
    ) -> Result<Ring, Reject> {
        let Scratch { corrected, samples, measure: memory, .. } = scratch;
        let window = probe.bounds;
        let mut rules = self.rules;
        let (mut common_threshold, mut shadow_px) = (None, 0.0);
        let threshold;
        if are_hard(frame, &window, bright - dark) {
            soften(frame, &window, corrected);
            rules.max_spread_px2 += SOFTENING_PX2;
            rules.steps_share = STEPS_SHARE;
            threshold = own_threshold(dark, bright);
        } else {
            let probe = probe.with_frame_threshold(shadow_level(dark, bright));
            let edge = find_edge(frame, &probe, memory, samples).ok_or(Reject::Contrast)?;
            edge.even_out(frame, &window, corrected);
            rules.fits_paper_edge = false;
            threshold = edge.threshold();
            common_threshold = Some(edge.common_threshold());
            shadow_px = edge.rim_error_px();
        }
        let frame = Frame::new(corrected, window.width(), window.height(), window.width())
            .map_err(|_| Reject::FrameEdge)?;
        let probe = probe.within_bounds().with_frame_threshold(threshold);
        let ring =
            measure(&frame, &probe, &rules, memory)?.moved(window.left as f64, window.top as f64);
        if self.mask.covers(ring.outer.center) {
            return Err(Reject::Masked);
        }
        Ok(Ring { threshold: common_threshold.unwrap_or(ring.threshold), shadow_px, ..ring })
    }

    /// A ring whose teeth are decoded is coded. Otherwise it is measured as a plain one; if that
    /// fails too, it is a coded ring that cannot be read.
    fn measure_any(
        &self,
        frame: &Frame,
        probe: &Probe,
        rules: &Rules,
        scratch: &mut MeasureScratch,
    ) -> Result<Ring, Reject> {
        if self.coded.is_empty() {
            return measure(frame, probe, rules, &self.kinds, scratch);
        }
        let coded = coded::measure(frame, probe, rules, &self.coded, scratch.level);
        if coded.is_ok_and(|ring| ring.code.is_some()) || self.coded.len() == self.kinds.len() {
            return coded;
        }
        let plain = measure(frame, probe, rules, &self.kinds, scratch);
        plain.or_else(|reject| coded.map_err(|_| reject))
    }

    /// Appends rings whose disc crosses `window` and that are not claimed yet to `found`, and
    /// claims them, until `found` has `max` of them.
    pub(crate) fn search(&self, frame: &Frame, window: Window, max: usize, scratch: &mut Scratch) {
        scratch.reserve(frame, self.params().max_roundels);
        let mut memory = std::mem::take(&mut scratch.search);
        let SearchScratch { row, hits, claimed } = &mut memory;
        claimed.clear(window);
        scratch.claims.iter().for_each(|claim| claimed.add(claim));
        let rules = &self.search_rules.for_width(frame.width());
        for v in (window.top..window.bottom).step_by(ROW_STEP) {
            if scratch.found.len() >= max {
                break;
            }
            row.read(self.level, frame, v, &window, rules.step);
            for &polarity in &self.polarities {
                find_hits(row, &rules.hit_in(v), polarity, hits);
                for hit in &hits.hits {
                    if scratch.found.len() >= max || claimed.contains(hit.u, hit.v) {
                        continue;
                    }
                    if let Some(ring) = self.measure_hit(frame, hit, polarity, rules, scratch) {
                        let claim = Claim::new(&ring);
                        claimed.add(&claim);
                        scratch.claims.push(claim);
                        scratch.found.push(ring);
                    }
                }
            }
        }
        scratch.search = memory;
    }

    /// The ring of a hit, at the first threshold of the binary search that shows it.
    fn measure_hit(
        &self,
        frame: &Frame,
        hit: &Hit,
        polarity: Polarity,
        rules: &SearchRules,
        scratch: &mut Scratch,
    ) -> Option<Ring> {
        let center = PixelPoint { u: hit.u as f64, v: hit.v as f64 };
        let mut rejected =
            Rejected { center, half_box_px: (hit.half_px, hit.half_px), reject: Reject::Masked };
        if self.mask.covers(center) {
            scratch.rejects.add(rejected);
            return None;
        }
        let mut first = None;
        for threshold in BinarySearch::new(hit.black, hit.white, SEARCH_DEPTH) {
            let measured = cross(frame, hit, threshold, &rules.cross, polarity);
            let measured = measured.and_then(|candidate| {
                let (u, v) = candidate.center;
                rejected.center = PixelPoint { u: u as f64, v: v as f64 };
                rejected.half_box_px = candidate.half_box_px;
                self.measure_candidate(frame, &candidate, polarity, scratch)
            });
            match measured {
                Ok(ring) if ring.unevenness <= UNEVEN => return Some(ring),
                Ok(ring) => {
                    let again = self.measure_hit_again(frame, hit, polarity, rules, scratch);
                    return again.filter(|it| it.unevenness < ring.unevenness).or(Some(ring));
                }
                Err(reject) => {
                    first = first.or(Some(reject));
                    // Another threshold helps only if the rims are bridged at this one.
                    if reject != Reject::BlackTooLarge && reject != Reject::WhiteTooLarge {
                        break;
                    }
                }
            }
        }
        if self.may_be_in_shadow(hit, first)
            && let Some(ring) = self.measure_hit_again(frame, hit, polarity, rules, scratch)
        {
            return Some(ring);
        }
        scratch.rejects.add(Rejected { reject: first.unwrap_or(Reject::Contrast), ..rejected });
        None
    }

    fn measure_candidate(
        &self,
        frame: &Frame,
        candidate: &Candidate,
        polarity: Polarity,
        scratch: &mut Scratch,
    ) -> Result<Ring, Reject> {
        let probe = probe_of(frame, candidate, polarity);
        let ring = self.measure_new(frame, &probe, &self.rules, &mut scratch.measure)?;
        self.unclaimed(ring, scratch)
    }

    /// The ring of a hit in a corrected picture.
    fn measure_hit_again(
        &self,
        frame: &Frame,
        hit: &Hit,
        polarity: Polarity,
        rules: &SearchRules,
        scratch: &mut Scratch,
    ) -> Option<Ring> {
        let (dark, bright) = match polarity {
            Polarity::BlackRing => (hit.black, hit.white),
            Polarity::WhiteRing => (!hit.white, !hit.black),
        };
        let (dark, bright) = (f64::from(dark), f64::from(bright));
        let threshold = polarity.threshold(shadow_level(dark, bright));
        let candidate = cross(frame, hit, threshold, &rules.cross, polarity).ok()?;
        let probe = probe_of(frame, &candidate, polarity);
        let levels = (dark, bright);
        let ring =
            self.measure_again(frame, &probe, levels, scratch, |frame, probe, rules, scratch| {
                self.measure_new(frame, probe, rules, scratch)
            });
        self.unclaimed(ring.ok()?, scratch).ok()
    }

    /// The ring at a probe, with the tests of new rings.
    fn measure_new(
        &self,
        frame: &Frame,
        probe: &Probe,
        rules: &Rules,
        scratch: &mut MeasureScratch,
    ) -> Result<Ring, Reject> {
        let ring = self.measure_any(frame, probe, rules, scratch)?;
        let pattern = self.kind_of(&ring).map_or(Pattern::Plain, |kind| kind.pattern);
        let smooth = !matches!(pattern, Pattern::Coded(_));
        check_rims(frame, &ring, smooth, rules.steps_share)?;
        if smooth {
            check_center(frame, &ring)?;
        }
        match (pattern, self.kind_of(&ring)) {
            (Pattern::Elliptical { .. }, Some(kind)) => check_disc(&ring, kind)?,
            (Pattern::Plain, _) => check_letter(&ring)?,
            _ => (),
        }
        Ok(ring)
    }

    fn unclaimed(&self, ring: Ring, scratch: &Scratch) -> Result<Ring, Reject> {
        if self.mask.covers(ring.outer.center) {
            return Err(Reject::Masked);
        }
        let covered = scratch.claims.iter().any(|claim| claim.covers(&ring));
        if covered { Err(Reject::Claimed) } else { Ok(ring) }
    }

    /// Whether a rejected hit is worth a second look. Most are clutter without even chords; in these the contrast left
    /// in a shadow must be large enough.
    fn may_be_in_shadow(&self, hit: &Hit, reject: Option<Reject>) -> bool {
        match reject {
            Some(Reject::Claimed | Reject::FrameEdge | Reject::TooSmall | Reject::Tilt) => false,
            Some(Reject::Chord) | None => {
                SHADOW_LEFT * f64::from(hit.white.saturating_sub(hit.black))
                    >= f64::from(self.params.min_contrast)
            }
            Some(_) => true,
        }
    }

    fn kind_of(&self, ring: &Ring) -> Option<&Kind> {
        ring.kind.and_then(|kind| self.kinds().get(usize::from(kind.0)))
    }
}

fn probe_of(frame: &Frame, candidate: &Candidate, polarity: Polarity) -> Probe {
    let (half_u, half_v) = candidate.half_box_px;
    let reach = |half: f64| half * WINDOW_MARGIN.0 + WINDOW_MARGIN.1;
    let center = candidate.ring_center;
    Probe {
        center: candidate.center,
        threshold: candidate.threshold,
        bounds: Window::around(frame, center, (reach(half_u), reach(half_v))),
        polarity,
        predicted: None,
    }
}

/// The level that separates black in the light from white in the shadow, by the levels in the light.
fn shadow_level(dark: f64, bright: f64) -> u8 {
    (dark + SHADOW_SHARE * (bright - dark)).round().clamp(1.0, 255.0) as u8
}

fn coded_kinds(kinds: &[Kind]) -> Result<Vec<CodedKind>, DetectorError> {
    let mut coded = Vec::new();
    for (index, kind) in kinds.iter().enumerate() {
        let Pattern::Coded(layout) = kind.pattern else { continue };
        let reader = CodeReader::new(layout, kind.ratio())
            .map_err(|source| DetectorError::Code { name: kind.name.clone(), source })?;
        let id = KindId(index as u16);
        coded.push(CodedKind { id, reader, ratio: kind.ratio(), polarity: kind.polarity });
    }
    Ok(coded)
}
