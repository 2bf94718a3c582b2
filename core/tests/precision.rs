//! Accuracy of found rims against drawn ones, by size, tilt, blur and noise. `cargo bench -p roundel-core --bench
//! precision` prints the whole table.

use crate::rim_error::{Case, cases, measure, print_head, print_row};

/// Maximum bias of the size, relative, and rms of the outer centre, pixels, of a picture.
fn bounds(case: &Case) -> (f64, f64) {
    let sharp = case.blur_px < 1.0;
    let bias = match (case.diameter_px, case.tilt_deg) {
        (d, _) if d < 20.0 => 0.04,
        (d, t) if d < 40.0 && t > 50.0 => 0.025,
        (d, _) if d < 30.0 => 0.008,
        (_, t) if t > 50.0 => 0.0025,
        _ => 0.0015,
    };
    let center = 1.2 / case.diameter_px;
    if sharp { (0.5 * bias, 0.5 * center) } else { (bias, center) }
}

#[test]
fn rims_are_accurate_to_a_fraction_of_a_pixel() {
    print_head();
    for case in cases(&[12.0, 16.0, 20.0, 30.0, 41.0, 81.0], 1.4, true) {
        let cell = measure(&case, 8);
        print_row(&case, &cell);
        let (bias, center) = bounds(&case);
        assert_eq!(cell.missed, 0);
        assert!(cell.size.bias().abs() < bias, "size: expected a bias below {bias}");
        assert!(cell.center.rms() < center, "centre: expected below {center} px");
    }
}

#[test]
fn a_narrow_margin_costs_precision_but_not_the_ring() {
    print_head();
    for case in cases(&[16.0, 30.0, 41.0, 81.0], 1.15, true) {
        let cell = measure(&case, 4);
        print_row(&case, &cell);
        // At 60°, a margin of 0.3 to 1 px remains beside the smaller ones.
        if case.tilt_deg < 50.0 || case.diameter_px > 40.0 {
            assert!(cell.missed <= 1);
            assert!(cell.size.rms() < 0.16 / case.diameter_px.sqrt() / 2.0);
        }
    }
}
