//! Pages → PDF: outlines as they are, small print in Helvetica, which every reader has.

use pdf_writer::{Content, Finish, Name, Pdf, Rect, Ref, Str};

use super::{
    page::{LINE_MM, Page, Shape, TextAnchor},
    path::{Path, Place, Step},
};

/// Points of PDF, of which 72 are an inch, to a millimetre.
const POINTS: f64 = 72.0 / 25.4;
/// Height of Helvetica's capitals and mean width of its letters, over the size of the font.
const CAPITAL: f64 = 0.718;
const LETTER: f64 = 0.5;

/// The file's bytes.
pub fn pdf(pages: &[Page], title: &str) -> Vec<u8> {
    let mut pdf = Pdf::new();
    let (catalog, tree, font, info) = (Ref::new(1), Ref::new(2), Ref::new(3), Ref::new(4));
    let page_id = |index: usize| Ref::new(5 + 2 * index as i32);
    let content_id = |index: usize| Ref::new(6 + 2 * index as i32);

    let mut root = pdf.catalog(catalog);
    root.pages(tree);
    // Or the reader would fit the page to what the printer can reach.
    root.viewer_preferences().pair(Name(b"PrintScaling"), Name(b"None"));
    root.finish();
    let ids = (0..pages.len()).map(page_id);
    pdf.pages(tree).kids(ids).count(pages.len() as i32);
    pdf.type1_font(font)
        .base_font(Name(b"Helvetica"))
        .encoding_predefined(Name(b"WinAnsiEncoding"));
    pdf.document_info(info)
        .title(pdf_writer::TextStr(title))
        .producer(pdf_writer::TextStr(concat!("roundel ", env!("CARGO_PKG_VERSION"))));
    for (index, page) in pages.iter().enumerate() {
        let size = page.size;
        let mut written = pdf.page(page_id(index));
        written.parent(tree).contents(content_id(index)).media_box(Rect::new(
            0.0,
            0.0,
            (size.width_mm * POINTS) as f32,
            (size.height_mm * POINTS) as f32,
        ));
        written.resources().fonts().pair(Name(b"F"), font);
        written.finish();
        pdf.stream(content_id(index), &content(page));
    }
    pdf.finish()
}

fn content(page: &Page) -> Vec<u8> {
    let height_mm = page.size.height_mm;
    let at = |place: Place| ((place.x * POINTS) as f32, ((height_mm - place.y) * POINTS) as f32);
    let mut content = Content::new();
    content.save_state();
    let mut window = Path::default();
    window.add_rectangle(&page.window);
    draw(&mut content, &window, at);
    content.clip_nonzero().end_path();
    for print in &page.prints {
        draw(&mut content, print, at);
        content.fill_even_odd();
    }
    content.restore_state();
    content.set_line_width((LINE_MM * POINTS) as f32);
    for mark in &page.marks {
        match mark {
            Shape::Line { from, to } => {
                let (from, to) = (at(*from), at(*to));
                content.move_to(from.0, from.1).line_to(to.0, to.1).stroke();
            }
            Shape::Text { at: place, anchor, height_mm, text } => {
                let size_mm = height_mm / CAPITAL;
                let width_mm = text.chars().count() as f64 * LETTER * size_mm;
                let shift = match anchor {
                    TextAnchor::Begin => 0.0,
                    TextAnchor::Middle => -width_mm / 2.0,
                    TextAnchor::End => -width_mm,
                };
                let (x, y) = at(place.moved(shift, 0.0));
                content.begin_text().set_font(Name(b"F"), (size_mm * POINTS) as f32);
                content.next_line(x, y).show(Str(&latin(text))).end_text();
            }
        }
    }
    content.finish().into_vec()
}

fn draw(content: &mut Content, path: &Path, at: impl Fn(Place) -> (f32, f32)) {
    for step in &path.steps {
        match *step {
            Step::Move(place) => {
                let (x, y) = at(place);
                content.move_to(x, y);
            }
            Step::Line(place) => {
                let (x, y) = at(place);
                content.line_to(x, y);
            }
            Step::Cubic(one, other, end) => {
                let ((x1, y1), (x2, y2), (x3, y3)) = (at(one), at(other), at(end));
                content.cubic_to(x1, y1, x2, y2, x3, y3);
            }
            Step::Close => {
                content.close_path();
            }
        }
    }
}

/// A text in the font's encoding; what it has no letter for is a question mark.
fn latin(text: &str) -> Vec<u8> {
    text.chars().map(|letter| u8::try_from(u32::from(letter)).unwrap_or(b'?')).collect()
}
