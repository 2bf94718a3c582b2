//! Images of a contour, its derivatives and its spread, with bloom.
//!
//! As in the plain fit ([`window`](super::super::model::window)) nodes add to the pixels around
//! them. Here the kernel is that of the exact blur, both rims may be moved by a bloom, and the
//! derivative of the black share d by a motion of a rim into black, -∮ K ds, is an image of its own
//! for each rim.

use fearless_simd::{Level, Simd, dispatch};
use fearless_simd_macros::simd;

use crate::{
    normal_distribution::Table,
    pose::photometry::model::{contour::MAX_NODES, projection::Nodes, window::Region},
    scratch::reserve_total,
};

/// Fall (later d), two gradients, curvature, and the spread of either rim.
pub const IMAGES: usize = 6;
/// Up to this blur a node reaches over 8 pixels, beyond it over 16.
const NARROW_PX: f64 = 1.12;
/// Pixels of the widest node, one more for the fall, and both sides of a pixel.
const PLACES: usize = 20;

#[derive(Clone, Debug, Default)]
pub struct RimImages {
    region: Region,
    planes: Vec<f32>,
    normals: Vec<[f32; 2]>,
}

/// Kernel of a node along one axis.
struct Axis {
    /// First pixel.
    first: usize,
    /// k, its derivative, and e.
    weight: [f32; PLACES],
    slope: [f32; PLACES],
    fall: [f32; PLACES],
}

impl RimImages {
    /// Reserves memory for windows of this size.
    pub fn reserve(&mut self, pixels: usize) {
        reserve_total(&mut self.planes, pixels * IMAGES);
        reserve_total(&mut self.normals, MAX_NODES);
    }

    /// Places the window over a region of the frame.
    pub fn set_region(&mut self, region: &Region) {
        self.region = *region;
        let size = region.width * region.height * IMAGES;
        self.planes.resize(size.max(self.planes.len()), 0.0);
    }

    /// Column and row of the frame at the top left.
    pub fn origin(&self) -> (i64, i64) {
        self.region.origin
    }

    pub fn width(&self) -> usize {
        self.region.width
    }

    pub fn height(&self) -> usize {
        self.region.height
    }

    pub fn plane(&self, index: usize) -> &[f32] {
        let size = self.region.width * self.region.height;
        &self.planes[index * size..(index + 1) * size]
    }

    /// Draws the contour; false if it leaves the window.
    pub fn draw(&mut self, level: Level, nodes: &Nodes, blur_px: f64, table: &Table) -> bool {
        dispatch!(level, simd => draw(simd, self, nodes, blur_px, table))
    }

    #[inline(always)]
    fn draw_plain(&mut self, nodes: &Nodes, blur_px: f64, table: &Table) -> bool {
        let size = self.region.width * self.region.height;
        self.planes[..size * IMAGES].fill(0.0);
        let reach = if blur_px <= NARROW_PX { 8 } else { 16 };
        for index in 0..nodes.x.len() {
            let (x, y) = (f64::from(nodes.x[index]), f64::from(nodes.y[index]));
            let (Some(across), Some(down)) = (
                Axis::new(x, self.region.width, reach, blur_px, table),
                Axis::new(y, self.region.height, reach, blur_px, table),
            ) else {
                return false;
            };
            let way = [nodes.dx[index], nodes.dy[index]];
            let rim = usize::from(index >= nodes.outer);
            if reach == 8 {
                self.add::<8>(&across, &down, way, rim)
            } else {
                self.add::<16>(&across, &down, way, rim)
            }
        }
        for row in 1..self.region.height {
            let (above, here) =
                self.planes[(row - 1) * self.region.width..].split_at_mut(self.region.width);
            for (here, above) in here.iter_mut().zip(above.iter()).take(self.region.width) {
                *here += above;
            }
        }
        true
    }

    #[inline(always)]
    fn add<const REACH: usize>(
        &mut self,
        across: &Axis,
        down: &Axis,
        [dx, dy]: [f32; 2],
        rim: usize,
    ) {
        let size = self.region.width * self.region.height;
        let length = (dx * dx + dy * dy).sqrt();
        let (weight, slope) = (&across.weight[..REACH], &across.slope[..REACH]);
        for row in 0..=REACH {
            let start = (down.first + row) * self.region.width + across.first;
            let mut put = |image: usize, of: &[f32], factor: f32| {
                let pixels = &mut self.planes[image * size + start..][..REACH];
                for (pixel, of) in pixels.iter_mut().zip(of) {
                    *pixel += of * factor;
                }
            };
            put(0, weight, down.fall[row] * dx);
            put(1, weight, down.weight[row] * dy);
            put(2, weight, -down.weight[row] * dx);
            put(3, slope, down.weight[row] * dy);
            put(3, weight, -down.slope[row] * dx);
            put(4 + rim, weight, -down.weight[row] * length);
        }
    }

