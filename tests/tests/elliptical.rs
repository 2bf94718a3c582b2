//! Roundels with elliptical discs: detection, distinction from each other and from plain ones, and pose with heading.
//! `-- --nocapture` prints the table.

use roundel_core::marker::Polarity;
use roundel_tests::elliptical::{Case, Score, run};

/// Bars of a case.
struct Bar {
    diameters_px: (f64, f64),
    tilts_deg: (f64, f64),
    /// Maximum share of roundels that are missed, and of those detected as another elliptical kind.
    missed: f64,
    confused: f64,
    /// Fast, precise.
    modes: [Reach; 2],
}

/// Bars of a mode.
struct Reach {
    /// Rms error of the heading.
    heading_deg: f64,
    /// The same relative to the Cramér-Rao bound.
    heading_over_bound: f64,
    /// Shares inside the stated 95 % ellipsoids, of positions and of rotations.
    shares: (f64, f64),
}

const fn reach(heading_deg: f64, heading_over_bound: f64, shares: (f64, f64)) -> Reach {
    Reach { heading_deg, heading_over_bound, shares }
}

const BARS: [Bar; 4] = [
    Bar {
        diameters_px: (12.0, 20.0),
        tilts_deg: (0.0, 40.0),
        missed: 0.01,
        confused: 0.05,
        modes: [reach(1.3, 4.0, (0.9, 0.9)), reach(0.6, 1.8, (0.89, 0.88))],
    },
    Bar {
        diameters_px: (20.0, 30.0),
        tilts_deg: (0.0, 60.0),
        missed: 0.0,
        confused: 0.01,
        modes: [reach(0.8, 3.5, (0.8, 0.82)), reach(0.3, 1.5, (0.91, 0.9))],
    },
    Bar {
        diameters_px: (30.0, 50.0),
        tilts_deg: (0.0, 60.0),
        missed: 0.0,
        confused: 0.0,
        modes: [reach(0.2, 2.2, (0.86, 0.84)), reach(0.12, 1.3, (0.88, 0.9))],
    },
    Bar {
        diameters_px: (50.0, 110.0),
        tilts_deg: (0.0, 60.0),
        missed: 0.0,
        confused: 0.0,
        modes: [reach(0.08, 2.0, (0.88, 0.92)), reach(0.05, 1.3, (0.92, 0.91))],
    },
];

#[test]
fn black_elliptical_rings_are_found_distinguished_and_located() {
    BARS.iter().for_each(|bar| check(bar, Polarity::BlackRing, 300));
}

#[test]
fn white_elliptical_rings_are_found_distinguished_and_located() {
    BARS[1..].iter().for_each(|bar| check(bar, Polarity::WhiteRing, 300));
}

fn check(bar: &Bar, polarity: Polarity, count: usize) {
    let Bar { diameters_px, tilts_deg, .. } = *bar;
    let score = run(&Case { diameters_px, tilts_deg, polarity }, count);
    let Score { shown, found, confused, .. } = score;
    let case = format!("{polarity:?}, {diameters_px:?} px, {tilts_deg:?}°");
    println!("{case}: {found} of {shown} found, {confused} detected as another elliptical kind");
    let share = |part: usize| part as f64 / shown as f64;
    assert!(share(shown - found) <= bar.missed, "{case}: missed {:?}", score.missed);
    assert_eq!((score.false_rings, score.plain_confused), (0, 0), "{case}");
    assert!(share(confused) <= bar.confused, "{case}: {confused} confused");
    for (index, mode) in ["fast", "precise"].into_iter().enumerate() {
        let (errors, reach) = (&score.modes[index], &bar.modes[index]);
        let (positions, rotations) = errors.shares();
        let heading_deg = errors.heading_deg();
        println!(
            "  {mode:7} heading {heading_deg:.3}°, {:.2} of stated, {:.2} of the bound, at most \
             {:.2}°; depth {:.2} of the bound; normal {:.2}°, {} mirrored, {} by its own means; inside {positions:.3} and \
             {rotations:.3}, plain {:.3}",
            errors.heading_over_stated(),
            errors.heading_over_bound(),
            errors.heading_max_deg(),
            errors.depth_over_bound(),
            errors.normal_median_deg(),
            errors.wrong_normals,
            errors.own,
            errors.plain_share(),
        );
        let case = format!("{case} {mode}");
        let over_bound = errors.heading_over_bound();
        assert!(heading_deg <= reach.heading_deg, "{case}: heading {heading_deg}°");
        assert!(over_bound <= reach.heading_over_bound, "{case}: {over_bound} of the bound");
        assert!(positions >= reach.shares.0, "{case}: {positions} of the positions inside");
        assert!(rotations >= reach.shares.1, "{case}: {rotations} of the rotations inside");
    }
}
