//! Descriptions of prints in commands and requests: diameters, code, polarity, and numbers of codes.

use clap::ValueEnum;
use roundel_core::marker::{CodeLayout, Kind, Pattern, Polarity, Ring};

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum PolarityArg {
    /// Black ring, white disc, on white
    #[default]
    BlackRing,
    /// White ring, black disc, on black
    WhiteRing,
}

impl From<PolarityArg> for Polarity {
    fn from(word: PolarityArg) -> Self {
        match word {
            PolarityArg::BlackRing => Self::BlackRing,
            PolarityArg::WhiteRing => Self::WhiteRing,
        }
    }
}

/// Diameters as given with `--marker`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Diameters {
    /// Diameter of the ring.
    pub outer_m: f64,
    /// Diameter of the disc, the longer one if it is elliptical.
    pub inner_m: Option<f64>,
    /// Shorter diameter of an elliptical disc.
    pub minor_m: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrintSpec {
    pub diameters: Option<Diameters>,
    pub code: Option<CodeLayout>,
    pub polarity: Polarity,
}

impl PrintSpec {
    /// The kind to search for; `None` if rings of any ratio are wanted. Without diameters, the outer one is a metre.
    pub fn kind(&self) -> Option<Kind> {
        let unknown = Diameters { outer_m: 1.0, inner_m: None, minor_m: None };
        let Diameters { outer_m, inner_m, minor_m } = self.diameters.unwrap_or(unknown);
        let inner_m = inner_m.or(self.code.map(|_| outer_m * CodeLayout::RATIO))?;
        let pattern = match (self.code, minor_m) {
            (Some(layout), _) => Pattern::Coded(layout),
            (None, Some(minor_diameter_m)) => Pattern::Elliptical { minor_diameter_m },
            (None, None) => Pattern::Plain,
        };
        Some(Kind { pattern, polarity: self.polarity, ..Kind::plain("as given", outer_m, inner_m) })
    }

    /// The kind for a ring's pose; `None` if its size is unknown. A missing inner diameter is taken from the picture:
    /// the ratio of two nearly concentric circles is nearly that of their images.
    pub fn kind_of(&self, ring: &Ring) -> Option<Kind> {
        let outer_m = self.diameters?.outer_m;
        let ratio = ring.inner.mean_radius_px() / ring.outer.mean_radius_px();
        let as_seen =
            || Kind { polarity: self.polarity, ..Kind::plain("", outer_m, outer_m * ratio) };
        Some(self.kind().unwrap_or_else(as_seen))
    }
}

/// Parses `OUTER_MM[:INNER_MM[:MINOR_MM]]`.
pub fn diameters(text: &str) -> Result<Diameters, String> {
    let millimetres = |text: &str| -> Result<f64, String> {
        let value: f64 = text.trim().parse().map_err(|_| {
            format!(
                "expected OUTER_MM, OUTER_MM:INNER_MM or OUTER_MM:INNER_MM:MINOR_MM, such as 160:64, \
                 found `{text}`"
            )
        })?;
        if value > 0.0 && value <= 1e5 {
            Ok(value * 1e-3)
        } else {
            Err(format!("expected a diameter above 0 mm, at most 100000 mm, found `{text}`"))
        }
    };
    let parts = text.splitn(3, ':').map(millimetres).collect::<Result<Vec<f64>, _>>()?;
    let (outer_m, inner_m, minor_m) = (parts[0], parts.get(1).copied(), parts.get(2).copied());
    match (inner_m, minor_m) {
        (Some(inner_m), _) if inner_m >= outer_m => {
            Err(format!("the inner diameter must be below the outer one, found `{text}`"))
        }
        (Some(inner_m), Some(minor_m)) if minor_m >= inner_m => {
            Err(format!("an elliptical disc's longer diameter comes first, found `{text}`"))
        }
        _ => Ok(Diameters { outer_m, inner_m, minor_m }),
    }
}

/// Parses `BITS[:DISTANCE]`.
pub fn code(text: &str) -> Result<CodeLayout, String> {
    let whole = |part: &str| -> Result<u8, String> {
        part.trim()
            .parse()
            .map_err(|_| format!("expected BITS or BITS:DISTANCE, such as 8:2, found `{text}`"))
    };
    let (bits, distance) = text.split_once(':').unwrap_or((text, "1"));
    let layout = CodeLayout { bits: whole(bits)?, min_distance: whole(distance)? };
    layout.check().map_err(|error| error.to_string())?;
    Ok(layout)
}

/// Limit for untrusted requests: the number of codes of any length.
const MAX_NUMBERS: usize = u16::MAX as usize;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CodeNumbers(pub Vec<u16>);

/// Parses `1-24,30`.
pub fn numbers(text: &str) -> Result<CodeNumbers, String> {
    let wrong = || format!("expected numbers from 1 on, such as 1-24,30, found `{text}`");
    let number = |text: &str| text.trim().parse::<u16>().ok().filter(|&number| number > 0);
    let mut numbers = Vec::new();
    for part in text.split(',') {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        let (first, last) = number(first)
            .zip(number(last))
            .filter(|(first, last)| first <= last)
            .ok_or_else(wrong)?;
        numbers.extend(first..=last);
        if numbers.len() > MAX_NUMBERS {
            return Err(format!("expected at most {MAX_NUMBERS} numbers, found more"));
        }
    }
    Ok(CodeNumbers(numbers))
}

