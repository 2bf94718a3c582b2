//! A map as a picture: seen from above, x to the right and y upwards, with the cameras and a colour scale.

use std::io;

use kurbo::{Circle, Point, Rect, Size};

use super::{
    color_scale::{ColorScale, color_at},
    plan_map::{MapLayer, PlanMap},
};
use crate::lab::drawing::{Anchor, Axes, BLACK, Drawing, LETTER_PX, Shape, WHITE, text_width};

/// Largest size of the map itself, pixels.
const MAP_PX: Size = Size::new(760.0, 620.0);
/// Margins of the map: left, above, right, below.
const MARGIN_PX: [f64; 4] = [64.0, 44.0, 176.0, 48.0];
/// Colour of spots that no camera sees.
const UNSEEN: [u8; 3] = [214, 214, 214];

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum MapFormat {
    Json,
    Svg,
    Png,
}

impl MapFormat {
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Svg => "image/svg+xml",
            Self::Png => "image/png",
        }
    }
}

/// Encodes the map. A picture shows the layer `show`.
pub fn encode(map: &PlanMap, format: MapFormat, show: MapLayer) -> io::Result<Vec<u8>> {
    Ok(match format {
        MapFormat::Json => serde_json::to_vec(map)?,
        MapFormat::Svg => drawing(map, show).svg("px").into_bytes(),
        MapFormat::Png => png(map, show)?,
    })
}

fn png(map: &PlanMap, show: MapLayer) -> io::Result<Vec<u8>> {
    let drawing = drawing(map, show);
    let (width, height) = (drawing.size.width.round(), drawing.size.height.round());
    let data = drawing.rgba(1.0, width as usize, 0..height as usize);
    let data = data.ok_or_else(|| io::Error::other("cannot draw a picture of this size"))?;
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgba);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&data)?;
    writer.finish()?;
    Ok(bytes)
}

fn drawing(map: &PlanMap, show: MapLayer) -> Drawing {
    let sides_m = [0, 1].map(|axis| (map.max_m[axis] - map.min_m[axis]).max(1e-6));
    let scale = (MAP_PX.width / sides_m[0]).min(MAP_PX.height / sides_m[1]);
    let [width, height] = sides_m.map(|side| (side * scale).max(8.0));
    let [left, above, right, below] = MARGIN_PX;
    let axes = Axes {
        area: Rect::from_origin_size((left, above), (width, height)),
        x: map.min_m[0]..map.min_m[0] + sides_m[0],
        y: map.min_m[1]..map.min_m[1] + sides_m[1],
    };
    let colours = ColorScale::of(map, show);
    let mut shapes = spots(map, show, &colours, axes.area);
    shapes.extend(axes.frame(["x, m", "y, m"]));
    shapes.extend(cameras(map, &axes));
    shapes.extend(legend(&colours, show, axes.area.x1 + 24.0));
    let title = match show {
        MapLayer::Precision => format!("rms error of {} at {} m", map.roundel, map.height_m),
        MapLayer::Cameras => format!("cameras that see {} at {} m", map.roundel, map.height_m),
    };
    shapes.push(label(left, above - 18.0, title));
    let size = Size::new(left + width + right, (above + height + below).max(320.0));
    Drawing { size, shapes }
}

fn label(x: f64, y: f64, text: impl Into<String>) -> Shape {
    Shape::text(Point::new(x, y), Anchor::Start, LETTER_PX, text)
}

fn spots(map: &PlanMap, show: MapLayer, colours: &ColorScale, area: Rect) -> Vec<Shape> {
    let colour = |index: usize| match (show, map.cameras[index], map.deviation_m[index]) {
        (MapLayer::Cameras, count @ 1.., _) => colours.of_count(count),
        (MapLayer::Precision, _, Some(deviation_m)) => colours.of_deviation(deviation_m),
        _ => UNSEEN,
    };
    let x = |column: usize| area.x0 + area.width() * column as f64 / map.columns as f64;
    let y = |row: usize| area.y1 - area.height() * row as f64 / map.rows as f64;
    let mut shapes = Vec::new();
    for row in 0..map.rows {
        let first = row * map.columns;
        let columns: Vec<usize> = (0..map.columns).collect();
        // Adjacent spots of one colour become one area.
        for run in columns.chunk_by(|one, next| colour(first + one) == colour(first + next)) {
            let (from, to) = (run[0], run[run.len() - 1] + 1);
            // Whole pixels, extended below the areas that are drawn later, so that no seam shows.
            let spot = Rect::new(x(from), y(row + 1), x(to), y(row)).round();
            let spot =
                Rect { x1: (spot.x1 + 0.5).min(area.x1), y0: (spot.y0 - 0.5).max(area.y0), ..spot };
            shapes.push(Shape::fill(spot, colour(first + from)));
        }
    }
    shapes
}

