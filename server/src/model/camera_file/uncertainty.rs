//! Uncertainty of a camera file's parameters: `parameter_names` and `parameter_covariance`.

use nalgebra::DMatrix;
use roundel_core::{camera::Lens, plan::precision::LensUncertainty};
use serde_saphyr::Spanned;

use super::{FieldError, Matrix};

/// In ROS' order.
fn coefficient_names(lens: &Lens) -> &'static [&'static str] {
    match lens {
        Lens::PlumbBob(_) => &["k1", "k2", "p1", "p2", "k3"],
        Lens::Rational(_) => &["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"],
        Lens::Equidistant(_) => &["k1", "k2", "k3", "k4"],
    }
}

pub(super) fn uncertainty(
    lens: &Lens,
    names: Option<Vec<String>>,
    covariance: Option<Spanned<Matrix>>,
) -> Result<Option<LensUncertainty>, FieldError> {
    let (Some(names), Some(covariance)) = (names, covariance) else { return Ok(None) };
    let line = covariance.referenced.line();
    let wrong = |message: String| {
        FieldError::at(line, message, "calibrate again, or leave out `parameter_covariance`")
    };
    let known = coefficient_names(lens);
    let place = |name: &String| known.iter().position(|known| known == name);
    let free: Vec<usize> = names.iter().skip(4).filter_map(place).collect();
    let are_first = names.iter().take(4).eq(["fx", "fy", "cx", "cy"]);
    if !are_first || free.len() + 4 != names.len() || !free.is_sorted_by(|a, b| a < b) {
        return Err(wrong(format!(
            "`parameter_names` must be fx, fy, cx, cy and then some of {} in this order",
            known.join(", ")
        ))
        .with_content(format!(", found {}", names.join(", "))));
    }
    let numbers = covariance.value.data.map(|data| data.value).unwrap_or_default();
    let side = names.len();
    if numbers.len() != side * side {
        return Err(wrong(format!(
            "`parameter_covariance.data` must have {} numbers, found {}",
            side * side,
            numbers.len()
        )));
    }
    let matrix = DMatrix::from_row_slice(side, side, &numbers);
    let size = matrix.diagonal().amax();
    let is_even = (&matrix - matrix.transpose()).amax() <= 1e-6 * size;
    if !numbers.iter().all(|number| number.is_finite()) || !is_even || matrix.diagonal().min() < 0.0
    {
        return Err(wrong("`parameter_covariance.data` must be a covariance: symmetric, finite, no variance below 0".to_owned()));
    }
    Ok(Some(LensUncertainty { free, covariance: matrix }))
}

pub(super) fn written(
    lens: &Lens,
    LensUncertainty { free, covariance }: &LensUncertainty,
) -> String {
    let known = coefficient_names(lens);
    let free = free.iter().map(|&index| known[index]);
    let names: Vec<&str> = ["fx", "fy", "cx", "cy"].into_iter().chain(free).collect();
    let side = covariance.nrows();
    // Row by row; the matrix is symmetric, so its columns are its rows.
    format!(
        "parameter_names: [{}]\nparameter_covariance:\n  rows: {side}\n  cols: {side}\n  data: {:?}\n",
        names.join(", "),
        covariance.as_slice(),
    )
}

#[cfg(test)]
mod tests {
    use super::super::{parse, tests::GOOD};

    #[test]
    fn a_wrong_covariance_is_rejected() {
        let with = |names: &str, data: &str| {
            let text =
                format!("{GOOD}parameter_names: {names}\nparameter_covariance:\n  data: {data}\n");
            let error = parse(&text).expect_err(names);
            format!("{}{}", error.message, error.found)
        };
        let zeros = |count: usize| format!("{:?}", vec![0.0; count]);
        for (names, data, expected) in [
            ("[fx, fy, cx]", zeros(9), "must be fx, fy, cx, cy and then"),
            ("[fx, fy, cx, cy, k9]", zeros(25), "found fx, fy, cx, cy, k9"),
            ("[fx, fy, cx, cy, k2, k1]", zeros(36), "in this order"),
            ("[fx, fy, cx, cy]", zeros(15), "must have 16 numbers, found 15"),
            (
                "[fx, fy, cx, cy]",
                format!("{:?}", (0..16).map(f64::from).collect::<Vec<_>>()),
                "symmetric",
            ),
        ] {
            let message = with(names, &data);
            assert!(message.contains(expected), "{expected}: {message}");
        }
    }
}
