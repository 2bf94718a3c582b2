//! Compares coded rings that are tracked with the same rings searched in each frame: the same codes, and rims as
//! close to the drawn ones.

use crate::drawing::{Drawing, Roundel, ellipse, frame};
use roundel_core::{
    ellipse::Ellipse,
    marker::{Code, CodeLayout, CodeReader, Detector, Kind, Params, Pattern, Scratch, Tracker},
};

const SIDE: usize = 160;
const FRAMES: usize = 8;
const LAYOUT: CodeLayout = CodeLayout { bits: 8, min_distance: 2 };

/// Squared errors of a rim: of its centre, of its mean radius and of its shape, pixels.
#[derive(Clone, Copy, Default)]
struct Errors {
    sums: [f64; 3],
    count: f64,
}

impl Errors {
    fn add(&mut self, found: &Ellipse, rim: &Ellipse) {
        let (du, dv) = (found.center.u - rim.center.u, found.center.v - rim.center.v);
        let grown = found.mean_radius_px() - rim.mean_radius_px();
        let flatter = found.semi_major_px - found.semi_minor_px;
        let flatter = flatter - (rim.semi_major_px - rim.semi_minor_px);
        self.sums[0] += 0.5 * (du * du + dv * dv);
        self.sums[1] += grown * grown;
        self.sums[2] += flatter * flatter;
        self.count += 1.0;
    }

    fn rms(&self) -> [f64; 3] {
        self.sums.map(|sum| (sum / self.count).sqrt())
    }
}

/// A rim that moves by 3 px a frame, rotates and approaches, with a motion that is not quite predictable.
fn rim(case: usize, number: usize) -> Ellipse {
    let (along, late) = (number as f64, (number % 3) as f64);
    let radius = [13.0, 15.0, 18.0, 24.0, 32.0][case % 5] * (1.0 + 0.004 * along);
    let flat = [1.0, 0.9, 0.75][case % 3];
    let at = (60.3 + 3.1 * along + 0.4 * late, 70.6 + 1.7 * along - 0.3 * late);
    ellipse(at, (radius, radius * flat), 0.3 * case as f64 + 0.02 * along)
}

#[test]
fn tracked_rings_are_as_accurate_as_searched_ones() {
    let pattern = Pattern::Coded(LAYOUT);
    let kind = Kind { pattern, ..Kind::plain("robot", 0.16, 0.096) };
    let detector = Detector::new(vec![kind], Params::default()).unwrap();
    let reader = CodeReader::new(LAYOUT, CodeLayout::RATIO).unwrap();
    let mut scratch = Scratch::default();
    let (mut followed, mut searched, mut apart) =
        (Errors::default(), Errors::default(), Errors::default());
    for case in 0..15 {
        let code = Code { bits: LAYOUT.bits, number: 2 + case as u16 };
        let teeth = reader.dictionary().teeth(code.number).unwrap();
        let mut tracker = Tracker::new(detector.clone());
        for number in 0..FRAMES {
            let outer = rim(case, number);
            let ratio = CodeLayout::RATIO;
            let roundel = Roundel { outer, ratio, margin: 1.4, black: 40.0, white: 200.0 };
            let mut drawing = Drawing::new(SIDE, SIDE, 110.0, 0.8);
            drawing.add_coded(&roundel, 110.0, &teeth);
            let pixels = drawing.picture(2.0, (case * FRAMES + number) as u64);
            let frame = frame(&pixels, SIDE);
            let [one] = tracker.process(&frame) else { panic!("case {case}, frame {number}") };
            // A search alone may miss one that is tracked.
            let [other] = detector.detect(&frame, &mut scratch) else { continue };
            let read = |ring: &roundel_core::marker::Ring| ring.code.map(|reading| reading.code);
            // All but the smallest are read.
            if case % 5 > 1 {
                assert_eq!([read(&one.ring), read(other)], [Some(code); 2], "{case} {number}");
            }
            if number > 0 && read(&one.ring).is_some() && read(other).is_some() {
                followed.add(&one.ring.outer, &outer);
                searched.add(&other.outer, &outer);
                apart.add(&one.ring.outer, &other.outer);
            }
        }
    }
    let [ours, theirs] = [followed.rms(), searched.rms()];
    assert!(followed.count > 80.0, "{} of 105 compared", followed.count);
    println!("followed {ours:.4?}, searched {theirs:.4?}, apart {:.4?} px", apart.rms());
    for (ours, theirs) in ours.into_iter().zip(theirs) {
        assert!(ours < 1.1 * theirs + 0.002, "{ours} {theirs}");
    }
    assert!(apart.rms().into_iter().all(|apart_px| apart_px < 0.02), "{:?}", apart.rms());
}
