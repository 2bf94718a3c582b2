//! Checks comments, documents and messages for phrases that the style guide rules out. Each problem names file, line
//! and phrase.

use std::{fs, process::Command};

use roundel_tests::process::workspace_root;

/// Ruled out as whole words; a space may be the end of a line.
const PHRASES: [&str; 9] = [
    "nobody",
    "whoever",
    "so many",
    "foretell",
    "foretold",
    "told",
    "anew",
    "of whom",
    "as asked for",
];
/// Markers before the text of a comment.
const COMMENT_MARKERS: [&str; 7] = ["///", "//!", "//", "/**", "/*", "*", "#"];
const CHECKED: [&str; 8] =
    ["core/", "server/", "client/", "proto/", "deploy/", ".github/", ".ci/", "tests/"];
/// Third-party text, test vectors without prose, and this file.
const EXCLUDED: [&str; 5] = [
    "client/dashboard/vendor/",
    "proto/golden/",
    "LICENSE",
    "tests/fuzz/corpus/",
    "tests/tests/wording.rs",
];

fn problems(name: &str, text: &str) -> Vec<String> {
    let mut problems = Vec::new();
    let mut lines = text.lines().zip(1..).peekable();
    while let Some((line, number)) = lines.next() {
        let next = lines.peek().map_or("", |(next, _)| next);
        for phrase in PHRASES.iter().filter(|phrase| begins_in(line, next, phrase)) {
            problems.push(format!("{name}:{number}: \"{phrase}\": say plainly what is meant"));
        }
        let comment = without_marker(line);
        if !name.ends_with(".md") && comment.is_some_and(|text| text.starts_with("Of ")) {
            problems.push(format!("{name}:{number}: \"Of …\": begin with the subject"));
        }
    }
    problems
}

/// The text of a line that is a comment.
fn without_marker(line: &str) -> Option<&str> {
    let line = line.trim_start();
    COMMENT_MARKERS.iter().find_map(|marker| line.strip_prefix(marker)).map(str::trim_start)
}

/// Whether a phrase begins in a line; it may end in the next one.
fn begins_in(line: &str, next: &str, phrase: &str) -> bool {
    let line = line.trim_end().to_lowercase();
    let next = without_marker(next).unwrap_or(next).trim_start().to_lowercase();
    let text = format!("{line} {next}");
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    text.match_indices(phrase).any(|(at, _)| {
        let before = text[..at].chars().next_back();
        let after = text[at + phrase.len()..].chars().next();
        at < line.len() && ![before, after].into_iter().flatten().any(is_word)
    })
}

#[test]
fn no_forbidden_phrase_occurs() {
    let root = workspace_root();
    let list = Command::new("git")
        .args(["ls-files", "--cached", "--others", "--exclude-standard"])
        .current_dir(&root)
        .output()
        .unwrap();
    let names = String::from_utf8(list.stdout).unwrap();
    let is_checked = |name: &&str| {
        (CHECKED.iter().any(|it| name.starts_with(it)) || name.ends_with(".md"))
            && !EXCLUDED.iter().any(|it| name.contains(it))
    };
    let mut checked = 0;
    let mut found = Vec::new();
    for name in names.lines().filter(is_checked) {
        // Pictures are not text.
        let Ok(text) = fs::read_to_string(root.join(name)) else { continue };
        checked += 1;
        found.extend(problems(name, &text));
    }
    assert!(checked > 500, "only {checked} files were read: is this a git checkout?");
    assert!(found.is_empty(), "{} problems:\n{}", found.len(), found.join("\n"));
}

#[test]
fn phrases_are_found_at_their_lines() {
    let cases = [
        ("x.rs", "// You were told.", "x.rs:1: \"told\""),
        ("x.rs", "/// There are so\n/// many.", "x.rs:1: \"so many\""),
        ("x.md", "There are so\nmany.", "x.md:1: \"so many\""),
        ("x.rs", "\n    // Of a camera.", "x.rs:2: \"Of …\""),
        ("x.toml", "# Of a camera.", "x.toml:1: \"Of …\""),
        ("x.md", "# Of cameras", ""),
        ("x.rs", "let s = \"Nobody\";", "x.rs:1: \"nobody\""),
        ("x.proto", "bool can_be_fused_anew = 1;", ""),
        ("x.md", "A stolid tale, retold, and a new one.", ""),
    ];
    for (name, text, expected) in cases {
        let found = problems(name, text);
        let count = usize::from(!expected.is_empty());
        assert!(found.len() == count && found.concat().contains(expected), "{text}: {found:?}");
    }
}
