//! Seeded backgrounds without roundels: floors with tiles, boxes, lines, spots, text, and shapes that resemble a
//! roundel ([`crate::look_alikes`]).
//!
//! Shapes are painted in the image, as sharp as everything else.

use nalgebra::Vector2;

use crate::{
    coverage::{Contour, Patch},
    look_alikes::LookAlike,
    random::Random,
    render::{Canvas, Renderer},
};

/// Number of shapes of each type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clutter {
    /// Filled boxes, turned at random.
    pub boxes: usize,
    /// Thin lines across much of the image.
    pub lines: usize,
    /// Discs and ellipses of one grey.
    pub discs: usize,
    /// Lines of letter-like strokes and dots.
    pub words: usize,
    /// Dark rings on pale labels whose discs are too large for the roundels here (0.6 to 0.8 of the ring), from the
    /// size of a letter o to that of a roundel.
    pub rings: usize,
    /// Shapes that resemble a roundel of 8 to 120 px, of any ratio of diameters.
    pub look_alikes: usize,
}

impl Clutter {
    /// A lab's floor with objects on it.
    pub const LAB: Clutter =
        Clutter { boxes: 25, lines: 12, discs: 25, words: 8, rings: 0, look_alikes: 0 };
    /// Dense clutter with many near misses.
    pub const JUNK: Clutter =
        Clutter { boxes: 60, lines: 25, discs: 60, words: 25, rings: 0, look_alikes: 120 };
}

/// An even floor of grey level `floor` with `clutter` on it.
pub fn background(
    renderer: &Renderer,
    floor: f64,
    clutter: &Clutter,
    random: &mut Random,
) -> Canvas {
    let (width, height) = (renderer.camera.width, renderer.camera.height);
    let mut painter = Painter { renderer, canvas: Canvas::flat(width, height, floor), random };
    for _ in 0..clutter.boxes {
        let (center, grey) = (painter.place(), painter.grey());
        let half = [painter.random.uniform(3.0, 60.0), painter.random.uniform(3.0, 60.0)];
        let angle = painter.random.uniform(0.0, std::f64::consts::PI);
        painter.turned_box(center, half, angle, grey);
    }
    for _ in 0..clutter.lines {
        let (center, grey) = (painter.place(), painter.grey());
        let half = [painter.random.uniform(50.0, 500.0), painter.random.uniform(0.4, 2.5)];
        let angle = painter.random.uniform(0.0, std::f64::consts::PI);
        painter.turned_box(center, half, angle, grey);
    }
    for _ in 0..clutter.discs {
        let (center, grey) = (painter.place(), painter.grey());
        let long = painter.random.uniform(2.0, 40.0);
        let short = long * painter.random.uniform(0.4, 1.0);
        painter.disc(center, [long, short], grey);
    }
    for _ in 0..clutter.words {
        painter.word();
    }
    for _ in 0..clutter.rings {
        painter.ring();
    }
    for _ in 0..clutter.look_alikes {
        painter.decoy();
    }
    painter.canvas
}

struct Painter<'a> {
    renderer: &'a Renderer,
    canvas: Canvas,
    random: &'a mut Random,
}

impl Painter<'_> {
    fn place(&mut self) -> Vector2<f64> {
        Vector2::new(
            self.random.uniform(0.0, self.canvas.width as f64),
            self.random.uniform(0.0, self.canvas.height as f64),
        )
    }

    fn grey(&mut self) -> f64 {
        self.random.uniform(20.0, 230.0)
    }

    fn fill(&mut self, contour: Option<Contour>, grey: f64) {
        let Some(contour) = contour else { return };
        let (width, height) = (self.canvas.width, self.canvas.height);
        if let Some(patch) = Patch::of(&[(contour, 1.0)], self.renderer.kernel(), width, height) {
            self.canvas.paint(&patch, grey);
        }
    }

    fn turned_box(&mut self, center: Vector2<f64>, half: [f64; 2], angle: f64, grey: f64) {
        let along = Vector2::new(angle.cos(), angle.sin());
        let across = Vector2::new(-along.y, along.x);
        let corner = |a: f64, b: f64| center + along * (a * half[0]) + across * (b * half[1]);
        let corners = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
        self.fill(Contour::polygon(&corners, 1.0, Some), grey);
    }

    fn disc(&mut self, center: Vector2<f64>, semiaxes: [f64; 2], grey: f64) {
        let contour = self.ellipse(center, semiaxes);
        self.fill(contour, grey);
    }

    fn ellipse(&mut self, center: Vector2<f64>, semiaxes: [f64; 2]) -> Option<Contour> {
        let angle = self.random.uniform(0.0, std::f64::consts::PI);
        let (sin, cos) = angle.sin_cos();
        let count = (std::f64::consts::TAU * semiaxes[0] / 0.6).ceil().max(48.0) as usize;
        Contour::smooth(count, |t| {
            let (x, y) = (semiaxes[0] * t.cos(), semiaxes[1] * t.sin());
            Some(center + Vector2::new(x * cos - y * sin, x * sin + y * cos))
        })
    }

    fn ring(&mut self) {
        let (center, radius) = (self.place(), self.random.uniform(4.0, 20.0));
        let inner = radius * self.random.uniform(0.6, 0.8);
        for (radius, grey) in [(1.6 * radius, 215.0), (radius, 45.0), (inner, 215.0)] {
            self.disc(center, [radius; 2], grey);
        }
    }

    /// Small ones are more frequent than large ones, like objects at all distances.
    fn decoy(&mut self) {
        let (center, radius) = (self.place(), 4.0 * 15f64.powf(self.random.uniform(0.0, 1.0)));
        let kind = LookAlike::ALL[(self.random.next_u64() % LookAlike::ALL.len() as u64) as usize];
        for (contour, grey) in kind.areas(center, radius, self.random) {
            self.fill(Some(contour), grey);
        }
    }

    /// Dark strokes of two heights on a pale label, like printed text.
    fn word(&mut self) {
        let start = self.place();
        let size = self.random.uniform(4.0, 18.0);
        let letters = 4 + (self.random.next_u64() % 12) as usize;
        let length = letters as f64 * size;
        self.turned_box(start + Vector2::new(length / 2.0, 0.0), [length * 0.6, size], 0.0, 215.0);
        for letter in 0..letters {
            let center = start + Vector2::new((letter as f64 + 0.5) * size, 0.0);
            if self.random.next_u64().is_multiple_of(3) {
                self.disc(center, [size * 0.25; 2], 45.0);
            } else {
                let tall = self.random.uniform(0.4, 0.8) * size;
                let lean = self.random.uniform(1.2, 1.9);
                self.turned_box(center, [tall, size * 0.1], lean, 45.0);
                self.turned_box(center, [size * 0.3, size * 0.1], lean - 1.4, 45.0);
            }
        }
    }
}
