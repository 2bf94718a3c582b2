//! The order of file names that people expect: `frame9` before `frame10`.

use std::cmp::Ordering;

/// Compares names with runs of digits taken as numbers; equal numbers by their length, so that the
/// order is total.
pub(super) fn compare(a: &str, b: &str) -> Ordering {
    let (mut a, mut b) = (a.as_bytes(), b.as_bytes());
    let mut tie = Ordering::Equal;
    while let (Some(&first_a), Some(&first_b)) = (a.first(), b.first()) {
        if first_a.is_ascii_digit() && first_b.is_ascii_digit() {
            let (digits_a, rest_a) = split_digits(a);
            let (digits_b, rest_b) = split_digits(b);
            let (number_a, number_b) = (without_zeros(digits_a), without_zeros(digits_b));
            // Without leading zeros the longer number is the larger one.
            let order = number_a.len().cmp(&number_b.len()).then_with(|| number_a.cmp(number_b));
            if order != Ordering::Equal {
                return order;
            }
            tie = tie.then(digits_a.len().cmp(&digits_b.len()));
            (a, b) = (rest_a, rest_b);
        } else if first_a != first_b {
            return first_a.cmp(&first_b);
        } else {
            (a, b) = (&a[1..], &b[1..]);
        }
    }
    a.len().cmp(&b.len()).then(tie)
}

fn split_digits(text: &[u8]) -> (&[u8], &[u8]) {
    text.split_at(text.iter().take_while(|byte| byte.is_ascii_digit()).count())
}

fn without_zeros(digits: &[u8]) -> &[u8] {
    &digits[digits.iter().take_while(|digit| **digit == b'0').count()..]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn numbers_count_as_numbers() {
        let mut names = ["f10.png", "f9.png", "f1.png", "g0", "f09.png", "f", "f010b"];
        names.sort_by(|a, b| compare(a, b));
        assert_eq!(names, ["f", "f1.png", "f9.png", "f09.png", "f10.png", "f010b", "g0"]);
    }

    proptest! {
        #[test]
        fn the_order_is_total(a in "[a0-9]{0,6}", b in "[a0-9]{0,6}", c in "[a0-9]{0,6}") {
            prop_assert_eq!(compare(&a, &b), compare(&b, &a).reverse());
            prop_assert_eq!(compare(&a, &b) == Ordering::Equal, a == b);
            if compare(&a, &b).is_le() && compare(&b, &c).is_le() {
                prop_assert!(compare(&a, &c).is_le());
            }
        }
    }
}
