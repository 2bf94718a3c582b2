use super::*;

fn grey(format: PixelFormat, bytes: &[u8], size: (usize, usize), stride: usize) -> Vec<u8> {
    let mut converter = GreyConverter::default();
    let raw = RawImage { format, bytes, width: size.0, height: size.1, stride };
    let frame = converter.grey(&raw).unwrap();
    assert_eq!((frame.width(), frame.height()), size);
    (0..frame.height()).flat_map(|v| frame.row(v).to_vec()).collect()
}

#[test]
fn luma_planes_are_used_in_place() {
    // 4 x 2 of NV12 with rows of six bytes; chroma follows.
    let bytes: Vec<u8> = (0..18).collect();
    let mut converter = GreyConverter::default();
    let format = PixelFormat::from_fourcc(*b"NV12").unwrap();
    let raw = RawImage { format, bytes: &bytes, width: 4, height: 2, stride: 6 };
    let frame = converter.grey(&raw).unwrap();
    assert!(std::ptr::eq(frame.row(0).as_ptr(), bytes.as_ptr()), "copied");
    assert_eq!([frame.row(0), frame.row(1)], [&[0, 1, 2, 3], &[6, 7, 8, 9]]);
}

#[test]
fn packed_luma_is_every_second_byte() {
    let bytes = [10, 200, 11, 201, 0, 12, 202, 13, 203, 0];
    for (code, expected) in [(b"YUYV", [10, 11, 12, 13]), (b"UYVY", [200, 201, 202, 203])] {
        let format = PixelFormat::from_fourcc(*code).unwrap();
        assert_eq!(grey(format, &bytes, (2, 2), 5), expected);
    }
}

/// The least and the largest sample, two beside the rounding threshold, and a fifth in an incomplete group.
#[test]
fn deep_samples_are_rounded_in_every_layout() {
    for (samples, bits) in [
        (SampleFormat::Words(10), 10),
        (SampleFormat::Words(12), 12),
        (SampleFormat::Words(14), 14),
        (SampleFormat::Words(16), 16),
        (SampleFormat::Mipi10, 10),
        (SampleFormat::Mipi12, 12),
        (SampleFormat::Bits10, 10),
        (SampleFormat::Bits12, 12),
        (SampleFormat::Gige12, 12),
    ] {
        let unit = 1u32 << (bits - 8);
        let values =
            [0, unit * 256 - 1, 77 * unit + unit / 2, 77 * unit + unit / 2 - 1, 129 * unit];
        let bytes = pack(samples, &values);
        assert_eq!(bytes.len(), samples.row_bytes(5), "{samples:?}");
        let found = grey(PixelFormat::Grey(samples), &bytes, (5, 1), bytes.len());
        assert_eq!(found, [0, 255, 78, 77, 129], "{samples:?}");
    }
}

fn pack(samples: SampleFormat, values: &[u32]) -> Vec<u8> {
    let bits_of = |width: usize| {
        let mut bytes = vec![0u8; (values.len() * width).div_ceil(8)];
        for (index, value) in values.iter().enumerate() {
            for bit in 0..width {
                let at = index * width + bit;
                bytes[at / 8] |= ((value >> bit & 1) as u8) << (at % 8);
            }
        }
        bytes
    };
    let groups = |size: usize, pack: fn(&[u32]) -> Vec<u8>| {
        let padded = values.chunks(size).map(|group| [group, &[0, 0, 0]].concat());
        padded.flat_map(|group| pack(&group[..size])).collect()
    };
    match samples {
        SampleFormat::Eight => values.iter().map(|value| *value as u8).collect(),
        SampleFormat::Words(_) => values.iter().flat_map(|v| (*v as u16).to_le_bytes()).collect(),
        SampleFormat::Bits10 => bits_of(10),
        SampleFormat::Bits12 => bits_of(12),
        SampleFormat::Mipi10 => groups(4, |v| {
            let low = v.iter().enumerate().map(|(i, v)| (v & 3) << (2 * i)).sum::<u32>();
            v.iter().map(|v| v >> 2).chain([low]).map(|byte| byte as u8).collect()
        }),
        SampleFormat::Mipi12 => groups(2, |v| {
            [v[0] >> 4, v[1] >> 4, v[0] & 15 | (v[1] & 15) << 4].map(|byte| byte as u8).to_vec()
        }),
        SampleFormat::Gige12 => groups(2, |v| {
            [v[0] >> 4, v[0] & 15 | (v[1] & 15) << 4, v[1] >> 4].map(|byte| byte as u8).to_vec()
        }),
    }
}

/// A coloured scene with a horizontal gradient.
#[test]
fn mosaics_leave_no_pattern_and_shift_nothing() {
    let (width, height) = (12, 8);
    let colours = [40u32, 100, 160]; // red, green, blue
    for order in [[0, 1, 1, 2], [1, 0, 2, 1], [1, 2, 0, 1], [2, 1, 1, 0]] {
        let level = |u: usize, v: usize| colours[order[(v % 2) * 2 + u % 2]] + 4 * u as u32;
        let bytes: Vec<u8> =
            (0..height).flat_map(|v| (0..width).map(move |u| level(u, v) as u8)).collect();
        let found = grey(PixelFormat::Bayer(SampleFormat::Eight), &bytes, (width, height), width);
        for v in 0..height {
            for u in 1..width - 1 {
                assert_eq!(found[v * width + u], (100 + 4 * u) as u8, "{order:?} ({u}, {v})");
            }
            // The mirrored border.
            assert_eq!(found[v * width], 102);
            assert_eq!(found[v * width + width - 1], (100 + 4 * (width - 1) - 2) as u8);
        }
        let words: Vec<u8> =
            bytes.iter().flat_map(|b| (u16::from(*b) << 4).to_le_bytes()).collect();
        let deep = PixelFormat::Bayer(SampleFormat::Words(12));
        assert_eq!(grey(deep, &words, (width, height), 2 * width), found);
    }
}

#[test]
fn wrong_pictures_say_what_was_expected() {
    let yuyv = PixelFormat::Packed { chroma_first: false };
    let bayer = PixelFormat::Bayer(SampleFormat::Eight);
    for (format, length, (width, height), stride, expected) in [
        (yuyv, 15, (4, 2), 8, "expected at least 16 bytes for 4 x 2 pixels, found 15"),
        (yuyv, 99, (4, 2), 7, "expected rows of at least 8 bytes, found 7"),
        (bayer, 9, (9, 1), 9, "a mosaic of at least 2 x 2 pixels, found 9 x 1"),
        (bayer, 9, (0, 1), 9, "found 0 x 1"),
        (PixelFormat::GREY8, 9, (70_000, 1), 70_000, "70000 x 1"),
    ] {
        let raw = RawImage { format, bytes: &vec![0; length], width, height, stride };
        let error = GreyConverter::default().grey(&raw).unwrap_err().to_string();
        assert!(error.contains(expected), "{error} lacks {expected}");
    }
    assert_eq!(PixelFormat::from_fourcc(*b"H264"), None);
}
