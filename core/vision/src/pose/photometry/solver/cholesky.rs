//! Small symmetric positive definite systems, with a size known at run time.

use std::ops::Range;

use fearless_simd::{Level, dispatch};
use nalgebra::{SMatrix, SVector};

pub const UNKNOWNS: usize = 12;
pub type Unknowns = SVector<f64, UNKNOWNS>;
/// Symmetric.
pub type Information = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// Cholesky factor of a matrix that is first scaled to a unit diagonal.
#[derive(Clone, Debug)]
pub struct Cholesky {
    /// Factored rows and columns.
    range: Range<usize>,
    scale: [f64; UNKNOWNS],
    /// Upper triangle; the diagonal holds inverses, the rest is scratch.
    upper: [[f64; UNKNOWNS]; UNKNOWNS],
}

impl Cholesky {
    /// Factors a range of rows and columns; `None` unless it is positive definite.
    pub fn new(matrix: &Information, range: Range<usize>) -> Option<Self> {
        let mut factor = Self { range, scale: [0.0; UNKNOWNS], upper: [[0.0; UNKNOWNS]; UNKNOWNS] };
        let is_one = dispatch!(Level::new(), _ => eliminate(&matrix.data.0, &mut factor));
        is_one.then_some(factor)
    }

    /// Solves matrix · x = right; unknowns outside the range are zero.
    pub fn solve(&self, right: &Unknowns) -> Unknowns {
        let mut x: [f64; UNKNOWNS] = std::array::from_fn(|i| right[i] * self.scale[i]);
        for j in self.range.clone() {
            x[j] *= self.upper[j][j];
            let by = x[j];
            for (value, above) in x.iter_mut().zip(&self.upper[j]).skip(j + 1) {
                *value -= by * above;
            }
        }
        // Each solved unknown is subtracted from all rows above at once, which avoids a chain of
        // dependent additions.
        for i in self.range.clone().rev() {
            x[i] *= self.upper[i][i];
            let by = x[i];
            for (value, row) in x.iter_mut().zip(&self.upper).take(i).skip(self.range.start) {
                *value -= by * row[i];
            }
        }
        for (value, scale) in x.iter_mut().zip(self.scale) {
            *value *= scale;
        }
        x.into()
    }

    /// The last `COUNT` rows and columns of the inverse, from the last rows of the factor.
    pub fn inverse_of_last<const COUNT: usize>(&self) -> SMatrix<f64, COUNT, COUNT> {
        let first = self.range.end - COUNT;
        // Inverse of the factor's corner, lower triangle.
        let mut inverse = SMatrix::<f64, COUNT, COUNT>::zeros();
        for column in 0..COUNT {
            let diagonal = self.upper[first + column][first + column];
            inverse[(column, column)] = diagonal;
            for row in column + 1..COUNT {
                let place = first + row;
                let solved: f64 = (column..row)
                    .map(|k| self.upper[first + k][place] * inverse[(k, column)])
                    .sum();
                inverse[(row, column)] = -solved * self.upper[place][place];
            }
        }
        let mut product = inverse.transpose() * inverse;
        for row in 0..COUNT {
            for column in 0..COUNT {
                product[(row, column)] *= self.scale[first + row] * self.scale[first + column];
            }
        }
        product
    }
}

/// One division per row waits for the row before; divisions and roots dominate the time.
#[inline(always)]
fn eliminate(matrix: &[[f64; UNKNOWNS]; UNKNOWNS], factor: &mut Cholesky) -> bool {
    let Cholesky { range, scale, upper } = factor;
    for i in range.clone() {
        if !(matrix[i][i] > 0.0 && matrix[i][i].is_finite()) {
            return false;
        }
        scale[i] = 1.0 / matrix[i][i].sqrt();
    }
    for i in range.clone() {
        for j in 0..UNKNOWNS {
            upper[i][j] = matrix[i][j] * scale[i] * scale[j];
        }
    }
    let mut inverse = [0.0; UNKNOWNS];
    for j in range.clone() {
        let row = upper[j];
        if row[j].is_nan() || row[j] <= 1e-12 {
            return false;
        }
        inverse[j] = 1.0 / row[j];
        // Whole rows vectorize; entries below the diagonal are not read.
        for i in j + 1..range.end {
            let by = row[i] * inverse[j];
            for k in 0..UNKNOWNS {
                upper[i][k] -= by * row[k];
            }
        }
    }
    for j in range.clone() {
        let root = inverse[j].sqrt();
        for value in &mut upper[j] {
            *value *= root;
        }
        upper[j][j] = root;
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solutions_solve() {
        let size = 7;
        let mut matrix = Information::zeros();
        for i in 0..size {
            for j in 0..size {
                let near = 1.0 / (1.0 + (i as f64 - j as f64).abs());
                matrix[(i, j)] = near * 10f64.powi(i as i32 + j as i32);
            }
        }
        let factor = Cholesky::new(&matrix, 0..size).unwrap();
        let right = Unknowns::from_fn(|i, _| if i < size { (i as f64).cos() } else { 0.0 });
        let left = matrix * factor.solve(&right);
        for (left, right) in left.iter().zip(&right) {
            assert!((left - right).abs() < 1e-9 * (1.0 + right.abs()));
        }
        let corner = factor.inverse_of_last::<3>();
        for column in 0..3 {
            let mut unit = Unknowns::zeros();
            unit[size - 3 + column] = 1.0;
            let inverse = factor.solve(&unit);
            for row in 0..3 {
                let expected = inverse[size - 3 + row];
                assert!((corner[(row, column)] - expected).abs() < 1e-9 * (1.0 + expected.abs()));
            }
        }
        // A part, as if there were nothing else.
        let part = Cholesky::new(&matrix, 2..5).unwrap().solve(&right);
        let left = matrix * part;
        for row in 0..size {
            let off = if (2..5).contains(&row) { left[row] - right[row] } else { part[row] };
            assert!(off.abs() < 1e-9, "{row}: {off}");
        }
        matrix[(3, 3)] = -1.0;
        assert!(Cholesky::new(&matrix, 0..size).is_none());
    }
}