    /// Moves both rims into the black.
    pub fn move_rims(&mut self, nodes: &mut Nodes, by_px: f64) {
        let by_px = by_px as f32;
        let count = nodes.x.len();
        self.normals.clear();
        self.normals.extend(nodes.dx.iter().zip(&nodes.dy).map(|(dx, dy)| {
            let per_length = 1.0 / (dx * dx + dy * dy).sqrt();
            [-dy * per_length, dx * per_length]
        }));
        for (from, to) in [(0, nodes.outer), (nodes.outer, count)] {
            let around = &self.normals[from..to];
            let round = |i: usize, by: usize| around[(i + by) % around.len()];
            // The contour may run against the order of the nodes.
            let (x, y) = (&nodes.x[from..], &nodes.y[from..]);
            let forward = (x[1] - x[0]) * nodes.dx[from] + (y[1] - y[0]) * nodes.dy[from];
            let along_px = by_px * forward.signum();
            for i in 0..around.len() {
                let end = around.len();
                let (one, two) =
                    ([round(i, 1), round(i, end - 1)], [round(i, 2), round(i, end - 2)]);
                // Change of the normal from node to node, to fourth order.
                let change = [0, 1]
                    .map(|k| (8.0 * (one[0][k] - one[1][k]) - (two[0][k] - two[1][k])) / 12.0);
                nodes.x[from + i] += by_px * around[i][0];
                nodes.y[from + i] += by_px * around[i][1];
                nodes.dx[from + i] += along_px * change[0];
                nodes.dy[from + i] += along_px * change[1];
            }
        }
    }
}

/// Compiled for each SIMD level, in which the loops become vector instructions.
#[simd]
fn draw<S: Simd>(
    simd: S,
    images: &mut RimImages,
    nodes: &Nodes,
    blur_px: f64,
    table: &Table,
) -> bool {
    let _ = simd;
    images.draw_plain(nodes, blur_px, table)
}

impl Axis {
    /// `None` if the node reaches beyond the window.
    #[inline(always)]
    fn new(place: f64, pixels: usize, reach: usize, blur_px: f64, table: &Table) -> Option<Self> {
        let half = reach as f64 / 2.0;
        if !(place > half && place + half + 2.0 < pixels as f64) {
            return None;
        }
        let first = place as usize + 1 - reach / 2;
        // Φ, φ and F at the sides of the pixels, from the one above the first on.
        let mut sides = [[0.0; 3]; PLACES];
        for (i, side) in sides.iter_mut().enumerate().take(reach + 3) {
            let t = place - first as f64 + 1.5 - i as f64;
            let [below, density] = table.at(t / blur_px);
            *side = [below, density / blur_px, t * below + blur_px * density];
        }
        let mut axis =
            Self { first, weight: [0.0; PLACES], slope: [0.0; PLACES], fall: [0.0; PLACES] };
        for i in 0..=reach {
            let [before, high, low] = [sides[i], sides[i + 1], sides[i + 2]];
            axis.weight[i] = (high[0] - low[0]) as f32;
            axis.slope[i] = (high[1] - low[1]) as f32;
            axis.fall[i] = (before[2] - 2.0 * high[2] + low[2]) as f32;
        }
        Some(axis)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ring of radii 12 and 5 px; `turn` is the direction of its nodes.
    fn ring(turn: f64) -> Nodes {
        let mut nodes = Nodes::default();
        for (radius, sign) in [(12.0, 1.0), (5.0, -1.0)] {
            for i in 0..64 {
                let step = std::f64::consts::TAU / 64.0;
                let (sin, cos) = (turn * step * i as f64).sin_cos();
                nodes.x.push((24.3 + radius * cos) as f32);
                nodes.y.push((23.8 + radius * sin) as f32);
                nodes.dx.push((-sign * step * radius * sin) as f32);
                nodes.dy.push((sign * step * radius * cos) as f32);
            }
        }
        nodes.outer = 64;
        nodes
    }

    #[test]
    fn a_bloom_takes_black_from_both_rims() {
        let (table, bloom_px) = (Table::default(), 0.4);
        for turn in [1.0, -1.0] {
            let mut images = RimImages::default();
            images.set_region(&Region { origin: (0, 0), width: 48, height: 48 });
            let mut nodes = ring(turn);
            images.move_rims(&mut nodes, bloom_px);
            assert!(images.draw(Level::new(), &nodes, 0.8, &table));
            let share = images.plane(0);
            // In black, in white, and outside.
            for (u, expected) in [(24 + 9, 1.0), (24, 0.0), (2, 0.0)] {
                let share = share[24 * images.width() + u];
                assert!((share - expected).abs() < 2e-3, "{turn} {u}: {share}");
            }
            let area: f32 = share.iter().sum();
            let expected =
                std::f64::consts::PI * ((12.0 - bloom_px).powi(2) - (5.0 + bloom_px).powi(2));
            assert!((f64::from(area) / expected - 1.0).abs() < 2e-3, "{turn}: {area} {expected}");
            // The derivative by a further bloom is the length of both rims.
            let move_rims: f32 = images.plane(4).iter().chain(images.plane(5)).sum();
            let around = -std::f64::consts::TAU * (12.0 + 5.0);
            assert!(
                (f64::from(move_rims) / around - 1.0).abs() < 2e-3,
                "{turn}: {move_rims} {around}"
            );
        }
    }
}
