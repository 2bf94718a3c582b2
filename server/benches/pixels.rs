//! Cost of converting a picture of 1280x720 to 8-bit grey, by format.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use jpeg_encoder::{ColorType, Encoder};
use roundel_server::capture::{
    image_file,
    source::pixels::{GreyConverter, PixelFormat, RawImage},
};

const WIDTH: usize = 1280;
const HEIGHT: usize = 720;

/// Noise on a gradient, so that compression and branches are as hard as in a real picture.
fn bytes(count: usize) -> Vec<u8> {
    let noise = |i: usize| (i as u32).wrapping_mul(2_654_435_761) >> 28;
    (0..count).map(|i| (i / 37 % 200) as u8 + noise(i) as u8).collect()
}

fn formats(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("grey_1280x720");
    group.throughput(Throughput::Elements((WIDTH * HEIGHT) as u64));
    for code in [b"NV12", b"YUYV", b"Y10 ", b"Y10P", b"Y12P", b"RGGB", b"RG12"] {
        let format = PixelFormat::from_fourcc(*code).expect("a known format");
        let stride = format.row_bytes(WIDTH);
        let bytes = bytes(stride * HEIGHT);
        let mut converter = GreyConverter::default();
        group.bench_function(String::from_utf8_lossy(code).trim(), |bencher| {
            bencher.iter(|| {
                let raw = RawImage { format, bytes: &bytes, width: WIDTH, height: HEIGHT, stride };
                black_box(converter.grey(black_box(&raw)).expect("a whole picture"));
            });
        });
    }
    let mut jpeg = Vec::new();
    let rgb = bytes(3 * WIDTH * HEIGHT);
    let mut encoder = Encoder::new(&mut jpeg, 80);
    encoder.set_sampling_factor(jpeg_encoder::SamplingFactor::F_2_2);
    encoder.encode(&rgb, WIDTH as u16, HEIGHT as u16, ColorType::Rgb).expect("a picture");
    group.bench_function(format!("JPEG of {} kB", jpeg.len() / 1000), |bencher| {
        bencher.iter(|| {
            black_box(image_file::decode(black_box(&jpeg), "frame".as_ref()).expect("a picture"));
        });
    });
    group.finish();
}

criterion_group!(benches, formats);
criterion_main!(benches);
