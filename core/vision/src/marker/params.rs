//! Parameters of the detector and the tracker.

use thiserror::Error;

use crate::marker::{
    code::CodeError,
    kind::{AXIS_RATIO_LIMIT, Kind, Pattern, RATIO_LIMITS, is_measurable, shows_heading},
};

/// Ratios of diameters closer than this cannot be distinguished by a camera.
const MIN_DIFFERENCE: f64 = 0.005;

/// Trade-off between time and precision.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Mode {
    /// Rims from moments, poses in closed form.
    Fast,
    /// Rims and poses fitted to the grey levels.
    #[default]
    Precise,
}

/// Limits of detection and tracking.
#[derive(Clone, Debug, PartialEq)]
pub struct Params {
    /// Trade-off between time and precision.
    pub mode: Mode,
    /// Largest number of roundels found in one frame or tracked.
    pub max_roundels: usize,
    /// Smallest shorter semiaxis of the outer rim, pixels.
    pub min_semi_minor_px: f64,
    /// Smallest difference of white and black, grey levels; below it, noise forms rings.
    pub min_contrast: u8,
    /// Smallest ratio of shorter to longer semiaxis, the cosine of the largest tilt.
    pub min_axis_ratio: f64,
    /// While roundels are tracked, the search for new ones covers the whole frame once in this many
    /// frames, a part in each, so that it never delays the tracked ones.
    pub search_frames: u32,
    /// A roundel that is missing for more frames than this loses its number.
    pub coast_frames: u32,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            mode: Mode::default(),
            max_roundels: 400,
            min_semi_minor_px: 4.0,
            min_contrast: 20,
            min_axis_ratio: 0.25,
            search_frames: 16,
            coast_frames: 5,
        }
    }
}

/// Why a detector cannot be created.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum DetectorError {
    /// Invalid diameters of a kind.
    #[error(
        "roundel {name:?}: expected an inner diameter of {low} to {high} of the outer one, \
         found {inner_m} m of {outer_m} m; print a roundel within these limits",
        low = RATIO_LIMITS.0,
        high = RATIO_LIMITS.1
    )]
    Diameters {
        /// Name of the kind.
        name: String,
        /// Its inner diameter, metres.
        inner_m: f64,
        /// Its outer diameter, metres.
        outer_m: f64,
    },
    /// A parameter out of its range.
    #[error("detector parameter {name}: expected {expected}, found {found}")]
    Param {
        /// Name of the field.
        name: &'static str,
        /// Valid range.
        expected: &'static str,
        /// Value found.
        found: f64,
    },
    /// Invalid layout of a coded kind.
    #[error("roundel {name:?}: {source}")]
    Code {
        /// Name of the kind.
        name: String,
        /// Reason.
        source: CodeError,
    },
    /// Two kinds that a camera cannot distinguish.
    #[error(
        "roundels {one:?} and {other:?} cannot be distinguished: expected plain ones to differ by \
         {MIN_DIFFERENCE} in the ratio of their diameters, elliptical ones in one of their two \
         ratios, and coded ones in their number of bits"
    )]
    Indistinguishable {
        /// Name of one kind.
        one: String,
        /// Name of the other.
        other: String,
    },
    /// Invalid shorter diameter of an elliptical disc.
    #[error(
        "roundel {name:?}: expected the disc's shorter diameter to be at least {low} of the outer one, \
         and at most {AXIS_RATIO_LIMIT} of the longer one, found {minor_m} m with {major_m} m and \
         {outer_m} m",
        low = RATIO_LIMITS.0
    )]
    Elliptical {
        /// Name of the kind.
        name: String,
        /// The disc's shorter diameter, metres.
        minor_m: f64,
        /// The disc's longer diameter, metres.
        major_m: f64,
        /// The ring's diameter, metres.
        outer_m: f64,
    },
    /// More kinds than [`crate::id::KindId`] can number.
    #[error("expected at most 65535 kinds of roundel, found {found}")]
    Kinds {
        /// Number of kinds.
        found: usize,
    },
}

/// Whether a detector can be created with these.
pub(crate) fn check(kinds: &[Kind], params: &Params) -> Result<(), DetectorError> {
    if kinds.len() > usize::from(u16::MAX) {
        return Err(DetectorError::Kinds { found: kinds.len() });
    }
    for kind in kinds {
        let (outer_m, inner_m) = (kind.outer_diameter_m, kind.inner_diameter_m);
        let positive = outer_m.is_finite() && outer_m > 0.0 && inner_m > 0.0;
        if !(positive && is_measurable(kind.ratio())) {
            let name = kind.name.clone();
            return Err(DetectorError::Diameters { name, inner_m, outer_m });
        }
        if let Pattern::Elliptical { minor_diameter_m: minor_m } = kind.pattern
            && !(is_measurable(minor_m / outer_m) && shows_heading(minor_m / inner_m))
        {
            let (name, major_m) = (kind.name.clone(), inner_m);
            return Err(DetectorError::Elliptical { name, minor_m, major_m, outer_m });
        }
    }
    for (index, one) in kinds.iter().enumerate() {
        if let Some(other) = kinds[..index].iter().find(|other| are_indistinguishable(one, other)) {
            let (one, other) = (other.name.clone(), one.name.clone());
            return Err(DetectorError::Indistinguishable { one, other });
        }
    }
    let param = |name, expected, found: f64, ok: bool| {
        if ok { Ok(()) } else { Err(DetectorError::Param { name, expected, found }) }
    };
    let min = params.min_semi_minor_px;
    param("min_semi_minor_px", "a finite number of at least 3", min, (3.0..1e4).contains(&min))?;
    let ratio = params.min_axis_ratio;
    param("min_axis_ratio", "0.1 to 1", ratio, (0.1..=1.0).contains(&ratio))?;
    let contrast = params.min_contrast;
    param("min_contrast", "8 or more", f64::from(contrast), contrast >= 8)?;
    let frames = params.search_frames;
    param("search_frames", "1 or more", f64::from(frames), frames >= 1)
}

