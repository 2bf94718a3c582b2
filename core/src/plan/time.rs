//! How long a frame takes: the paper's equation (20) with the terms that our detector has.
//!
//! A frame costs something for itself, for the pixels s_i of it that are searched, and for each of its n roundels:
//!
//! t = c₀ + c₁ s_i + n p(d, v)
//!
//! p depends on the diameter d (the paper's s_p is d²) and on the motion v, pixels from frame to frame. For plain
//! roundels
//!
//! p = k₀ + k₁ n(d) + k₂ m(d) + k₃ d² + k₄ w(d) + s (k₅ + k₆ d + k₇ v d²),
//!
//! s = x/(1 + x),  x = (v⁴ d / (2.5⁴ · 30))^1.5:
//!
//! between 25 and 30 px what following takes falls by half (n, from 1 to 0; so it was measured, of a ratio of 0.4);
//! small ones, whose rims are blurred into each other, need a second look (m, from 1 to 0 between 14 and 18 px); what is
//! wider than a vector (from about 41 px on) is summed up by itself and not beside others (w, from 0 to 1); and of what
//! moves the fit looks for the smear, once there is one to see, with more pixels the longer it is. What says whether there
//! is one goes with the fourth power of the motion and with how long the rim is, so that s is steep. Coded ones are never
//! narrow nor beside others: p = k₀ + k₁ d² + s (k₂ + k₃ v d²), and the search for them looks longer at what is none, so
//! that a pixel costs more. All this holds with constants of their own for frames in which roundels are followed (a part
//! of the picture is searched for new ones, and all are located) and for those that are searched as a whole, of which
//! there is the paper's share α.
//!
//! The constants belong to a machine and a mode; [`fit`] finds them from measured times, none below zero. v is taken as
//! 12 px at most; measured was to 7. A coded one that is smeared by some 2 px or more (8 px a frame) may take ten times as
//! long, since its fit ends in the careful one. What stands about in the picture, and how long it is exposed (a quarter of
//! the time between frames, in what was measured), are not in the model: before an even floor a search takes about half.

use nalgebra::{DMatrix, DVector};

use super::{PlanError, within};

/// Numbers of the model for frames of one sort.
pub const TERMS: usize = 15;
/// What they are multiplied with, in their order.
pub const TERM_NAMES: [&str; TERMS] = [
    "frame",
    "image_px",
    "plain",
    "plain_narrow",
    "plain_small",
    "plain_area_px",
    "plain_wide",
    "plain_smeared",
    "plain_diameter_smeared",
    "plain_area_motion_px",
    "coded_image_px",
    "coded",
    "coded_area_px",
    "coded_smeared",
    "coded_area_motion_px",
];
/// Up to there rings take the longer way to be followed, and from there on the shorter one, pixels.
const NARROW_PX: [f64; 2] = [25.0, 30.0];
/// Up to there rings are small, and from there on they are not, pixels.
const SMALL_PX: [f64; 2] = [14.0, 18.0];
/// From here to there rings no longer fit, with the margin in which they are looked for, into the 64 columns that are
/// summed up at once.
const WIDE_PX: [f64; 2] = [38.0, 44.0];
/// Motion that counts at most, pixels a frame, and from about which on the fit sees it of rings of that diameter.
const MOST_MOTION_PX: f64 = 12.0;
const SEEN_MOTION_PX: f64 = 2.5;
const SEEN_DIAMETER_PX: f64 = 30.0;
/// How steeply it does, more than what it sees grows.
const SEEN_POWER: f64 = 1.5;
/// What the model misses by more than this share is left out of the fit of constants: a fit among those measured that
/// ended in the careful one says nothing of the others.
const MOST_MISSED: f64 = 0.25;
/// A constant is not freed for less.
const LEAST_GAIN: f64 = 1e-12;

/// What is done in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// Pixels of the picture.
    pub image_px: f64,
    /// Roundels in it.
    pub roundels: f64,
    /// Their mean diameter, pixels.
    pub diameter_px: f64,
    /// How far each of them moves from frame to frame, pixels.
    pub motion_px: f64,
    /// Whether they are coded.
    pub is_coded: bool,
    /// Share of frames that are searched as a whole, 0 to 1.
    pub searched_share: f64,
}

