//! Renders the coverage of the picture as text below the spinner.

use roundel_core::calib::lens::{Coverage, MIN_ZONE_SIGHTINGS, Side, ZONES};

/// The picture's zones, and beside them the sides of the board that have been tilted towards the camera.
pub(super) fn render(coverage: &Coverage) -> String {
    let side = |wanted: Side| {
        let is_done = coverage.sides().iter().any(|&(side, is_done)| side == wanted && is_done);
        format!("{} {wanted}", if is_done { "█" } else { "·" })
    };
    let nearer = [
        format!("nearer side: {}", side(Side::Upper)),
        format!("             {}   {}", side(Side::Left), side(Side::Right)),
        format!("             {}", side(Side::Lower)),
    ];
    let rows = coverage.zones().chunks(ZONES.0).zip(nearer);
    let row = |(zones, nearer): (&[usize], String)| {
        let zone = |&count: &usize| match count {
            0 => "···",
            1..MIN_ZONE_SIGHTINGS => "▒▒▒",
            _ => "███",
        };
        let zones: Vec<&str> = zones.iter().map(zone).collect();
        format!("  {}   {nearer}", zones.join(" "))
    };
    rows.map(row).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;
    use roundel_core::{
        calib::{
            checkerboard::Checkerboard,
            lens::{Sighting, Target, View, ViewSelector, ViewVerdict},
        },
        camera::PixelPoint,
    };

    use super::*;

    /// A chessboard in the top left of a picture of 900 x 600, its right side nearer.
    fn view() -> View {
        let board = Checkerboard::new((9, 6), 0.025).unwrap();
        let sightings = (0..54).map(|index| {
            let (column, row) = (index % 9, index / 9);
            let at = Point2::new(column as f64 - 4.0, row as f64 - 2.5);
            let depth = 1.0 - 0.012 * at.x;
            let center =
                PixelPoint { u: 150.0 + 18.0 * at.x / depth, v: 120.0 + 18.0 * at.y / depth };
            Sighting { number: board.number(column, row).unwrap(), center, radius_px: 9.0 }
        });
        let mut sightings: Vec<_> = sightings.collect();
        sightings.sort_by_key(|sighting| sighting.number);
        View { sightings, ..View::default() }
    }

    #[test]
    fn zones_and_sides_that_are_done_are_filled() {
        let target = Target::from(Checkerboard::new((9, 6), 0.025).unwrap());
        let mut selector = ViewSelector::new(target, (900, 600), false);
        let empty = render(selector.coverage());
        assert_eq!(empty.lines().count(), 3);
        assert!(!empty.contains('█') && empty.contains("· right"), "{empty}");
        assert_eq!(selector.offer(view()), ViewVerdict::Taken);
        let text = render(selector.coverage());
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].starts_with("  ███ ··· ···"), "{text}");
        assert!(lines[2].starts_with("  ··· ··· ···"), "{text}");
        assert!(text.contains("█ right") && text.contains("· left"), "{text}");
    }
}
