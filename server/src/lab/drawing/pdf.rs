//! Drawings as the pages of a PDF, with text in Helvetica, one of the standard fonts.

use kurbo::{Affine, BezPath, PathEl, Shape as _};
use pdf_writer::{Content, Finish, Name, Pdf, Rect, Ref, Str, TextStr};

use super::{CAPITAL, Color, Drawing, Shape, TOLERANCE};

/// Units of PDF, 72 per inch, in a millimetre.
const POINTS: f64 = 72.0 / 25.4;
/// Mean width of a Helvetica letter over the font size.
const LETTER: f64 = 0.5;

/// A PDF of drawings in millimetres, printed at their size.
pub(crate) fn pdf(pages: impl ExactSizeIterator<Item = Drawing>, title: &str) -> Vec<u8> {
    let mut pdf = Pdf::new();
    let (catalog, tree, font, info) = (Ref::new(1), Ref::new(2), Ref::new(3), Ref::new(4));
    let ids = |index: i32| (Ref::new(5 + 2 * index), Ref::new(6 + 2 * index));

    let mut root = pdf.catalog(catalog);
    root.pages(tree);
    // Otherwise viewers scale the page to the printable area.
    root.viewer_preferences().pair(Name(b"PrintScaling"), Name(b"None"));
    root.finish();
    let count = pages.len() as i32;
    pdf.pages(tree).kids((0..count).map(|index| ids(index).0)).count(count);
    pdf.type1_font(font)
        .base_font(Name(b"Helvetica"))
        .encoding_predefined(Name(b"WinAnsiEncoding"));
    pdf.document_info(info)
        .title(TextStr(title))
        .producer(TextStr(concat!("roundel ", env!("CARGO_PKG_VERSION"))));
    for (drawing, index) in pages.zip(0..) {
        let (page, content) = ids(index);
        let size = drawing.size * POINTS;
        let mut written = pdf.page(page);
        written.parent(tree).contents(content);
        written.media_box(Rect::new(0.0, 0.0, size.width as f32, size.height as f32));
        written.resources().fonts().pair(Name(b"F"), font);
        written.finish();
        pdf.stream(content, &operators(&drawing));
    }
    pdf.finish()
}

fn operators(drawing: &Drawing) -> Vec<u8> {
    // PDF coordinates begin at the lower left corner.
    let points_from_mm = Affine::scale_non_uniform(POINTS, -POINTS)
        .then_translate((0.0, drawing.size.height * POINTS).into());
    let mut content = Content::new();
    let draw = |content: &mut Content, path: &BezPath| draw(content, points_from_mm * path);
    for shape in &drawing.shapes {
        match shape {
            Shape::Fill { path, color } => {
                set_color(&mut content, *color);
                draw(&mut content, path);
                content.fill_even_odd();
            }
            Shape::Line { path, width, color } => {
                set_color(&mut content, *color);
                content.set_line_width((width * POINTS) as f32);
                draw(&mut content, path);
                content.stroke();
            }
            Shape::Clipped { window, paths } => {
                set_color(&mut content, super::BLACK);
                content.save_state();
                draw(&mut content, &window.to_path(TOLERANCE));
                content.clip_nonzero().end_path();
                for path in paths {
                    draw(&mut content, path);
                    content.fill_even_odd();
                }
                content.restore_state();
            }
            Shape::Text { at, anchor, height, text, color } => {
                set_color(&mut content, *color);
                let size = height / CAPITAL;
                let width = text.chars().count() as f64 * LETTER * size;
                let at = points_from_mm * (*at - (anchor.share() * width, 0.0));
                content.begin_text().set_font(Name(b"F"), (size * POINTS) as f32);
                content.next_line(at.x as f32, at.y as f32).show(Str(&latin(text))).end_text();
            }
        }
    }
    content.finish().into_vec()
}

/// Grey uses the grey colour space, so that printers use only black ink.
fn set_color(content: &mut Content, color: Color) {
    let [red, green, blue] = color.map(|level| f32::from(level) / 255.0);
    if red == green && green == blue {
        content.set_fill_gray(red).set_stroke_gray(red);
    } else {
        content.set_fill_rgb(red, green, blue).set_stroke_rgb(red, green, blue);
    }
}

fn draw(content: &mut Content, path: BezPath) {
    for element in path {
        match element {
            PathEl::MoveTo(to) => content.move_to(to.x as f32, to.y as f32),
            PathEl::LineTo(to) => content.line_to(to.x as f32, to.y as f32),
            PathEl::CurveTo(p, q, to) => {
                let [px, py, qx, qy] = [p.x, p.y, q.x, q.y].map(|it| it as f32);
                content.cubic_to(px, py, qx, qy, to.x as f32, to.y as f32)
            }
            PathEl::ClosePath => content.close_path(),
            PathEl::QuadTo(..) => unreachable!("paths consist of lines and cubic curves"),
        };
    }
}

/// A text in the font's encoding, with question marks for missing characters.
fn latin(text: &str) -> Vec<u8> {
    text.chars().map(|letter| u8::try_from(u32::from(letter)).unwrap_or(b'?')).collect()
}
