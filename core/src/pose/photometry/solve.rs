//! Small symmetric positive definite systems of a size known only at run time.

use nalgebra::SMatrix;

use super::normal::COLUMNS;

/// Unknowns at most.
pub const MOST: usize = COLUMNS - 1;

/// The Cholesky factor of a matrix, scaled to a diagonal of ones first.
#[derive(Clone, Debug)]
pub struct Factor {
    size: usize,
    scale: [f64; MOST],
    /// Lower triangle; on the diagonal its inverse.
    lower: [[f64; MOST]; MOST],
}

impl Factor {
    /// Of the first `size` rows and columns; `None` unless they are positive definite.
    pub fn new(matrix: &[[f64; MOST]; MOST], size: usize) -> Option<Self> {
        let mut scale = [0.0; MOST];
        for i in 0..size {
            if !(matrix[i][i] > 0.0 && matrix[i][i].is_finite()) {
                return None;
            }
            scale[i] = 1.0 / matrix[i][i].sqrt();
        }
        let mut lower = [[0.0; MOST]; MOST];
        for i in 0..size {
            for j in 0..=i {
                let known: f64 = lower[i][..j].iter().zip(&lower[j][..j]).map(|(a, b)| a * b).sum();
                let rest = matrix[i][j] * scale[i] * scale[j] - known;
                if i > j {
                    lower[i][j] = rest * lower[j][j];
                } else if rest > 1e-12 {
                    lower[i][i] = 1.0 / rest.sqrt();
                } else {
                    return None;
                }
            }
        }
        Some(Self { size, scale, lower })
    }

    /// The solution of matrix · x = right.
    pub fn solve(&self, right: &[f64; MOST]) -> [f64; MOST] {
        let mut x = [0.0; MOST];
        for i in 0..self.size {
            let known: f64 = self.lower[i][..i].iter().zip(&x[..i]).map(|(a, b)| a * b).sum();
            x[i] = (right[i] * self.scale[i] - known) * self.lower[i][i];
        }
        for i in (0..self.size).rev() {
            let below = self.lower[i + 1..self.size].iter().zip(&x[i + 1..self.size]);
            let known: f64 = below.map(|(row, value)| row[i] * value).sum();
            x[i] = (x[i] - known) * self.lower[i][i];
        }
        for (value, scale) in x.iter_mut().zip(self.scale) {
            *value *= scale;
        }
        x
    }

    /// The last `COUNT` rows and columns of the inverse: those of the factor's own last rows.
    pub fn inverse_of_last<const COUNT: usize>(&self) -> SMatrix<f64, COUNT, COUNT> {
        let first = self.size - COUNT;
        // Lower triangle of the inverse of the factor's corner.
        let mut inverse = SMatrix::<f64, COUNT, COUNT>::zeros();
        for column in 0..COUNT {
            let diagonal = self.lower[first + column][first + column];
            inverse[(column, column)] = diagonal;
            for row in column + 1..COUNT {
                let lower = &self.lower[first + row];
                let known: f64 =
                    (column..row).map(|k| lower[first + k] * inverse[(k, column)]).sum();
                inverse[(row, column)] = -known * lower[first + row];
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
        let factor = Factor::new(&matrix, size).unwrap();
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
        matrix[3][3] = -1.0;
        assert!(Factor::new(&matrix, size).is_none());
    }
}
