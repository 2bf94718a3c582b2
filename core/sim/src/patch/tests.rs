use std::f32::consts::{PI, TAU};

use super::*;
use crate::albedo::{BLACK, WHITE, normal_cdf};
use roundel_vision::marker::CodeLayout;

#[test]
fn normal_cdf_agrees_with_tabled_values() {
    let table = [(0.0, 0.5), (0.5, 0.691_462_5), (1.0, 0.841_344_7), (2.0, 0.977_249_9)];
    for (x, expected) in table {
        assert!((normal_cdf(x) - expected).abs() < 1e-6, "at {x}: {}", normal_cdf(x));
        assert!((normal_cdf(-x) - (1.0 - expected)).abs() < 1e-6, "at -{x}");
    }
    assert!(normal_cdf(50.0) == 1.0 && normal_cdf(-50.0) < 1e-6);
}

/// Compares a print of 25 px, whose slots are as narrow as the blur at the core, with a numerically blurred sharp
/// print.
#[test]
fn narrow_teeth_have_the_correct_level() {
    const FINE: i32 = 20;
    const BLUR_PX: f32 = 0.7;
    let layout = CodeLayout { bits: 9, min_distance: 1 };
    let word = 0b000_101_101;
    // A pixel is a metre.
    let (outer, inner) = (12.5, 12.5 * CodeLayout::RATIO as f32);
    let core = inner * CodeLayout::CORE_SHARE as f32;
    let teeth = Teeth::new(layout, word, inner);
    let is_black = |x: f32, y: f32| {
        let (radius, slot) = (x.hypot(y), (y.atan2(x).rem_euclid(TAU) * 9.0 / PI) as u32 % 18);
        // The tooth of a 0 is in the first slot of its bit.
        let is_tooth = u32::from(word >> (8 - slot / 2) & 1) == slot % 2;
        (core..outer).contains(&radius) && (radius >= inner || is_tooth)
    };
    let edge = |px: f32| normal_cdf(px / BLUR_PX);
    let fine = |k: i32| 5.0 * ((k as f32 + 0.5) / FINE as f32 - 0.5);
    let weight = |away: f32| edge(away + 0.5) - edge(away - 0.5);
    let blurred = |x: f32, y: f32| {
        let (mut black, mut all) = (0.0, 0.0);
        for (i, j) in (0..FINE * FINE).map(|k| (fine(k % FINE), fine(k / FINE))) {
            let weight = weight(i) * weight(j);
            all += weight;
            black += if is_black(x + i, y + j) { weight } else { 0.0 };
        }
        black / all
    };
    let (mut sum, mut count) = (0.0, 0);
    for (u, v) in (0..21 * 21).map(|k| (k % 21 - 10, k / 21 - 10)) {
        let at = PlanePoint {
            x_m: u as f32 + 0.3,
            y_m: v as f32 - 0.2,
            x_by_px: [1.0, 0.0],
            y_by_px: [0.0, 1.0],
            motion_px: [0.0; 2],
            variance_px2: BLUR_PX * BLUR_PX + 1.0 / 12.0,
        };
        if at.x_m.hypot(at.y_m) < inner + 1.5 {
            let painted = (WHITE - at.coded_albedo(outer, &teeth)) / (WHITE - BLACK);
            sum += (painted - blurred(at.x_m, at.y_m)).powi(2);
            count += 1;
        }
    }
    let off = (sum / count as f32).sqrt();
    assert!(off < 0.008, "{off}");
}
