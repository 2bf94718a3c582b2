use proptest::prelude::*;

use super::*;
use crate::{
    camera::{Lens, PixelPoint},
    id::TrackNumber,
    marker::{CodeLayout, Pattern},
    pose::tests::{camera, pose, rim_of},
    rigid::orientation_of_normal,
};

/// Special cases of a ring.
#[derive(Clone, Copy, Debug)]
enum Odd {
    Nothing,
    FaceOn,
    OfNoKind,
    OfAnEllipticalDisc,
    OfACode,
    NoEllipse,
    /// Outside the range of the lens model.
    Beyond,
    /// Rims that no circle can have.
    FarApart,
}

#[derive(Clone, Debug)]
struct Drawn {
    at: (f64, f64),
    distance_m: f64,
    tilt_rad: f64,
    turn_rad: f64,
    unevenness: f64,
    off_px: f64,
    odd: Odd,
}

fn drawn() -> impl Strategy<Value = Drawn> {
    let odd = prop_oneof![
        12 => Just(Odd::Nothing),
        2 => Just(Odd::FaceOn),
        1 => Just(Odd::OfNoKind),
        1 => Just(Odd::OfAnEllipticalDisc),
        3 => Just(Odd::OfACode),
        1 => Just(Odd::NoEllipse),
        1 => Just(Odd::Beyond),
        1 => Just(Odd::FarApart),
    ];
    let place = ((100.0..1820.0f64, 100.0..980.0f64), 0.25..12.0f64);
    let tilt = (0.0..1.4f64, -3.1..3.1f64);
    (place, tilt, 0.0..0.1f64, -0.1..0.1f64, odd).prop_map(
        |((at, distance_m), (tilt_rad, turn_rad), unevenness, off_px, odd)| Drawn {
            at,
            distance_m,
            tilt_rad,
            turn_rad,
            unevenness,
            off_px,
            odd,
        },
    )
}

fn tracked(camera: &Camera, number: usize, drawn: &Drawn) -> TrackedRing {
    let pixel = PixelPoint { u: drawn.at.0, v: drawn.at.1 };
    let tilt_rad = if let Odd::FaceOn = drawn.odd { 0.0 } else { drawn.tilt_rad };
    let (position_m, normal) = pose(camera, pixel, drawn.distance_m, tilt_rad, drawn.turn_rad);
    let turn = orientation_of_normal(&normal);
    let rim = |radius_m| rim_of(camera, &position_m, &turn, [radius_m; 2]);
    let (outer, mut inner) = (rim(0.08), rim(0.032));
    inner.center.u += drawn.off_px;
    inner.semi_major_px += drawn.off_px.abs();
    let kind = match drawn.odd {
        Odd::OfAnEllipticalDisc => 1,
        Odd::OfACode => 2,
        _ => 0,
    };
    let mut ring = Ring {
        unevenness: drawn.unevenness,
        kind: Some(KindId(kind)),
        ..Ring::of_rims(outer, inner)
    };
    match drawn.odd {
        Odd::OfNoKind => ring.kind = None,
        Odd::NoEllipse => ring.outer.semi_minor_px = 0.1,
        Odd::Beyond => ring.outer.center.u = 4e3,
        Odd::FarApart => ring.inner.center.u += 30.0 * ring.outer.semi_major_px,
        Odd::Nothing | Odd::FaceOn | Odd::OfAnEllipticalDisc | Odd::OfACode => {}
    }
    TrackedRing { track: TrackNumber(number as u64), ring, code: None }
}

proptest! {
    #[test]
    fn batched_rings_equal_single_ones(
        drawn in prop::collection::vec(drawn(), 1..20), lens in 0..4usize,
    ) {
        let lens = [
            Lens::PlumbBob([0.0; 5]),
            Lens::PlumbBob([-0.12, 0.04, 0.0008, -0.0006, 0.0]),
            Lens::Rational([8.1, 5.2, 0.0004, -0.0002, 0.21, 8.4, 8.0, 1.3]),
            Lens::Equidistant([-0.02, 0.011, -0.007, 0.0013]),
        ][lens];
        let camera = camera(lens);
        let pattern = Pattern::Elliptical { minor_diameter_m: 0.05 };
        let coded = Pattern::Coded(CodeLayout { bits: 8, min_distance: 1 });
        let kinds = vec![
            Kind::plain("", 0.16, 0.064),
            Kind { pattern, ..Kind::plain("", 0.16, 0.078) },
            Kind { pattern: coded, ..Kind::plain("", 0.16, 0.064) },
        ];
        let rings: Vec<_> =
            drawn.iter().enumerate().map(|(k, drawn)| tracked(&camera, k, drawn)).collect();
        let pixels = [0; 4];
        let frame = Frame::new(&pixels, 2, 2, 2).unwrap();
        let mut locator = Locator::new(camera, kinds, Mode::Fast);
        let mut single = locator.clone();
        let mut located = Vec::new();
        locator.locate_all(&frame, &rings, &mut located);
        prop_assert_eq!(located.len(), rings.len());
        for ((ring, located), drawn) in rings.iter().zip(&located).zip(&drawn) {
            let alone = single.locate(&frame, ring);
            prop_assert_eq!(located, &alone, "{:?}", drawn);
            let is_odd = !matches!(drawn.odd, Odd::Nothing | Odd::FaceOn | Odd::OfACode);
            prop_assert!(is_odd || alone.is_ok(), "{:?}: {:?}", drawn, alone);
        }
    }
}
