//! A map as a picture: from above, x to the right and y upwards, with the cameras in it and a scale of colours.
//!
//! SVG and PNG are drawn from one list of shapes, in pixels.

use std::io;

use svg::{
    Document,
    node::element::{Circle, Line, Rectangle, Text},
};
use tiny_skia::{FillRule, Paint, PathBuilder, PixmapMut, Rect, Stroke, Transform};

use super::{
    color_scale::{ColorScale, color_at, nice_step},
    plan_map::PlanMap,
};
use crate::lab::drawing::glyph;

/// Room for the map itself, pixels.
const MAP_SIZE_PX: [f64; 2] = [760.0, 620.0];
/// About the map: left, above, right, below.
const MARGIN_PX: [f64; 4] = [64.0, 44.0, 176.0, 48.0];
const LETTER_PX: f64 = 10.0;
/// Where no camera sees anything.
const UNSEEN: [u8; 3] = [214, 214, 214];
/// What the colours say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum MapLayer {
    /// How exactly a roundel would be located
    #[default]
    Precision,
    /// How many cameras would see it
    Cameras,
}

enum MapShape {
    Area { at: [f64; 2], size: [f64; 2], colour: [u8; 3] },
    Line { from: [f64; 2], to: [f64; 2] },
    Dot { at: [f64; 2] },
    Text { at: [f64; 2], text: String, has_halo: bool },
}

struct MapDrawing {
    size: [f64; 2],
    shapes: Vec<MapShape>,
}

pub fn svg(map: &PlanMap, show: MapLayer) -> String {
    let MapDrawing { size, shapes } = MapDrawing::of(map, show);
    let paper = Rectangle::new().set("width", size[0]).set("height", size[1]).set("fill", "white");
    let mut document = Document::new()
        .set("width", size[0])
        .set("height", size[1])
        .set("viewBox", (0.0, 0.0, size[0], size[1]))
        .set("font-family", "Helvetica, Arial, sans-serif")
        .set("font-size", 1.3 * LETTER_PX)
        .add(paper);
    for shape in shapes {
        document = match shape {
            MapShape::Area { at, size, colour: [red, green, blue] } => document.add(
                Rectangle::new()
                    .set("x", rounded(at[0]))
                    .set("y", rounded(at[1]))
                    .set("width", rounded(size[0]))
                    .set("height", rounded(size[1]))
                    .set("fill", format!("#{red:02x}{green:02x}{blue:02x}"))
                    // No seams between areas, as in the PNG.
                    .set("shape-rendering", "crispEdges"),
            ),
            MapShape::Line { from, to } => document.add(
                Line::new()
                    .set("x1", rounded(from[0]))
                    .set("y1", rounded(from[1]))
                    .set("x2", rounded(to[0]))
                    .set("y2", rounded(to[1]))
                    .set("stroke", "black"),
            ),
            MapShape::Dot { at } => document.add(
                Circle::new()
                    .set("cx", rounded(at[0]))
                    .set("cy", rounded(at[1]))
                    .set("r", 4)
                    .set("fill", "white")
                    .set("stroke", "black"),
            ),
            MapShape::Text { at, text, has_halo } => {
                let text = Text::new(text).set("x", rounded(at[0])).set("y", rounded(at[1]));
                document.add(if has_halo {
                    text.set("stroke", "white").set("stroke-width", 3).set("paint-order", "stroke")
                } else {
                    text
                })
            }
        };
    }
    document.to_string()
}

pub fn png(map: &PlanMap, show: MapLayer) -> io::Result<Vec<u8>> {
    let drawing = MapDrawing::of(map, show);
    let [width, height] = drawing.size.map(|side| side.round() as u32);
    let failed = || io::Error::other("expected a picture of a drawable size, found another");
    let mut data = vec![255; 4 * width as usize * height as usize];
    let mut pixmap = PixmapMut::from_bytes(&mut data, width, height).ok_or_else(failed)?;
    for shape in &drawing.shapes {
        paint(&mut pixmap, shape);
    }
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgba);
    let mut writer = encoder.write_header().map_err(io::Error::other)?;
    writer.write_image_data(&data).map_err(io::Error::other)?;
    writer.finish().map_err(io::Error::other)?;
    Ok(bytes)
}

