//! Suggestions for mistyped names.

/// Jaro-Winkler similarity of a mistyped name.
const ALIKE: f64 = 0.75;
/// Number of letters to one typing error.
const LETTERS_A_SLIP: usize = 3;

/// The known name that is most similar to `name`, if any is.
pub(crate) fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let slips = (name.chars().count() / LETTERS_A_SLIP).max(1);
    known
        .into_iter()
        .map(|candidate| (strsim::jaro_winkler(name, candidate), candidate))
        .filter(|(likeness, candidate)| {
            *likeness >= ALIKE || strsim::osa_distance(name, candidate) <= slips
        })
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate)
}

/// `; did you mean "…"?`, or nothing.
pub(crate) fn did_you_mean<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    nearest(name, known).map(|meant| format!("; did you mean \"{meant}\"?")).unwrap_or_default()
}

/// Names for a sentence: `` `a`, `b` ``.
pub(crate) fn list<'a>(names: impl IntoIterator<Item = &'a str>) -> String {
    let quoted: Vec<String> = names.into_iter().map(|name| format!("`{name}`")).collect();
    if quoted.is_empty() { "none".to_owned() } else { quoted.join(", ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_similar_names_are_suggested() {
        let known = ["outer_mm", "inner_mm", "name"];
        assert_eq!(nearest("outter_mm", known), Some("outer_mm"));
        assert_eq!(nearest("nmae", known), Some("name"));
        assert_eq!(nearest("wheelbase", known), None);
        assert_eq!(list(known), "`outer_mm`, `inner_mm`, `name`");
        assert_eq!(list([]), "none");
    }
}
