//! The codes of a layout with their Hamming distances.

use roundel_core::marker::{CodeError, CodeLayout};
use serde::Serialize;
use utoipa::ToSchema;

/// One code.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct CodeListing {
    pub number: u16,
    /// Its bits as printed, counter-clockwise from the print's right.
    pub word: String,
    /// Least number of misread bits that turns it into another code.
    pub distance: u8,
    /// Least number of misread bits that turns it into a rotation of itself.
    pub own_distance: u8,
}

pub fn list_codes(layout: CodeLayout) -> Result<Vec<CodeListing>, CodeError> {
    let codes = layout.codes()?;
    let bits = usize::from(layout.bits);
    let listed = codes.iter().map(|(code, word)| CodeListing {
        number: code.number,
        word: format!("{word:0bits$b}"),
        distance: codes.distance(code.number).unwrap_or(layout.bits),
        own_distance: codes.own_distance(code.number).unwrap_or(0),
    });
    Ok(listed.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_at_least_the_requested_one() {
        let listed = list_codes(CodeLayout { bits: 8, min_distance: 2 }).unwrap();
        assert_eq!(listed[0].word, "00000001");
        assert!(listed.iter().all(|code| code.distance >= 2 && code.own_distance >= 1));
        assert!(
            listed.iter().enumerate().all(|(index, code)| usize::from(code.number) == index + 1)
        );
    }
}