fn paint(pixmap: &mut PixmapMut<'_>, shape: &MapShape) {
    let ink = |[red, green, blue]: [u8; 3], anti_alias: bool| {
        let mut paint = Paint { anti_alias, ..Paint::default() };
        paint.set_color_rgba8(red, green, blue, 255);
        paint
    };
    let (black, straight) = (ink([0; 3], true), Transform::identity());
    let mut fill = |area: Option<Rect>, paint: &Paint<'_>| {
        if let Some(area) = area {
            pixmap.fill_rect(area, paint, straight, None);
        }
    };
    match shape {
        MapShape::Area { at, size, colour } => {
            // Whole pixels, so that no seams are left between areas.
            let [left, top] = at.map(|side| side.round() as f32);
            let ends = [0, 1].map(|axis| (at[axis] + size[axis]).round() as f32);
            fill(Rect::from_ltrb(left, top, ends[0], ends[1]), &ink(*colour, false));
        }
        MapShape::Text { at, text, has_halo } => {
            let dot = 0.2 * LETTER_PX;
            let advance = (glyph::COLUMNS + 1) as f64 * dot;
            if *has_halo {
                let [x, y] = [at[0] - dot, at[1] - LETTER_PX - dot].map(|edge| edge as f32);
                let wide = (text.chars().count() as f64 * advance + dot) as f32;
                let high = (LETTER_PX + 2.0 * dot) as f32;
                fill(Rect::from_xywh(x, y, wide, high), &ink([255; 3], false));
            }
            for (place, character) in text.chars().enumerate() {
                let left = at[0] + place as f64 * advance;
                for (row, bits) in glyph::rows(character).into_iter().enumerate() {
                    for column in 0..glyph::COLUMNS {
                        if bits >> (glyph::COLUMNS - 1 - column) & 1 == 1 {
                            let x = (left + column as f64 * dot) as f32;
                            let y = (at[1] - LETTER_PX + row as f64 * dot) as f32;
                            fill(Rect::from_xywh(x, y, dot as f32, dot as f32), &black);
                        }
                    }
                }
            }
        }
        MapShape::Line { from, to } => {
            let mut line = PathBuilder::new();
            line.move_to(from[0] as f32, from[1] as f32);
            line.line_to(to[0] as f32, to[1] as f32);
            if let Some(line) = line.finish() {
                pixmap.stroke_path(&line, &black, &Stroke::default(), straight, None);
            }
        }
        MapShape::Dot { at } => {
            if let Some(dot) = PathBuilder::from_circle(at[0] as f32, at[1] as f32, 4.0) {
                pixmap.fill_path(&dot, &ink([255; 3], true), FillRule::Winding, straight, None);
                pixmap.stroke_path(&dot, &black, &Stroke::default(), straight, None);
            }
        }
    }
}

/// Hundredths of a pixel are enough.
fn rounded(px: f64) -> f64 {
    (px * 100.0).round() / 100.0
}

impl MapDrawing {
    fn of(map: &PlanMap, show: MapLayer) -> Self {
        let sides_m = [0, 1].map(|axis| (map.max_m[axis] - map.min_m[axis]).max(1e-6));
        let scale = (MAP_SIZE_PX[0] / sides_m[0]).min(MAP_SIZE_PX[1] / sides_m[1]);
        let extent = sides_m.map(|side| (side * scale).max(8.0));
        let [left, above, right, below] = MARGIN_PX;
        let size = [left + extent[0] + right, (above + extent[1] + below).max(320.0)];
        let mut drawing = Self { size, shapes: Vec::new() };
        let colours = ColorScale::of(map, show);
        drawing.add_spots(map, show, &colours, extent);
        let place = |at: [f64; 2]| {
            [
                left + (at[0] - map.min_m[0]) / sides_m[0] * extent[0],
                above + (map.max_m[1] - at[1]) / sides_m[1] * extent[1],
            ]
        };
        drawing.add_axes(map, &place);
        drawing.add_cameras(map, &place);
        drawing.add_scale(&colours, show, left + extent[0] + 24.0);
        let title = match show {
            MapLayer::Precision => format!("rms error of {} at {} m", map.roundel, map.height_m),
            MapLayer::Cameras => format!("cameras that see {} at {} m", map.roundel, map.height_m),
        };
        drawing.add_text([left, above - 18.0], title);
        drawing
    }

    fn add_text(&mut self, at: [f64; 2], text: impl Into<String>) {
        self.shapes.push(MapShape::Text { at, text: text.into(), has_halo: false });
    }

