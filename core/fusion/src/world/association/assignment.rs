//! Optimal one-to-one assignment: the Hungarian method with potentials and shortest augmenting paths, one row after
//! another (Jonker, Volgenant, *A shortest augmenting path algorithm for dense and sparse linear assignment problems*,
//! 1987, without its initialization). O(rows² · columns).

/// Cost of a forbidden pair; far above any sum of allowed costs.
pub(crate) const FORBIDDEN: f64 = 1e9;

/// Column of each row, so that the sum of costs is smallest. `costs` is row by row, with at least as many columns
/// as rows, all finite. Equal costs go to the lower column.
pub(crate) fn assign(costs: &[f64], rows: usize, columns: usize) -> Vec<usize> {
    assert!(rows <= columns && costs.len() == rows * columns, "{rows} rows, {columns} columns");
    // Index 0 means "none", since the method counts from 1.
    let mut row_potential = vec![0.0; rows + 1];
    let mut column_potential = vec![0.0; columns + 1];
    let mut row_of = vec![0; columns + 1];
    let mut previous = vec![0; columns + 1];
    let mut shortest = vec![0.0; columns + 1];
    let mut done = vec![false; columns + 1];
    for row in 1..=rows {
        row_of[0] = row;
        let mut column = 0;
        shortest.fill(f64::INFINITY);
        done.fill(false);
        while row_of[column] != 0 {
            done[column] = true;
            let from = row_of[column];
            let (mut step, mut next) = (f64::INFINITY, 0);
            for to in 1..=columns {
                if done[to] {
                    continue;
                }
                let reduced = costs[(from - 1) * columns + to - 1]
                    - row_potential[from]
                    - column_potential[to];
                if reduced < shortest[to] {
                    shortest[to] = reduced;
                    previous[to] = column;
                }
                if shortest[to] < step {
                    step = shortest[to];
                    next = to;
                }
            }
            for to in 0..=columns {
                if done[to] {
                    row_potential[row_of[to]] += step;
                    column_potential[to] -= step;
                } else {
                    shortest[to] -= step;
                }
            }
            column = next;
        }
        while column != 0 {
            row_of[column] = row_of[previous[column]];
            column = previous[column];
        }
    }
    let mut column_of = vec![0; rows];
    for column in 1..=columns {
        if row_of[column] != 0 {
            column_of[row_of[column] - 1] = column - 1;
        }
    }
    column_of
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cheapest(costs: &[f64], columns: usize, row: usize, used: &mut Vec<bool>) -> f64 {
        if row * columns == costs.len() {
            return 0.0;
        }
        let mut best = f64::INFINITY;
        for column in 0..columns {
            if !used[column] {
                used[column] = true;
                let rest = cheapest(costs, columns, row + 1, used);
                best = best.min(costs[row * columns + column] + rest);
                used[column] = false;
            }
        }
        best
    }

    proptest! {
        #[test]
        fn no_assignment_is_cheaper(
            rows in 1..5usize,
            more in 0..3usize,
            numbers in proptest::collection::vec(0.0..9.0f64, 35),
        ) {
            let columns = rows + more;
            let costs = &numbers[..rows * columns];
            let columns_of = assign(costs, rows, columns);
            let mut used = columns_of.clone();
            used.sort_unstable();
            used.dedup();
            prop_assert_eq!(used.len(), rows);
            let sum: f64 = (0..rows).map(|row| costs[row * columns + columns_of[row]]).sum();
            let best = cheapest(costs, columns, 0, &mut vec![false; columns]);
            prop_assert!((sum - best).abs() < 1e-9);
        }
    }
}
