//! Rings that the edge of a shadow crosses at any place and in any direction, found and followed.

use crate::drawing::{Drawing, Roundel, ellipse, frame};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use roundel_core::marker::{
    CodeLayout, Detector, Kind, Params, Pattern, Polarity, Ring, Tooth, Tracker,
};

const SIDE: usize = 140;
/// Pictures of a ring: the first is searched, in the others it is followed.
const PICTURES: u32 = 4;
/// Motion from one picture to the next, pixels; the shadow stays.
const MOTION_PX: f64 = 1.3;

/// A ring and the shadow's edge in its first picture.
#[derive(Clone, Copy, Debug)]
struct Case {
    semiaxes_px: (f64, f64),
    angle_rad: f64,
    margin: f64,
    blur_px: f64,
    /// Direction into the shadow, the edge's distance from the ring's middle, and the share of the light left.
    towards_rad: f64,
    offset_px: f64,
    share: f64,
    seed: u64,
}

impl Case {
    fn new(diameters_px: (f64, f64), shares: (f64, f64), seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let radius_px = 0.5 * random.random_range(diameters_px.0..diameters_px.1);
        let flat = random.random_range(0.75..1.0);
        Self {
            semiaxes_px: (radius_px / flat, radius_px),
            angle_rad: random.random_range(-1.5..1.5),
            margin: random.random_range(1.3..1.5),
            blur_px: random.random_range(0.5..1.0),
            towards_rad: random.random_range(-3.1..3.1),
            offset_px: radius_px * random.random_range(-1.2..1.2),
            share: random.random_range(shares.0..shares.1),
            seed,
        }
    }

    fn roundel(&self, picture: u32, ratio: f64) -> Roundel {
        let moved_px = MOTION_PX * f64::from(picture);
        let at = (69.3 + moved_px, 70.8 - 0.4 * moved_px);
        let outer = ellipse(at, self.semiaxes_px, self.angle_rad);
        Roundel { outer, ratio, margin: self.margin, black: 30.0, white: 220.0 }
    }

    fn picture(
        &self,
        number: u32,
        ratio: f64,
        teeth: Option<&[Tooth]>,
        polarity: Polarity,
    ) -> Vec<u8> {
        let mut roundel = self.roundel(number, ratio);
        let mut background = 120.0;
        if polarity == Polarity::WhiteRing {
            (roundel.black, roundel.white) = (roundel.white, roundel.black);
            background = 90.0;
        }
        let mut drawing = Drawing::new(SIDE, SIDE, background, self.blur_px);
        match teeth {
            Some(teeth) => drawing.add_coded(&roundel, background, teeth),
            None => drawing.add(&roundel, background),
        }
        drawing.shadow((69.3, 70.8), self.towards_rad, self.offset_px, self.share);
        drawing.picture(2.0, self.seed * u64::from(PICTURES) + u64::from(number))
    }

    /// The ring in each picture where it is found as the first track.
    fn rings(&self, kind: &Kind, teeth: Option<&[Tooth]>) -> Vec<Option<Ring>> {
        let detector = Detector::new(vec![kind.clone()], Params::default()).unwrap();
        let mut tracker = Tracker::new(detector);
        (0..PICTURES)
            .map(|number| {
                let picture = self.picture(number, kind.ratio(), teeth, kind.polarity);
                let tracked = tracker.process(&frame(&picture, SIDE)).to_vec();
                match tracked[..] {
                    [one] if one.track.0 == 1 => Some(one.ring),
                    _ => {
                        let rejects = tracker.rejects().iter().filter(|(_, count)| *count > 0);
                        println!("{number}: {tracked:?} {:?}", rejects.collect::<Vec<_>>());
                        None
                    }
                }
            })
            .collect()
    }

    /// Error of the outer rim: centre and mean radius, pixels.
    fn error_px(&self, picture: u32, ring: &Ring) -> (f64, f64) {
        let truth = self.roundel(picture, 0.5).outer;
        let (du, dv) = (ring.outer.center.u - truth.center.u, ring.outer.center.v - truth.center.v);
        (du.hypot(dv), ring.outer.mean_radius_px() - truth.mean_radius_px())
    }
}

/// Missed pictures of rings, and the rms errors of the others.
#[derive(Debug, Default)]
struct Tally {
    missed: usize,
    found: f64,
    center: f64,
    radius: f64,
}

fn tally(
    diameters_px: (f64, f64),
    shares: (f64, f64),
    kind: &Kind,
    teeth: Option<&[Tooth]>,
) -> Tally {
    let mut tally = Tally::default();
    for seed in 0..CASES {
        let case = Case::new(diameters_px, shares, seed);
        for (picture, ring) in (0..).zip(case.rings(kind, teeth)) {
            let Some(ring) = ring else {
                println!("missed in picture {picture}: {case:?}");
                tally.missed += 1;
                continue;
            };
            let (center_px, radius_px) = case.error_px(picture, &ring);
            tally.found += 1.0;
            tally.center += center_px * center_px;
            tally.radius += radius_px * radius_px;
        }
    }
    tally.center = (tally.center / tally.found).sqrt();
    tally.radius = (tally.radius / tally.found).sqrt();
    println!("{diameters_px:?} px, {shares:?}: {tally:?}");
    tally
}

const CASES: u64 = 60;

/// Sizes and shares of light left.
const RANGES: [((f64, f64), (f64, f64)); 4] = [
    ((20.0, 30.0), (0.4, 0.6)),
    ((20.0, 30.0), (0.6, 0.9)),
    ((30.0, 70.0), (0.4, 0.6)),
    ((30.0, 70.0), (0.6, 0.9)),
];

/// Requires that at most a share of the pictures is missed, and errors of at most these, pixels.
fn check(kind: &Kind, teeth: Option<&[Tooth]>, missed: f64) {
    for (diameters_px, shares) in RANGES {
        let tally = tally(diameters_px, shares, kind, teeth);
        let most = missed * (CASES * u64::from(PICTURES)) as f64;
        assert!(tally.missed as f64 <= most, "{:?}: {tally:?}", kind.polarity);
        assert!(tally.center < 0.15 && tally.radius < 0.08, "{:?}: {tally:?}", kind.polarity);
    }
}

#[test]
fn black_rings_are_found_and_followed_across_the_edge_of_a_shadow() {
    for ratio in [0.4, 0.55] {
        check(&Kind::plain("robot", 0.16, 0.16 * ratio), None, 0.005);
    }
}

/// Where the edge touches the outer rim, only the margin shows the shadow, and that of a white ring is black.
#[test]
fn white_rings_are_found_and_followed_across_the_edge_of_a_shadow() {
    let polarity = Polarity::WhiteRing;
    check(&Kind { polarity, ..Kind::plain("robot", 0.16, 0.064) }, None, 0.06);
}

#[test]
fn coded_rings_are_found_and_followed_across_the_edge_of_a_shadow() {
    let layout = CodeLayout { bits: 6, min_distance: 1 };
    let teeth = layout.codes().unwrap().teeth(5).unwrap();
    let kind = Kind {
        pattern: Pattern::Coded(layout),
        ..Kind::plain("robot", 0.16, 0.16 * CodeLayout::RATIO)
    };
    check(&kind, Some(&teeth), 0.01);
}
