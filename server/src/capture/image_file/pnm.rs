//! PGM and PPM (netpbm's P2, P3, P5, P6) with comments anywhere in the header and any maximum up to 65535.

use super::{DecodeError, GreyImage, SampleDepth, SizeCheck, grey, scale_to_u8};

/// Decodes a file that begins with `P2`, `P3`, `P5` or `P6`. Other maxima than 65535 declare the depth in use.
pub(super) fn decode(
    bytes: &[u8],
    check: SizeCheck,
    depth: &mut SampleDepth,
) -> Result<GreyImage, DecodeError> {
    let is_plain = matches!(bytes[1], b'2' | b'3');
    let channels = if matches!(bytes[1], b'3' | b'6') { 3 } else { 1 };
    let mut rest = &bytes[2..];
    let width = number(&mut rest, "width")?;
    let height = number(&mut rest, "height")?;
    let most = number(&mut rest, "largest value")?;
    check.check(width, height)?;
    let most = u16::try_from(most)
        .ok()
        .filter(|most| *most > 0)
        .ok_or_else(|| format!("expected a largest value of 1 to 65535, found {most}"))?;
    let count = width * height * channels;
    if !is_plain && most <= 255 {
        let data = raw_data(rest, count)?;
        let scaled = |&sample: &u8| scale_to_u8(u16::from(sample), most);
        let samples = if most == 255 { data.to_vec() } else { data.iter().map(scaled).collect() };
        return Ok(GreyImage { width, height, pixels: grey(samples, channels) });
    }
    let samples: Vec<u16> = if is_plain {
        // The vector grows with the samples in the file, not with the size that the header claims.
        let sample = |_| Ok(u16::try_from(number(&mut rest, "sample")?).unwrap_or(u16::MAX));
        (0..count).map(sample).collect::<Result<_, DecodeError>>()?
    } else {
        let pairs = raw_data(rest, 2 * count)?.chunks_exact(2);
        pairs.map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect()
    };
    let samples = grey(samples, channels);
    let most = if most == u16::MAX { depth.update(&samples, None) } else { most };
    let pixels = samples.into_iter().map(|sample| scale_to_u8(sample, most)).collect();
    Ok(GreyImage { width, height, pixels })
}

/// The bytes of the samples; exactly one byte of white space separates them from the header.
fn raw_data(rest: &[u8], expected: usize) -> Result<&[u8], DecodeError> {
    let data = rest.get(1..).unwrap_or_default();
    let found = data.len();
    data.get(..expected)
        .ok_or_else(|| format!("expected {expected} bytes of samples, found {found}").into())
}

/// The next number, after white space and comments.
fn number(rest: &mut &[u8], what: &str) -> Result<usize, DecodeError> {
    while let Some(&byte) = rest.first() {
        if byte == b'#' {
            let end = rest.iter().position(|&byte| byte == b'\n').unwrap_or(rest.len());
            *rest = &rest[end..];
        } else if byte.is_ascii_whitespace() {
            *rest = &rest[1..];
        } else {
            break;
        }
    }
    let digits = rest.iter().take_while(|byte| byte.is_ascii_digit()).count();
    let (number, after) = rest.split_at(digits);
    *rest = after;
    std::str::from_utf8(number)
        .ok()
        .and_then(|number| number.parse().ok())
        .ok_or_else(|| format!("expected a number as {what}").into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixels(bytes: &[u8]) -> Result<Vec<u8>, String> {
        let check = SizeCheck { expected: None, max_pixels: super::super::MAX_PIXELS };
        match decode(bytes, check, &mut SampleDepth::default()) {
            Ok(image) => Ok(image.pixels),
            Err(DecodeError::Broken(reason) | DecodeError::TooLarge(reason)) => Err(reason),
            Err(DecodeError::Size(found)) => panic!("{found:?}"),
        }
    }

    #[test]
    fn every_dialect_is_read() {
        assert_eq!(pixels(b"P5\n# made by hand\n2 1 # size\n255\n\x0A\xFF").unwrap(), [10, 255]);
        assert_eq!(pixels(b"P5 2 1 1023\n\x02\x00\x03\xFF").unwrap(), [128, 255]);
        assert_eq!(pixels(b"P2 2 1 15 0 15").unwrap(), [0, 255]);
        // Twelve bits, although the header claims sixteen.
        assert_eq!(pixels(b"P5 2 1 65535\n\x08\x01\x0F\xFF").unwrap(), [128, 255]);
        assert_eq!(pixels(b"P6 1 1 255\n\xFF\x00\x00").unwrap(), [76]);
        assert_eq!(pixels(b"P3 1 1 255 0 255 0").unwrap(), [150]);
    }

    #[test]
    fn errors_say_what_was_expected() {
        for (bytes, expected) in [
            (&b"P5 2"[..], "expected a number as height"),
            (b"P5 0 3 255\n", "its size is 0 x 3"),
            (b"P5 2 2 0\n1234", "expected a largest value of 1 to 65535, found 0"),
            (b"P5 2 2 255\n123", "expected 4 bytes of samples, found 3"),
            (b"P2 2 1 255 7", "expected a number as sample"),
            (b"P5 99999 2 255\n", "99999 x 2 pixels"),
            (b"P5 99999999999999999999999 2 255\n", "expected a number as width"),
        ] {
            let error = pixels(bytes).expect_err(expected);
            assert!(error.contains(expected), "{error} lacks {expected}");
        }
    }
}
