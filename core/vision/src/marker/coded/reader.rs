//! Reads a code.
//!
//! The profile around the teeth gives the likeliest identity ([`crate::marker::coded::decode`]). Its template, blurred as
//! the image is, is then fitted to the profile: its phase to a fraction of a sample, and its amplitude.
//! With the correlation ρ of the two, the profile's likelihood under unknown noise is
//! (1 - ρ²)^(-n/2) for n independent levels, two per bit; so the reading's confidence against a rival
//! with correlation ρ′ is 1 / (1 + ((1 - ρ²)/(1 - ρ′²))^(n/2)). A profile that does not belong to any code
//! (a plain disc, clutter, a half covered ring) has a low ρ or a wrong amplitude,
//! and is rejected.

use fearless_simd::Level;

use crate::{
    frame::Frame,
    marker::{
        Ring,
        code::{Code, CodeError, CodeLayout, CodeReading, Dictionary},
        coded::{
            decode::{self, DecodedWord},
            plane_map::PlaneMap,
            profile::{Directions, MAX_SAMPLES, Profile, RingLevels},
            sampler::Sampler,
        },
    },
};

/// Deviation of a template's blur, pixels: a typical value, since a ring does not include its own.
const USUAL_BLUR_PX: f64 = 0.8;
/// Correlated error of samples that share pixels, radians: from 20,000 readings each of 8 to 16
/// bits, beyond the error of each sample (`cargo run -p roundel-tests -- codes`).
const SHARED_RAD: f64 = 8e-4;
/// Smallest ρ² of a reading …
const MIN_FIT: f32 = 0.7;
/// … smallest and largest amplitude, as a share of half the ring's contrast …
const AMPLITUDES: (f32, f32) = (0.4, 1.6);
/// … and smallest confidence.
const MIN_CONFIDENCE: f64 = 0.99;
/// The template is smoothed in steps of at most this variance, squared samples.
const STEP_SPREAD: f32 = 0.6;
const MAX_STEPS: usize = 8;
/// Smallest number of samples per slot, and their distance where more are possible, pixels.
const MIN_PER_SLOT: usize = 4;
const STEP_PX: f64 = 2.0;
/// Gauss-Newton iterations for the phase.
const PHASE_TURNS: usize = 2;

/// Reads the codes of one layout.
#[derive(Clone, Debug)]
pub struct CodeReader {
    dictionary: Dictionary,
    own_distances: Vec<u8>,
    /// By samples per slot, ascending.
    directions: Vec<Directions>,
    ratio: f64,
}

impl CodeReader {
    /// A reader of a layout's codes; `ratio` is the white disc's diameter over the outer one,
    /// [`CodeLayout::RATIO`] for WhyCode's prints.
    pub fn new(layout: CodeLayout, ratio: f64) -> Result<Self, CodeError> {
        let dictionary = layout.codes()?;
        let own = |(code, _): (Code, u16)| dictionary.own_distance(code.number).unwrap_or(1);
        let own_distances = dictionary.iter().map(own).collect();
        let slots = 2 * usize::from(layout.bits);
        let core = CodeLayout::CORE_SHARE * ratio;
        let directions = (MIN_PER_SLOT..=MAX_SAMPLES / slots)
            .map(|per_slot| Directions::new(slots * per_slot, core, ratio))
            .collect();
        Ok(Self { dictionary, own_distances, directions, ratio })
    }

    /// The identities that it distinguishes.
    pub fn dictionary(&self) -> &Dictionary {
        &self.dictionary
    }

    /// Reads the teeth inside a ring; `None` if they are unreadable.
    pub fn read(&self, frame: &Frame, ring: &Ring) -> Option<CodeReading> {
        let plane = PlaneMap::new(&ring.outer, ring.inner.center, self.ratio);
        let levels = RingLevels {
            black: ring.black,
            white: ring.white,
            polarity: ring.polarity,
            blur_px: USUAL_BLUR_PX,
        };
        let sampler = Sampler { frame, level: Level::new(), inverted: false };
        Some(self.read_in(&sampler, &plane, &levels)?.in_image(&plane, self.ratio))
    }