/// What a machine takes for it, seconds, by [`TERM_NAMES`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Constants {
    /// In frames in which roundels are followed.
    pub followed: [f64; TERMS],
    /// In frames that are searched as a whole.
    pub searched: [f64; TERMS],
}

impl Load {
    /// Checks each number on its own.
    pub fn check(&self) -> Result<(), PlanError> {
        within("pixels of the picture", self.image_px, [1.0, 1e9], "1 to 1000000000")?;
        within("roundels", self.roundels, [0.0, 1e6], "0 to 1000000")?;
        within("diameter", self.diameter_px, [1.0, 1e5], "1 to 100000 px")?;
        within("motion", self.motion_px, [0.0, 1e5], "0 to 100000 px a frame")?;
        within("share of frames that are searched", self.searched_share, [0.0, 1.0], "0 to 1")
    }

    fn terms(&self) -> [f64; TERMS] {
        let Self { image_px, roundels, diameter_px, motion_px, is_coded, .. } = *self;
        let ramp = |[from_px, to_px]: [f64; 2]| {
            ((diameter_px - from_px) / (to_px - from_px)).clamp(0.0, 1.0)
        };
        let (small, narrow, wide) = (1.0 - ramp(SMALL_PX), 1.0 - ramp(NARROW_PX), ramp(WIDE_PX));
        let area_px = diameter_px * diameter_px;
        let motion_px = motion_px.min(MOST_MOTION_PX);
        let seen = (motion_px / SEEN_MOTION_PX).powi(4) * diameter_px / SEEN_DIAMETER_PX;
        let seen = seen.powf(SEEN_POWER);
        let smeared = seen / (1.0 + seen);
        let (plain, coded) = if is_coded { (0.0, roundels) } else { (roundels, 0.0) };
        [
            1.0,
            image_px,
            plain,
            plain * narrow,
            plain * small,
            plain * area_px,
            plain * wide,
            plain * smeared,
            plain * smeared * diameter_px,
            plain * smeared * motion_px * area_px,
            if is_coded { image_px } else { 0.0 },
            coded,
            coded * area_px,
            coded * smeared,
            coded * smeared * motion_px * area_px,
        ]
    }
}

impl Constants {
    /// Of precise mode on one core of a virtual machine (AMD EPYC) as `roundel plan --measure` finds them
    /// there, the mean of three times; for whoever has not measured.
    pub const PRECISE: Self = Self {
        followed: [
            2.7e-6, 6.2e-12, 7.5e-6, 4.4e-6, 3.8e-6, 5.0e-9, 0.0, 0.0, 3.2e-7, 2.9e-10, 1.9e-12,
            3.6e-5, 1.5e-8, 2.3e-5, 1.1e-9,
        ],
        searched: [
            8.1e-6, 1.3e-10, 1.6e-5, 3.4e-6, 7.2e-6, 9.3e-9, 1.8e-7, 6.4e-6, 0.0, 1.2e-9, 5.1e-12,
            5.7e-5, 2.0e-8, 2.1e-5, 4.2e-10,
        ],
    };
    /// The same of fast mode.
    pub const FAST: Self = Self {
        followed: [
            2.1e-6, 6.1e-12, 1.0e-6, 2.1e-6, 1.4e-6, 5.8e-10, 1.6e-6, 5.3e-8, 6.1e-9, 0.0, 6.8e-14,
            7.6e-6, 0.0, 3.4e-8, 2.0e-11,
        ],
        searched: [
            4.7e-6, 1.3e-10, 7.3e-6, 9.8e-7, 4.1e-6, 2.0e-9, 2.7e-6, 8.8e-7, 0.0, 0.0, 2.8e-12,
            3.3e-5, 2.1e-9, 0.0, 1.3e-10,
        ],
    };

