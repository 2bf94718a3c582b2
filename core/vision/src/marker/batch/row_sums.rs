//! The pass over a ring's rows: moments of its bands, and level sums of its parts.
//!
//! No row is multiplied by v. With t the number of rows from a row to the last one, the running sums of the rows' sums d,
//! and the running sums of those, add up to Σ d t and Σ d t (t + 1)/2.

use fearless_simd::{Simd, i16x32, i32x16, mask8x64, mask16x32, prelude::*, u8x64, u16x32};

use crate::marker::batch::planes::{HALF_PX, Planes};

/// PixelSource of pixels, and their column factors.
pub(super) struct PixelSource<'a, S: Simd> {
    /// From the first row and column on.
    pub pixels: &'a [u8],
    pub stride: usize,
    pub flip: u8x64<S>,
    pub disc_flip: i16x32<S>,
    pub disc_column: usize,
    pub ones: i16x32<S>,
    /// For a row's even and odd columns, and for those of the disc.
    pub even: ColumnFactors<S>,
    pub odd: ColumnFactors<S>,
    pub disc: ColumnFactors<S>,
}

/// u and u² of columns.
pub(super) struct ColumnFactors<S: Simd> {
    u: i16x32<S>,
    uu: i16x32<S>,
}

impl<S: Simd> ColumnFactors<S> {
    /// ColumnFactors `first`, `first + step`, …
    #[inline(always)]
    pub fn new(simd: S, step: i16, first: i16) -> Self {
        let mut numbers = [0i16; HALF_PX];
        for (number, to) in numbers.iter_mut().enumerate() {
            *to = number as i16;
        }
        let u = i16x32::load_array(simd, numbers) * step + first;
        Self { u, uu: u * u }
    }
}

/// The pixels of even and odd columns.
#[inline(always)]
fn by_turns<S: Simd>(pixels: u8x64<S>) -> [i16x32<S>; 2] {
    let pairs = pixels.bitcast::<u16x32<S>>();
    [(pairs & 0xff).bitcast(), (pairs >> 8).bitcast()]
}

/// The six sums of a band.
#[derive(Clone, Copy)]
struct BandSums<S: Simd> {
    sums: [i32x16<S>; 6],
}

impl<S: Simd> BandSums<S> {
    /// Adds a row: its sums of I, I u and I u².
    #[inline(always)]
    fn add(&mut self, [d, du, duu]: [i32x16<S>; 3]) {
        let [n, nv, nvv, nu, nuv, nuu] = &mut self.sums;
        *n += d;
        *nv += *n;
        *nvv += *nv;
        *nu += du;
        *nuv += *nu;
        *nuu += duu;
    }
}

/// The pixels of a set, zero elsewhere.
#[inline(always)]
fn only<S: Simd>(simd: S, pixels: u8x64<S>, set: u64) -> u8x64<S> {
    mask8x64::from_bitmask(simd, set).select(pixels, u8x64::splat(simd, 0))
}

/// RowSums of adjacent lanes.
#[inline(always)]
fn wide<S: Simd>(sums: u16x32<S>) -> i32x16<S> {
    sums.pairwise_widening_add().bitcast()
}

/// RowSums over rows, several columns per lane.
#[derive(Clone, Copy)]
pub(super) struct RowSums<S: Simd> {
    outer: BandSums<S>,
    inner: BandSums<S>,
    disc: u16x32<S>,
    black: u16x32<S>,
    near: u16x32<S>,
    far: u16x32<S>,
    far_square: i32x16<S>,
}

impl<S: Simd> RowSums<S> {
    #[inline(always)]
    pub fn new(simd: S) -> Self {
        let none = BandSums { sums: [i32x16::splat(simd, 0); 6] };
        let zero = u16x32::splat(simd, 0);
        let far_square = i32x16::splat(simd, 0);
        Self {
            outer: none,
            inner: none,
            disc: zero,
            black: zero,
            near: zero,
            far: zero,
            far_square,
        }
    }

    /// Adds these rows; either all of them have pixels of the disc's band, or none.
    #[inline(always)]
    pub fn add<const HAS_DISC: bool>(
        &mut self,
        simd: S,
        source: &PixelSource<S>,
        planes: &Planes,
        rows: std::ops::Range<usize>,
    ) {
        for row in rows {
            let line = &source.pixels[row * source.stride..];
            let pixels = line.first_chunk().expect("the patch is the frame's");
            let pixels = u8x64::load_array(simd, *pixels) ^ source.flip;
            let [even, odd] = by_turns(only(simd, pixels, planes.ring_band[row]));
            self.outer.add([
                (even + odd).pairwise_dot_product(source.ones),
                even.pairwise_dot_product(source.even.u) + odd.pairwise_dot_product(source.odd.u),
                even.pairwise_dot_product(source.even.uu) + odd.pairwise_dot_product(source.odd.uu),
            ]);
            self.black += only(simd, pixels, planes.black[row]).pairwise_widening_add();
            self.near += only(simd, pixels, planes.near[row]).pairwise_widening_add();
            let far = only(simd, pixels, planes.far[row]);
            self.far += far.pairwise_widening_add();
            let [even, odd] = by_turns(far);
            self.far_square += even.pairwise_dot_product(even) + odd.pairwise_dot_product(odd);
            if HAS_DISC {
                self.add_disc(simd, source, line, [planes.disc_band[row], planes.disc_core[row]]);
            }
        }
    }

    /// Adds a row of the disc, which half a word contains.
    #[inline(always)]
    fn add_disc(&mut self, simd: S, source: &PixelSource<S>, line: &[u8], [band, core]: [u64; 2]) {
        let pixels: &[u8; HALF_PX] =
            line[source.disc_column..].first_chunk().expect("the columns are the patch's");
        let pixels = i16x32::from_fn(simd, |column| i16::from(pixels[column])) ^ source.disc_flip;
        let none = i16x32::splat(simd, 0);
        let set = (band >> source.disc_column) & u64::from(u32::MAX);
        let of_band = mask16x32::from_bitmask(simd, set).select(pixels, none);
        self.inner.add([
            of_band.pairwise_dot_product(source.ones),
            of_band.pairwise_dot_product(source.disc.u),
            of_band.pairwise_dot_product(source.disc.uu),
        ]);
        let set = (core >> source.disc_column) & u64::from(u32::MAX);
        let of_core = mask16x32::from_bitmask(simd, set).select(pixels, none);
        self.disc += of_core.bitcast::<u16x32<S>>();
    }

    /// In the order of [`Row`], given the sums over the rows above the middle.
    #[inline(always)]
    pub fn vectors(&self, simd: S, of_top: &Self, middle: usize) -> [i32x16<S>; 21] {
        let is_left = mask16x32::from_bitmask(simd, (1 << (middle / 2)) - 1);
        let none = u16x32::splat(simd, 0);
        let black = wide(is_left.select(self.black, none));
        let near = wide(is_left.select(self.near, none));
        let far = wide(is_left.select(self.far, none));
        let zero = i32x16::splat(simd, 0);
        let mut all = [zero; 21];
        all[..6].copy_from_slice(&self.outer.sums);
        all[6..12].copy_from_slice(&self.inner.sums);
        all[12..].copy_from_slice(&[
            self.far_square,
            wide(self.disc),
            wide(self.black),
            black,
            wide(of_top.black),
            wide(self.near),
            wide(self.far),
            near + far,
            wide(of_top.near) + wide(of_top.far),
        ]);
        all
    }
}
