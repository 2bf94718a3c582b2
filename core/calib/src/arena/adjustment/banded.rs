//! Symmetric positive definite band matrix and its Cholesky factor (Golub, Van Loan, *Matrix computations*, 4.3.5): the
//! normal equations of a spline, where each sighting involves four control points.

/// Lower bandwidth with the diagonal: four points of three coordinates.
pub(crate) const WIDTH: usize = 12;

/// Lower half by rows: entry k of row i belongs to column i + k + 1 - [`WIDTH`].
#[derive(Clone, Debug, Default)]
pub(crate) struct Band {
    rows: Vec<[f64; WIDTH]>,
}

/// L of L Lᵀ.
#[derive(Clone, Debug)]
pub(crate) struct Factor {
    rows: Vec<[f64; WIDTH]>,
}

impl Band {
    pub(crate) fn zeros(size: usize) -> Self {
        Self { rows: vec![[0.0; WIDTH]; size] }
    }

    /// Adds to an entry of the lower half within the band.
    pub(crate) fn add(&mut self, row: usize, column: usize, value: f64) {
        self.rows[row][column + WIDTH - 1 - row] += value;
    }

    /// Returns `None` if the matrix is not positive definite.
    pub(crate) fn factor(mut self) -> Option<Factor> {
        for i in 0..self.rows.len() {
            let (above, rest) = self.rows.split_at_mut(i);
            let row = &mut rest[0];
            let leftmost = i.saturating_sub(WIDTH - 1);
            for j in leftmost..i {
                // Columns within the band of both rows; entry of column k in row j is k + WIDTH - 1 - j.
                let other = &above[j];
                let start = leftmost.max(j.saturating_sub(WIDTH - 1));
                let sum: f64 =
                    (start..j).map(|k| row[k + WIDTH - 1 - i] * other[k + WIDTH - 1 - j]).sum();
                let at = j + WIDTH - 1 - i;
                row[at] = (row[at] - sum) / other[WIDTH - 1];
            }
            let square: f64 = row[..WIDTH - 1].iter().map(|value| value * value).sum();
            let pivot = row[WIDTH - 1] - square;
            if !(pivot > 0.0 && pivot.is_finite()) {
                return None;
            }
            row[WIDTH - 1] = pivot.sqrt();
        }
        Some(Factor { rows: self.rows })
    }
}

impl Factor {
    /// L⁻¹ B in place, for B with `width` columns, by rows.
    pub(crate) fn forward(&self, matrix: &mut [f64], width: usize) {
        for (i, row) in self.rows.iter().enumerate() {
            let (above, rest) = matrix.split_at_mut(i * width);
            let target = &mut rest[..width];
            for j in i.saturating_sub(WIDTH - 1)..i {
                let factor = row[j + WIDTH - 1 - i];
                for (to, from) in target.iter_mut().zip(&above[j * width..(j + 1) * width]) {
                    *to -= factor * from;
                }
            }
            let inverse = 1.0 / row[WIDTH - 1];
            target.iter_mut().for_each(|value| *value *= inverse);
        }
    }

    /// L⁻ᵀ b in place.
    pub(crate) fn backward(&self, vector: &mut [f64]) {
        for i in (0..self.rows.len()).rev() {
            let row = &self.rows[i];
            vector[i] /= row[WIDTH - 1];
            let value = vector[i];
            for j in i.saturating_sub(WIDTH - 1)..i {
                vector[j] -= row[j + WIDTH - 1 - i] * value;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn solves_as_the_full_matrix_does(
            numbers in proptest::collection::vec(-1.0..1.0f64, 40 * WIDTH), size in 1usize..40
        ) {
            // Positive definite by its diagonal.
            let mut band = Band::zeros(size);
            let mut full = DMatrix::zeros(size, size);
            for i in 0..size {
                for j in i.saturating_sub(WIDTH - 1)..=i {
                    let value = numbers[i * WIDTH + i - j] + if i == j { 25.0 } else { 0.0 };
                    band.add(i, j, value);
                    full[(i, j)] = value;
                    full[(j, i)] = value;
                }
            }
            let right = DVector::from_fn(size, |i, _| numbers[i]);
            let mut solved: Vec<f64> = right.iter().copied().collect();
            let factor = band.factor().unwrap();
            factor.forward(&mut solved, 1);
            factor.backward(&mut solved);
            let expected = full.cholesky().unwrap().solve(&right);
            for (one, other) in solved.iter().zip(expected.iter()) {
                prop_assert!((one - other).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn an_indefinite_matrix_has_no_factor() {
        let mut band = Band::zeros(2);
        band.add(0, 0, 1.0);
        band.add(1, 0, 2.0);
        band.add(1, 1, 1.0);
        assert!(band.factor().is_none());
    }
}