    /// [`CodeReader::read`] with a given plane map.
    pub(crate) fn read_in(
        &self,
        sampler: &Sampler,
        plane: &PlaneMap,
        levels: &RingLevels,
    ) -> Option<DecodedRing> {
        let profile = self.directions_for(plane).profile(sampler, plane, levels)?;
        let found = decode::decode(&profile, &self.dictionary, &self.own_distances)?;
        let fit = self.fit(&profile, &found)?;
        let confidence = self.confidence(&found, fit.square);
        if fit.square < MIN_FIT
            || fit.amplitude < AMPLITUDES.0
            || fit.amplitude > AMPLITUDES.1
            || confidence < MIN_CONFIDENCE
        {
            return None;
        }
        let pair = profile.len as f64 / f64::from(self.dictionary.layout().bits);
        // A sample represents the half on either side of it.
        let zero = found.phase as f64 - 0.5 + f64::from(fit.phase) - pair * f64::from(found.shift);
        let step_rad = std::f64::consts::TAU / profile.len as f64;
        Some(DecodedRing {
            code: found.code,
            word: self.dictionary.word(found.code.number)?,
            zero_rad: step_rad * zero,
            deviation_rad: (step_rad * f64::from(fit.deviation)).hypot(SHARED_RAD),
            confidence,
            corrected: found.corrected,
        })
    }

    /// The number of samples for the circumference of the teeth.
    fn directions_for(&self, plane: &PlaneMap) -> &Directions {
        let middle = 0.5 * (1.0 + CodeLayout::CORE_SHARE) * self.ratio;
        let around_px = std::f64::consts::TAU * middle * plane.reach_px();
        let slots = 2.0 * f64::from(self.dictionary.layout().bits);
        let per_slot = (around_px / (STEP_PX * slots)) as usize + 1;
        let max = self.directions.len() - 1;
        &self.directions[per_slot.saturating_sub(MIN_PER_SLOT).min(max)]
    }

    fn confidence(&self, found: &DecodedWord, square: f32) -> f64 {
        let rival = (found.rival / found.score).clamp(0.0, 1.0);
        let (best, rival) = (f64::from(square), f64::from(square * rival * rival));
        let levels = 2.0 * f64::from(self.dictionary.layout().bits);
        1.0 / (1.0 + ((1.0 - best) / (1.0 - rival)).powf(0.5 * levels))
    }

    /// Fits the blurred template of the decoded word.
    fn fit(&self, profile: &Profile, found: &DecodedWord) -> Option<Fit> {
        let len = profile.len;
        let mut template = self.template(found, len);
        smooth(&mut template[..len], profile);
        let template = &template[..len];
        let white = &profile.white[..len];
        let power: f32 = white.iter().map(|p| p * p).sum();
        let mut fit = Fit { phase: 0.0, amplitude: 0.0, square: 0.0, deviation: 0.0 };
        let mut shifted = [0.0f32; MAX_SAMPLES];
        for turn in 0..=PHASE_TURNS {
            shift(template, fit.phase, &mut shifted[..len]);
            let model = &shifted[..len];
            let energy: f32 = model.iter().map(|m| m * m).sum();
            let common: f32 = model.iter().zip(white).map(|(m, p)| m * p).sum();
            if !(energy > 0.0 && common > 0.0 && power > 0.0) {
                return None;
            }
            fit.amplitude = common / energy;
            fit.square = (common / energy) * (common / power);
            if turn == PHASE_TURNS {
                break;
            }
            let (mut along, mut steep) = (0.0, 0.0);
            for index in 0..len {
                let before = model[if index == 0 { len - 1 } else { index - 1 }];
                let after = model[if index + 1 == len { 0 } else { index + 1 }];
                let slope = 0.5 * (after - before);
                along += slope * white[index];
                steep += slope * slope;
            }
            // The template is orthogonal to its derivative, so the profile's component along it is
            // the shift.
            let change = -along / (fit.amplitude * steep);
            fit.phase = (fit.phase + change).clamp(-1.0, 1.0);
            let left = (1.0 - fit.square).max(0.0) * power / len as f32;
            fit.deviation = (left / steep).sqrt() / fit.amplitude;
        }
        Some(fit)
    }