fn cameras(map: &PlanMap, axes: &Axes) -> Vec<Shape> {
    let mut shapes = Vec::new();
    for station in &map.stations {
        let Some([x, y, _]) = station.position_m else { continue };
        let at = axes.point(x, y);
        if axes.area.inflate(0.5, 0.5).contains(at) {
            shapes.push(Shape::fill(Circle::new(at, 4.5), BLACK));
            shapes.push(Shape::fill(Circle::new(at, 3.5), WHITE));
            let corner = at + (6.0, -LETTER_PX / 2.0 - 2.0);
            let size = (text_width(&station.name, LETTER_PX) + 2.0, LETTER_PX + 4.0);
            shapes.push(Shape::fill(Rect::from_origin_size(corner, size), WHITE));
            shapes.push(label(corner.x + 2.0, corner.y + LETTER_PX + 2.0, &station.name));
        }
    }
    shapes
}

/// The colour scale with its values beside it.
fn legend(colours: &ColorScale, show: MapLayer, left: f64) -> Vec<Shape> {
    const STEPS: usize = 48;
    const HEIGHT_PX: f64 = 200.0;
    let top = MARGIN_PX[1];
    let swatch = |y: f64, height: f64, color| {
        Shape::fill(Rect::from_origin_size((left, y), (16.0, height)), color)
    };
    let step_px = HEIGHT_PX / STEPS as f64;
    let mut shapes: Vec<Shape> = (0..STEPS)
        .map(|step| {
            let share = step as f64 / (STEPS - 1) as f64;
            swatch(top + step_px * step as f64, step_px + 0.5, color_at(share))
        })
        .collect();
    for (place, mark) in colours.marks.iter().enumerate() {
        let share = place as f64 / (colours.marks.len() - 1) as f64;
        shapes.push(label(left + 22.0, top + 5.0 + HEIGHT_PX * share, &mark.label));
    }
    let below = top + HEIGHT_PX + 16.0;
    shapes.push(swatch(below, 16.0, UNSEEN));
    shapes.push(label(left + 22.0, below + 12.0, "unseen"));
    if show == MapLayer::Precision {
        shapes.push(label(left, below + 40.0, "%: share of seen"));
        shapes.push(label(left, below + 58.0, "spots with less"));
    }
    shapes
}

#[cfg(test)]
mod tests {
    use super::super::plan_map::{PlanStation, PlanSummary};
    use super::*;

    fn map() -> PlanMap {
        let deviation_m = vec![Some(1e-4), Some(1e-3), None, Some(2e-4), Some(2e-4), Some(5e-4)];
        PlanMap {
            roundel: "robot".into(),
            height_m: 0.3,
            min_m: [-1.0, -0.5],
            max_m: [1.0, 0.5],
            columns: 3,
            rows: 2,
            cameras: vec![2, 1, 0, 3, 3, 1],
            level_m: deviation_m.clone(),
            upright_m: deviation_m.clone(),
            deviation_m,
            summary: PlanSummary {
                seen_share: 0.8,
                twice_share: 0.5,
                median_m: Some(2e-4),
                p95_m: None,
            },
            stations: vec![PlanStation {
                name: "north".into(),
                position_m: Some([0.0, 0.2, 3.0]),
                seen_share: Some(0.8),
                reason: String::new(),
            }],
        }
    }

    fn svg(map: &PlanMap, show: MapLayer) -> String {
        String::from_utf8(encode(map, MapFormat::Svg, show).unwrap()).unwrap()
    }

    #[test]
    fn a_map_becomes_svg_with_axes_cameras_and_scale() {
        for show in [MapLayer::Precision, MapLayer::Cameras] {
            let text = svg(&map(), show);
            // The path of the camera's dot begins at its rightmost point.
            for part in ["north", "unseen", "x, m", "#d6d6d6", "M447.5 158 C"] {
                assert!(text.contains(part), "{part} in {text}");
            }
        }
        assert!(svg(&map(), MapLayer::Precision).contains("0.1 mm 0 %"));
        let text = svg(&PlanMap { min_m: [-0.1, -0.5], ..map() }, MapLayer::Precision);
        assert!(!text.contains("\n-0\n") && text.contains("\n-0.4\n"), "{text}");
    }

    #[test]
    fn a_map_becomes_a_png_of_the_same_size() {
        let bytes = png(&map(), MapLayer::Precision).unwrap();
        let mut reader = png::Decoder::new(io::Cursor::new(&bytes)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        assert_eq!(info.width, (64.0 + 760.0 + 176.0) as u32);
        let at = |x: usize, y: usize| {
            let start = 4 * (y * info.width as usize + x);
            [pixels[start], pixels[start + 1], pixels[start + 2]]
        };
        // The lower left spot is the best one, the lower right one is not seen.
        assert_eq!(at(70, info.height as usize - 60), [253, 231, 37]);
        assert_eq!(at(800, info.height as usize - 60), UNSEEN);
    }
}
