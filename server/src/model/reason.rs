//! Short names of rejects, for labels and pictures; [`Reject::reason`] is the sentence.

use roundel_core::marker::Reject;

/// Lower-case words with `separator` between them: `frame_edge`.
pub(crate) fn reject_name(reject: Reject, separator: char) -> String {
    let mut word = String::new();
    for letter in format!("{reject:?}").chars() {
        if letter.is_ascii_uppercase() && !word.is_empty() {
            word.push(separator);
        }
        word.push(letter.to_ascii_lowercase());
    }
    word
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn names_are_distinct() {
        assert_eq!(reject_name(Reject::FrameEdge, '_'), "frame_edge");
        assert_eq!(reject_name(Reject::Tilt, ' '), "tilt");
        let words: BTreeSet<String> = Reject::ALL.iter().map(|&it| reject_name(it, '_')).collect();
        assert_eq!(words.len(), Reject::ALL.len());
        assert!(words.iter().all(|word| word.chars().all(|c| c.is_ascii_lowercase() || c == '_')));
    }
}