/// Whether a camera cannot distinguish the two kinds.
fn are_indistinguishable(one: &Kind, other: &Kind) -> bool {
    let same = |one: f64, other: f64| (one - other).abs() < MIN_DIFFERENCE;
    let same_ratio = same(one.ratio(), other.ratio());
    let same_pattern = match (one.pattern, other.pattern) {
        (Pattern::Plain, Pattern::Plain) => same_ratio,
        (Pattern::Coded(one), Pattern::Coded(other)) => one.bits == other.bits,
        (Pattern::Elliptical { .. }, Pattern::Elliptical { .. }) => {
            same_ratio && same(one.ratios().0, other.ratios().0)
        }
        _ => false,
    };
    same_pattern && one.polarity == other.polarity
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kind(outer_diameter_m: f64, inner_diameter_m: f64) -> Kind {
        Kind::plain("robot", outer_diameter_m, inner_diameter_m)
    }

    #[test]
    fn invalid_kinds_are_rejected() {
        assert_eq!(check(&[kind(0.16, 0.064)], &Params::default()), Ok(()));
        for (outer, inner) in [(0.1, 0.1), (0.0, 0.0), (f64::NAN, 0.1), (0.1, -0.05), (1.0, 0.1)] {
            let error = check(&[kind(outer, inner)], &Params::default()).unwrap_err();
            assert!(error.to_string().contains("roundel \"robot\": expected an inner diameter"));
        }
    }

    /// Prints are specified in millimetres, whose ratios are not exactly 0.2, 0.8 and 0.9.
    #[test]
    fn diameters_at_the_limits_are_accepted() {
        let printed = |outer_mm: f64, inner_mm: f64| kind(outer_mm * 1e-3, inner_mm * 1e-3);
        let elliptical = |outer_mm, inner_mm, minor_mm: f64| Kind {
            pattern: Pattern::Elliptical { minor_diameter_m: minor_mm * 1e-3 },
            ..printed(outer_mm, inner_mm)
        };
        let is_accepted = |kind: Kind| check(&[kind], &Params::default()).is_ok();
        assert!(
            [50.0, 7.0, 30.0, 15.0]
                .into_iter()
                .all(|outer| is_accepted(printed(outer, 0.2 * outer)))
        );
        assert!(
            [25.0, 50.0, 35.0].into_iter().all(|outer| is_accepted(printed(outer, 0.8 * outer)))
        );
        assert!(
            is_accepted(elliptical(50.0, 20.0, 10.0)) && is_accepted(elliptical(100.0, 70.0, 63.0))
        );
        // A hundredth of a millimetre beyond a limit is rejected.
        assert!(!is_accepted(printed(50.0, 9.99)) && !is_accepted(printed(25.0, 20.01)));
        assert!(
            !is_accepted(elliptical(50.0, 20.0, 9.99))
                && !is_accepted(elliptical(100.0, 70.0, 63.01))
        );
    }

    #[test]
    fn an_elliptical_disc_is_neither_round_nor_a_line() {
        let elliptical = |minor_diameter_m| Kind {
            pattern: Pattern::Elliptical { minor_diameter_m },
            ..kind(0.16, 0.096)
        };
        assert_eq!(check(&[elliptical(0.064), kind(0.16, 0.08)], &Params::default()), Ok(()));
        assert_eq!(check(&[elliptical(0.064), elliptical(0.07)], &Params::default()), Ok(()));
        let error = check(&[elliptical(0.064), elliptical(0.0643)], &Params::default());
        assert!(matches!(error, Err(DetectorError::Indistinguishable { .. })));
        for minor_m in [0.03, 0.094, f64::NAN, -0.05] {
            let error = check(&[elliptical(minor_m)], &Params::default()).unwrap_err();
            assert!(error.to_string().contains("shorter diameter"), "{error}");
        }
    }

    #[test]
    fn errors_of_invalid_params_name_the_field() {
        for (params, field) in [
            (Params { min_semi_minor_px: f64::NAN, ..Params::default() }, "min_semi_minor_px"),
            (Params { min_axis_ratio: 0.0, ..Params::default() }, "min_axis_ratio"),
            (Params { min_contrast: 1, ..Params::default() }, "min_contrast"),
            (Params { search_frames: 0, ..Params::default() }, "search_frames"),
        ] {
            assert!(check(&[], &params).unwrap_err().to_string().contains(field));
        }
    }
}