    /// Seconds a frame, on one core.
    pub fn frame_s(&self, load: &Load) -> f64 {
        let terms = load.terms();
        let share = load.searched_share;
        (1.0 - share) * sum(&self.followed, &terms) + share * sum(&self.searched, &terms)
    }
}

fn sum(constants: &[f64; TERMS], terms: &[f64; TERMS]) -> f64 {
    constants.iter().zip(terms).map(|(constant, term)| constant * term).sum()
}

/// The constants that explain measured times best, of frames that were followed (a share of 0) and of such that were
/// searched (of 1): least squares of relative errors, none of them negative, without those times that are missed by far.
/// `None` without as many measurements of either as constants.
pub fn fit(measured: &[(Load, f64)]) -> Option<Constants> {
    let of = |searched_share: f64| {
        let own: Vec<_> = measured
            .iter()
            .filter(|(load, _)| load.searched_share == searched_share)
            .map(|(load, time_s)| (load.terms(), *time_s))
            .collect();
        let found = explaining(&own)?;
        let missed =
            |(terms, time_s): &([f64; TERMS], f64)| (sum(&found, terms) / time_s - 1.0).abs();
        let met: Vec<_> = own.iter().copied().filter(|one| missed(one) <= MOST_MISSED).collect();
        explaining(&met).or(Some(found))
    };
    Some(Constants { followed: of(0.0)?, searched: of(1.0)? })
}

/// Lawson and Hanson's algorithm (*Solving Least Squares Problems*, 1974, chapter 23).
fn explaining(measured: &[([f64; TERMS], f64)]) -> Option<[f64; TERMS]> {
    if measured.len() < TERMS
        || measured.iter().any(|(_, time_s)| !time_s.is_finite() || *time_s <= 0.0)
    {
        return None;
    }
    let mut rows = DMatrix::from_fn(measured.len(), TERMS, |row, term| {
        measured[row].0[term] / measured[row].1
    });
    // Columns of one size, so that seconds a pixel do not vanish beside seconds a frame.
    let scale: Vec<f64> = rows.column_iter().map(|column| column.norm()).collect();
    for (mut column, scale) in rows.column_iter_mut().zip(&scale) {
        column /= if *scale > 0.0 { *scale } else { 1.0 };
    }
    let wanted = DVector::repeat(measured.len(), 1.0);
    let mut found = DVector::zeros(TERMS);
    let mut free: Vec<usize> = Vec::new();
    // Each round frees the constant that would help most; there are few more rounds than constants.
    for _ in 0..10 * TERMS {
        let gain = rows.tr_mul(&(&wanted - &rows * &found));
        let held = (0..TERMS).filter(|term| !free.contains(term));
        let Some(next) = held.max_by(|&a, &b| gain[a].total_cmp(&gain[b])) else { break };
        if gain[next] <= LEAST_GAIN {
            break;
        }
        free.push(next);
        while let Some(best) = solved(&rows, &free, &wanted) {
            // As far towards the best as none is negative; the one that would be is held at 0 again.
            let negative = free.iter().filter(|&&term| best[term] <= 0.0);
            let step = |term: usize| {
                if found[term] > 0.0 { found[term] / (found[term] - best[term]) } else { 0.0 }
            };
            let least = negative.map(|&term| (step(term), term));
            let least = least.min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((share, term)) = least else {
                found = best;
                break;
            };
            found = &found + (best - &found) * share;
            found[term] = 0.0;
            free.retain(|free| *free != term);
        }
    }
    let constant = |term: usize| if scale[term] > 0.0 { found[term] / scale[term] } else { 0.0 };
    Some(std::array::from_fn(constant))
}

