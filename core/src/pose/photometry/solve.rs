//! Small symmetric positive definite systems of a size known only at run time.

use std::ops::Range;

use nalgebra::SMatrix;

/// Unknowns at most.
pub const MOST: usize = 12;

/// The Cholesky factor of a matrix, scaled to a diagonal of ones first.
#[derive(Clone, Debug)]
pub struct Factor {
    /// Rows and columns that it is of.
    range: Range<usize>,
    scale: [f64; MOST],
    /// Upper triangle; on the diagonal its inverse, below it what is left of the elimination.
    upper: [[f64; MOST]; MOST],
}

impl Factor {
    /// Of some rows and the same columns; `None` unless they are positive definite.
    pub fn new(matrix: &[[f64; MOST]; MOST], range: Range<usize>) -> Option<Self> {
        let mut scale = [0.0; MOST];
        for i in range.clone() {
            if !(matrix[i][i] > 0.0 && matrix[i][i].is_finite()) {
                return None;
            }
            scale[i] = 1.0 / matrix[i][i].sqrt();
        }
        let mut upper = *matrix;
        for (row, by) in upper.iter_mut().zip(scale) {
            for (value, scale) in row.iter_mut().zip(scale) {
                *value *= by * scale;
            }
        }
        for j in range.clone() {
            if upper[j][j].is_nan() || upper[j][j] <= 1e-12 {
                return None;
            }
            let inverse = 1.0 / upper[j][j].sqrt();
            let row = upper[j].map(|value| value * inverse);
            // Whole rows, of one length, go into vectors; what comes below the diagonal is not read.
            for (below, by) in upper.iter_mut().zip(row).take(range.end).skip(j + 1) {
                for (value, other) in below.iter_mut().zip(row) {
                    *value -= by * other;
                }
            }
            upper[j] = row;
            upper[j][j] = inverse;
        }
        Some(Self { range, scale, upper })
    }

    /// The solution of matrix · x = right; other unknowns stay at none.
    pub fn solve(&self, right: &[f64; MOST]) -> [f64; MOST] {
        let mut x: [f64; MOST] = std::array::from_fn(|i| right[i] * self.scale[i]);
        for j in self.range.clone() {
            x[j] *= self.upper[j][j];
            let by = x[j];
            for (value, above) in x.iter_mut().zip(&self.upper[j]).skip(j + 1) {
                *value -= by * above;
            }
        }
        for i in self.range.clone().rev() {
            let rest = i + 1..self.range.end;
            let beyond = self.upper[i][rest.clone()].iter().zip(&x[rest]);
            let known: f64 = beyond.map(|(factor, value)| factor * value).sum();
            x[i] = (x[i] - known) * self.upper[i][i];
        }
        for (value, scale) in x.iter_mut().zip(self.scale) {
            *value *= scale;
        }
        x
    }

    /// The last `COUNT` rows and columns of the inverse: those of the factor's own last rows.
    pub fn inverse_of_last<const COUNT: usize>(&self) -> SMatrix<f64, COUNT, COUNT> {
        let first = self.range.end - COUNT;
        // Lower triangle of the inverse of the factor's corner.
        let mut inverse = SMatrix::<f64, COUNT, COUNT>::zeros();
        for column in 0..COUNT {
            let diagonal = self.upper[first + column][first + column];
            inverse[(column, column)] = diagonal;
            for row in column + 1..COUNT {
                let place = first + row;
                let known: f64 = (column..row)
                    .map(|k| self.upper[first + k][place] * inverse[(k, column)])
                    .sum();
                inverse[(row, column)] = -known * self.upper[place][place];
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solutions_solve() {
        let size = 7;
        let mut matrix = [[0.0; MOST]; MOST];
        for (i, row) in matrix.iter_mut().enumerate().take(size) {
            for (j, value) in row.iter_mut().enumerate().take(size) {
                let near = 1.0 / (1.0 + (i as f64 - j as f64).abs());
                *value = near * 10f64.powi(i as i32 + j as i32);
            }
        }
        let factor = Factor::new(&matrix, 0..size).unwrap();
        let right = std::array::from_fn(|i| if i < size { (i as f64).cos() } else { 0.0 });
        let x = factor.solve(&right);
        for (row, right) in matrix.iter().zip(right).take(size) {
            let left: f64 = row.iter().zip(x).map(|(a, b)| a * b).sum();
            assert!((left - right).abs() < 1e-9 * (1.0 + right.abs()));
        }
        let corner = factor.inverse_of_last::<3>();
        for column in 0..3 {
            let unit = std::array::from_fn(|i| f64::from(u8::from(i == size - 3 + column)));
            let inverse = factor.solve(&unit);
            for row in 0..3 {
                let expected = inverse[size - 3 + row];
                assert!((corner[(row, column)] - expected).abs() < 1e-9 * (1.0 + expected.abs()));
            }
        }
        // Of a part, as if there were no more.
        let part = Factor::new(&matrix, 2..5).unwrap().solve(&right);
        for (row, (values, right)) in matrix.iter().zip(right).enumerate() {
            let left: f64 = values.iter().zip(part).map(|(a, b)| a * b).sum();
            let off = if (2..5).contains(&row) { left - right } else { part[row] };
            assert!(off.abs() < 1e-9, "{row}: {off}");
        }
        matrix[3][3] = -1.0;
        assert!(Factor::new(&matrix, 0..size).is_none());
    }
}