/// Parses `COLUMNSxROWS`.
pub fn sides(text: &str) -> Result<(usize, usize), String> {
    let side = |side: &str| side.trim().parse::<usize>().ok();
    text.split_once(['x', 'X', '×'])
        .and_then(|(columns, rows)| Some((side(columns)?, side(rows)?)))
        .ok_or_else(|| format!("expected COLUMNSxROWS, such as 7x5, found `{text}`"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn diameters_are_parsed_with_or_without_the_inner_one() {
        assert_eq!(
            diameters("160:64"),
            Ok(Diameters { outer_m: 0.16, inner_m: Some(0.064), minor_m: None })
        );
        assert_eq!(diameters("160"), Ok(Diameters { outer_m: 0.16, inner_m: None, minor_m: None }));
        let disc = Diameters { outer_m: 0.16, inner_m: Some(0.096), minor_m: Some(0.064) };
        assert_eq!(diameters("160:96:64"), Ok(disc));
        let print = PrintSpec { diameters: Some(disc), code: None, polarity: Polarity::BlackRing };
        let pattern = Pattern::Elliptical { minor_diameter_m: 0.064 };
        assert_eq!(print.kind().map(|kind| kind.pattern), Some(pattern));
        for (text, expected) in [
            ("160:64:96", "longer diameter comes first"),
            ("160:96:64:1", "such as 160:64"),
            ("64:160", "must be below the outer one"),
            ("big", "such as 160:64, found `big`"),
            ("0", "above 0 mm"),
            ("nan:1", "above 0 mm"),
        ] {
            let error = diameters(text).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn codes_are_parsed_with_or_without_their_distance() {
        assert_eq!(code("8:2"), Ok(CodeLayout { bits: 8, min_distance: 2 }));
        assert_eq!(code("12"), Ok(CodeLayout { bits: 12, min_distance: 1 }));
        for (text, expected) in [
            ("eight", "such as 8:2, found `eight`"),
            ("8:", "such as 8:2, found `8:`"),
            ("-8", "such as 8:2"),
            ("300", "such as 8:2"),
            ("1", "expected codes of 2 to 16 bits, found 1"),
            ("8:0", "expected a Hamming distance of 1 to"),
            ("8:9", "found 9"),
        ] {
            let error = code(text).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn numbers_are_ranges_and_lists() {
        assert_eq!(numbers("1-3, 30"), Ok(CodeNumbers(vec![1, 2, 3, 30])));
        for wrong in ["", "0", "3-1", "a", "1-", "1,,2", "70000"] {
            let error = numbers(wrong).unwrap_err();
            assert!(error.ends_with(&format!("found `{wrong}`")), "{error}");
        }
        assert!(numbers("1-65535").is_ok());
        assert!(numbers("1-65535,1").unwrap_err().contains("at most 65535 numbers"));
    }

    #[test]
    fn sides_of_a_board_are_two_numbers() {
        assert_eq!(sides("7x5"), Ok((7, 5)));
        for wrong in ["7", "7x", "x5", "7x5x3", "-7x5"] {
            assert!(sides(wrong).unwrap_err().ends_with(&format!("found `{wrong}`")));
        }
    }

    #[test]
    fn a_coded_print_has_the_ratio_of_all_coded_prints() {
        let print = |diameters, code| PrintSpec { diameters, code, polarity: Polarity::WhiteRing };
        let layout = CodeLayout { bits: 8, min_distance: 2 };
        let outer = Some(Diameters { outer_m: 0.16, inner_m: None, minor_m: None });
        let kind = print(outer, Some(layout)).kind().unwrap();
        assert!((kind.inner_diameter_m - 0.096).abs() < 1e-12);
        assert_eq!(kind.pattern, Pattern::Coded(layout));
        assert_eq!(kind.polarity, Polarity::WhiteRing);
        // Codes are read without any diameter, but there is no pose.
        let rim = |semi_px: f64| roundel_core::ellipse::Ellipse {
            center: roundel_core::camera::PixelPoint { u: 0.0, v: 0.0 },
            semi_major_px: semi_px,
            semi_minor_px: semi_px,
            angle_rad: 0.0,
        };
        let ring = Ring::of_rims(rim(20.0), rim(10.0));
        let sizeless = print(None, Some(layout));
        assert!((sizeless.kind().unwrap().ratio() - 0.6).abs() < 1e-12);
        assert_eq!(sizeless.kind_of(&ring), None);
        // A missing inner diameter is taken from the picture.
        let seen = print(outer, None);
        assert_eq!(seen.kind(), None);
        let kind = seen.kind_of(&ring).unwrap();
        assert!((kind.inner_diameter_m - 0.08).abs() < 1e-12);
        assert_eq!(kind.polarity, Polarity::WhiteRing);
    }
}