/// Least squares over these columns alone, the others at 0.
fn solved(rows: &DMatrix<f64>, free: &[usize], wanted: &DVector<f64>) -> Option<DVector<f64>> {
    if free.is_empty() {
        return Some(DVector::zeros(TERMS));
    }
    let part = rows.select_columns(free);
    let part = part.svd(true, true).solve(wanted, 1e-12).ok()?;
    let mut all = DVector::zeros(TERMS);
    free.iter().zip(&part).for_each(|(&term, value)| all[term] = *value);
    Some(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loads() -> Vec<Load> {
        let mut loads = Vec::new();
        for image_px in [3e5, 2e6] {
            for roundels in [1.0, 20.0, 100.0] {
                for diameter_px in [12.0, 20.0, 28.0, 41.0, 80.0] {
                    for motion_px in [0.0, 2.0, 8.0] {
                        for is_coded in [false, true] {
                            for searched_share in [0.0, 1.0] {
                                loads.push(Load {
                                    image_px,
                                    roundels,
                                    diameter_px,
                                    motion_px,
                                    is_coded,
                                    searched_share,
                                });
                            }
                        }
                    }
                }
            }
        }
        loads
    }

    #[test]
    fn measured_constants_are_found_again() {
        let searched = [
            1e-5, 5e-10, 2e-6, 7e-7, 1e-6, 1e-9, 3e-6, 1e-7, 2e-10, 3e-10, 2e-10, 2e-5, 1e-8, 1e-6,
            1e-9,
        ];
        let truth = Constants { searched, followed: searched.map(|constant| 0.3 * constant) };
        let measured: Vec<_> =
            loads().into_iter().map(|load| (load, truth.frame_s(&load))).collect();
        let found = fit(&measured).unwrap();
        let pairs = [(found.followed, truth.followed), (found.searched, truth.searched)];
        for (found, truth) in pairs {
            for (found, truth) in found.iter().zip(truth) {
                assert!((found / truth - 1.0).abs() < 1e-6, "{found:?} {truth}");
            }
        }
    }

    #[test]
    fn no_constant_is_negative_and_too_few_times_are_refused() {
        let measured: Vec<_> = loads()
            .into_iter()
            .map(|load| {
                let area_px = load.diameter_px * load.diameter_px;
                (load, 1e-5 + 1e-6 * load.roundels - 1e-10 * load.roundels * area_px)
            })
            .collect();
        let found = fit(&measured).unwrap();
        assert!(found.followed.iter().all(|&constant| constant >= 0.0), "{found:?}");
        assert_eq!(found.followed[5], 0.0, "{found:?}");
        assert_eq!(fit(&measured[..TERMS]), None);
        assert_eq!(fit(&[(loads()[0], f64::NAN); 30]), None);
    }

    #[test]
    fn more_of_anything_takes_longer() {
        let usual = Load {
            image_px: 9e5,
            roundels: 20.0,
            diameter_px: 46.0,
            motion_px: 1.0,
            is_coded: false,
            searched_share: 0.0,
        };
        for constants in [Constants::PRECISE, Constants::FAST] {
            for is_coded in [false, true] {
                let usual = Load { is_coded, ..usual };
                let time_s = constants.frame_s(&usual);
                for more in [
                    Load { image_px: 2e6, ..usual },
                    Load { roundels: 30.0, ..usual },
                    Load { diameter_px: 60.0, ..usual },
                    Load { motion_px: 4.0, ..usual },
                    Load { searched_share: 0.1, ..usual },
                ] {
                    assert!(constants.frame_s(&more) > time_s, "{more:?}");
                }
            }
        }
        let small = Load { diameter_px: 10.0, ..usual };
        let middling = Load { diameter_px: 25.0, ..usual };
        assert!(Constants::PRECISE.frame_s(&small) > Constants::PRECISE.frame_s(&middling));
    }

    #[test]
    fn loads_that_cannot_be_say_why() {
        let usual = loads()[0];
        for (load, expected) in [
            (
                Load { motion_px: -1.0, ..usual },
                "motion: expected 0 to 100000 px a frame, found -1",
            ),
            (
                Load { diameter_px: f64::NAN, ..usual },
                "diameter: expected 1 to 100000 px, found NaN",
            ),
            (
                Load { searched_share: 1.1, ..usual },
                "share of frames that are searched: expected 0",
            ),
            (Load { roundels: f64::INFINITY, ..usual }, "roundels: expected 0 to 1000000"),
        ] {
            let error = load.check().unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error}");
        }
        assert!(usual.check().is_ok());
    }
}
