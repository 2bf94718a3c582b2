//! The API table in `client/README.md` lists every gRPC call and every REST path.

use std::collections::BTreeSet;

use super::rig::Rig;

const README: &str = include_str!("../../../client/README.md");
const CONTRACT: &str = include_str!("../../../proto/contract.txt");

/// The words between backticks in the table.
fn words() -> BTreeSet<&'static str> {
    let (_, section) = README.split_once("## What is where").expect("the section");
    let section = section.split("\n## ").next().unwrap_or_default();
    let rows = section.lines().filter(|line| line.starts_with('|'));
    let quoted = rows.flat_map(|row| row.split('`').skip(1).step_by(2));
    quoted.flat_map(str::split_whitespace).collect()
}

#[tokio::test]
async fn the_table_lists_every_call_and_path() {
    let words = words();
    let calls = CONTRACT.lines().filter_map(|line| line.split(' ').next());
    let calls: BTreeSet<&str> = calls.filter_map(|name| name.strip_prefix("Roundel.")).collect();
    assert!(calls.len() > 20, "{calls:?}");
    for call in &calls {
        assert!(words.contains(call), "{call} is not in the table");
    }
    let rig = Rig::start().await;
    let document = rig.get("/openapi.json").await.json();
    let paths: Vec<&str> =
        document["paths"].as_object().unwrap().keys().map(String::as_str).collect();
    for path in &paths {
        let path = path.strip_prefix("/api/v1").unwrap_or(path);
        assert!(path == "/stream" || words.contains(path), "{path} is not in the table");
    }
    // The table lists nothing that does not exist.
    for word in words.iter().filter(|word| word.starts_with('/') && **word != "/api") {
        let is_one =
            paths.iter().any(|path| path == word || path.strip_prefix("/api/v1") == Some(word));
        assert!(is_one || *word == "/api/v1", "{word} is not a path");
    }
    rig.stop().await;
}