    /// The word's slots as samples, unblurred.
    fn template(&self, found: &DecodedWord, len: usize) -> [f32; MAX_SAMPLES] {
        let bits = self.dictionary.layout().bits;
        let per_slot = len / (2 * usize::from(bits));
        let mut template = [0.0; MAX_SAMPLES];
        let mut place = found.phase;
        for bit in (0..bits).rev() {
            let first = if found.word >> bit & 1 == 1 { 1.0 } else { -1.0 };
            for level in [first, -first] {
                for _ in 0..per_slot {
                    template[place] = level;
                    place = if place + 1 == len { 0 } else { place + 1 };
                }
            }
        }
        template
    }
}

/// A reading relative to a plane map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DecodedRing {
    code: Code,
    /// As printed.
    pub word: u16,
    /// Angle of the print's x axis, counter-clockwise on the print from the plane map's first axis.
    pub zero_rad: f64,
    deviation_rad: f64,
    confidence: f64,
    corrected: u8,
}

impl DecodedRing {
    /// The reading in image coordinates.
    pub fn in_image(&self, plane: &PlaneMap, ratio: f64) -> CodeReading {
        let (sin, cos) = (-self.zero_rad).sin_cos();
        CodeReading {
            code: self.code,
            word: Some(self.word),
            zero: plane.image((ratio * cos, ratio * sin)),
            opposite: plane.image((-ratio * cos, -ratio * sin)),
            yaw_deviation_rad: self.deviation_rad,
            confidence: self.confidence,
            corrected: self.corrected,
        }
    }
}

/// How a template fits a profile.
#[derive(Clone, Copy, Debug)]
struct Fit {
    /// Samples by which the profile is ahead of the template.
    phase: f32,
    /// Size of the profile in units of the template.
    amplitude: f32,
    /// ρ².
    square: f32,
    /// Standard deviation of the phase, samples.
    deviation: f32,
}

/// Blurs a template by each sample's own variance: steps of (a, 1 - 2a, a), with variance 2a.
fn smooth(template: &mut [f32], profile: &Profile) {
    let len = template.len();
    let spread = &profile.spread[..len];
    let max = spread.iter().fold(0.0f32, |max, &s| max.max(s));
    let steps = ((max / STEP_SPREAD).ceil() as usize).clamp(1, MAX_STEPS);
    let mut shares = [0.0f32; MAX_SAMPLES];
    for (share, &spread) in shares.iter_mut().zip(spread) {
        *share = (0.5 * spread / steps as f32).min(0.5 * STEP_SPREAD);
    }
    let mut padded = [0.0f32; MAX_SAMPLES + 2];
    for _ in 0..steps {
        padded[1..=len].copy_from_slice(template);
        (padded[0], padded[len + 1]) = (template[len - 1], template[0]);
        for (index, value) in template.iter_mut().enumerate() {
            let (before, here, after) = (padded[index], padded[index + 1], padded[index + 2]);
            *value = here + shares[index] * (before - 2.0 * here + after);
        }
    }
}

/// The template moved ahead by a fraction of a sample.
fn shift(template: &[f32], by: f32, shifted: &mut [f32]) {
    let len = template.len();
    let share = by.abs();
    for (index, value) in shifted.iter_mut().enumerate() {
        let other = if by > 0.0 {
            template[if index == 0 { len - 1 } else { index - 1 }]
        } else {
            template[if index + 1 == len { 0 } else { index + 1 }]
        };
        *value = template[index] + share * (other - template[index]);
    }
}