    fn add_spots(&mut self, map: &PlanMap, show: MapLayer, colours: &ColorScale, extent: [f64; 2]) {
        let colour = |index: usize| match (show, map.cameras[index], map.deviation_m[index]) {
            (MapLayer::Cameras, count @ 1.., _) => colours.colour(count as f64),
            (MapLayer::Precision, _, Some(deviation_m)) => colours.colour(deviation_m),
            _ => UNSEEN,
        };
        let (wide, high) = (extent[0] / map.columns as f64, extent[1] / map.rows as f64);
        for row in 0..map.rows {
            // y grows upwards.
            let top = MARGIN_PX[1] + (map.rows - 1 - row) as f64 * high;
            let mut begun = 0;
            for column in 1..=map.columns {
                let index = row * map.columns + column;
                let before = colour(index - 1);
                if column == map.columns || colour(index) != before {
                    let at = [MARGIN_PX[0] + begun as f64 * wide, top];
                    let size = [(column - begun) as f64 * wide, high];
                    self.shapes.push(MapShape::Area { at, size, colour: before });
                    begun = column;
                }
            }
        }
    }

    fn add_axes(&mut self, map: &PlanMap, place: &impl Fn([f64; 2]) -> [f64; 2]) {
        let (low, high) = (map.min_m, map.max_m);
        let corners = [low, [high[0], low[1]], high, [low[0], high[1]], low].map(place);
        for pair in corners.windows(2) {
            self.shapes.push(MapShape::Line { from: pair[0], to: pair[1] });
        }
        let step_m = nice_step((high[0] - low[0]).max(high[1] - low[1]) / 8.0);
        for axis in 0..2 {
            let mut mark = (low[axis] / step_m).ceil() * step_m;
            while mark <= high[axis] + 1e-9 {
                // Nothing is -0.
                let text = format!("{}", (mark * 1e3).round() / 1e3 + 0.0);
                let mut at = low;
                at[axis] = mark;
                let from = place(at);
                let (to, label) = if axis == 0 {
                    ([from[0], from[1] + 6.0], [from[0] - 6.0, from[1] + 22.0])
                } else {
                    ([from[0] - 6.0, from[1]], [from[0] - 44.0, from[1] + 5.0])
                };
                self.shapes.push(MapShape::Line { from, to });
                self.add_text(label, text);
                mark += step_m;
            }
        }
        let [x, y] = place([high[0], low[1]]);
        self.add_text([x - 20.0, y + 40.0], "x, m");
        let [x, y] = place([low[0], high[1]]);
        self.add_text([x - 60.0, y - 18.0], "y, m");
    }

    fn add_cameras(&mut self, map: &PlanMap, place: &impl Fn([f64; 2]) -> [f64; 2]) {
        for station in &map.stations {
            let Some([x, y, _]) = station.position_m else { continue };
            let is_inside = (map.min_m[0]..=map.max_m[0]).contains(&x)
                && (map.min_m[1]..=map.max_m[1]).contains(&y);
            if is_inside {
                let at = place([x, y]);
                self.shapes.push(MapShape::Dot { at });
                let at = [at[0] + 8.0, at[1] + 4.0];
                self.shapes.push(MapShape::Text { at, text: station.name.clone(), has_halo: true });
            }
        }
    }

    fn add_scale(&mut self, colours: &ColorScale, show: MapLayer, left: f64) {
        const STEPS: usize = 48;
        const HIGH: f64 = 200.0;
        let top = MARGIN_PX[1];
        for step in 0..STEPS {
            let share = step as f64 / (STEPS - 1) as f64;
            let at = [left, top + HIGH * step as f64 / STEPS as f64];
            let size = [16.0, HIGH / STEPS as f64 + 0.5];
            self.shapes.push(MapShape::Area { at, size, colour: color_at(share) });
        }
        let marks = colours.marks();
        for (place, mark) in marks.iter().enumerate() {
            let share = place as f64 / (marks.len() - 1) as f64;
            self.add_text([left + 22.0, top + 5.0 + HIGH * share], &mark.text);
        }
        let at = [left, top + HIGH + 16.0];
        self.shapes.push(MapShape::Area { at, size: [16.0, 16.0], colour: UNSEEN });
        self.add_text([left + 22.0, at[1] + 12.0], "unseen");
        if show == MapLayer::Precision {
            for (line, text) in ["%: of what is", "seen, better"].into_iter().enumerate() {
                self.add_text([left, at[1] + 40.0 + 18.0 * line as f64], text);
            }
        }
    }
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

    #[test]
    fn a_map_becomes_svg_with_axes_cameras_and_scale() {
        for show in [MapLayer::Precision, MapLayer::Cameras] {
            let text = svg(&map(), show);
            for part in ["north", "unseen", "x, m", "#d6d6d6", "<circle"] {
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
