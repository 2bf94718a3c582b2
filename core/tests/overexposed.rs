//! Rings whose white exceeds what the sensor holds, so that both rims move towards the black.

use crate::drawing::{Drawing, Roundel, ellipse, frame};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use roundel_core::marker::{Detector, Kind, Params, Polarity, Tracker};

const SIDE: usize = 140;
const CASES: u64 = 100;
const PICTURES: u32 = 3;

#[test]
fn overexposed_rings_fit_their_kind() {
    for (polarity, ratio) in
        [(Polarity::BlackRing, 0.4), (Polarity::BlackRing, 0.55), (Polarity::WhiteRing, 0.4)]
    {
        let kind = Kind { polarity, ..Kind::plain("robot", 0.16, 0.16 * ratio) };
        let (mut missed, mut off_px2) = (0, 0.0);
        for seed in 0..CASES {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let radius_px = random.random_range(10.0..40.0);
            let white = 255.0 * random.random_range(1.0..2.2);
            let flat = random.random_range(0.8..1.0);
            let angle_rad = random.random_range(-1.5..1.5);
            let blur_px = random.random_range(0.6..1.0);
            let mut tracker =
                Tracker::new(Detector::new(vec![kind.clone()], Params::default()).unwrap());
            for picture in 0..PICTURES {
                let at = (68.2 + f64::from(picture), 70.7);
                let outer = ellipse(at, (radius_px / flat, radius_px), angle_rad);
                let (black, white, background) = match polarity {
                    Polarity::BlackRing => (60.0, white, 0.6 * white),
                    Polarity::WhiteRing => (white, 60.0, 90.0),
                };
                let mut drawing = Drawing::new(SIDE, SIDE, background, blur_px);
                drawing.add(&Roundel { outer, ratio, margin: 1.4, black, white }, background);
                let pixels = drawing.picture(2.0, seed * 10 + u64::from(picture));
                let frame = frame(&pixels, SIDE);
                match tracker.process(&frame) {
                    [one] if one.track.0 == 1 => {
                        let off_px = one.ring.outer.mean_radius_px() - outer.mean_radius_px();
                        off_px2 += off_px * off_px;
                    }
                    other => {
                        println!(
                            "missed in picture {picture}: {polarity:?} {outer:?} {white} {blur_px} {other:?}"
                        );
                        println!("{:?}", tracker.rejects());
                        missed += 1;
                    }
                }
            }
        }
        let rms_px = (off_px2 / (CASES * u64::from(PICTURES)) as f64).sqrt();
        println!("{polarity:?} {ratio}: {missed} missed, radius off by {rms_px:.3} px rms");
        assert_eq!(missed, 0);
        assert!(rms_px < 0.15);
    }
}
