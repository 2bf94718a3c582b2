//! Rules for dependencies and imports, as checks on manifests and source text.
//!
//! Each check takes text and returns a sentence for each violation. `tests/layering.rs` runs the checks over the repository,
//! and over examples that they must reject. Comments, strings and test items are ignored.

mod source_text;

use std::collections::{BTreeMap, BTreeSet};

use source_text::is_word;
pub use source_text::shipped_code;

/// The crates of core.
pub const CORE_CRATES: [&str; 6] =
    ["core", "core/vision", "core/fusion", "core/calib", "core/sim", "core/plan"];

/// Crates that core may use. They do no input or output.
pub const PURE_CRATES: [&str; 8] = [
    "fearless_simd",
    "fearless_simd_macros",
    "nalgebra",
    "rand",
    "rand_chacha",
    "rand_distr",
    "rayon",
    "thiserror",
];

/// Clocks, macros and crates that core must not name.
pub const IMPURE: [&str; 10] = [
    "SystemTime",
    "Instant::now",
    "println",
    "eprintln",
    "print",
    "eprint",
    "dbg",
    "tokio",
    "tracing",
    "log",
];

/// Top-level modules of the server from the bottom up: each may use those before it.
pub const SERVER_LAYERS: [&str; 7] = ["model", "capture", "fusion", "lab", "archive", "api", "app"];

/// Parts of the standard library that core must not use: clocks, files, sockets, processes.
pub const IMPURE_STD: [&str; 7] = ["env", "fs", "io", "net", "process", "thread", "time"];

/// The workspace crates that each crate may depend on; `roundel-tests` may depend on all.
pub const CRATE_DEPENDENCIES: [(&str, &[&str]); 9] = [
    ("roundel-proto", &[]),
    ("roundel-vision", &[]),
    ("roundel-fusion", &["roundel-vision"]),
    ("roundel-calib", &["roundel-vision", "roundel-fusion"]),
    ("roundel-sim", &["roundel-vision"]),
    ("roundel-plan", &["roundel-vision", "roundel-fusion", "roundel-sim"]),
    (
        "roundel-core",
        &["roundel-vision", "roundel-fusion", "roundel-calib", "roundel-sim", "roundel-plan"],
    ),
    ("roundel-client", &["roundel-proto"]),
    ("roundel-server", &["roundel-core", "roundel-proto", "roundel-client"]),
];

/// Everything that may be at the top of the repository, besides dot-files and build output.
pub const TOP_LEVEL: [&str; 15] = [
    "CHANGELOG.md",
    "Cargo.lock",
    "Cargo.toml",
    "LICENSE-APACHE",
    "LICENSE-MIT",
    "README.md",
    "client",
    "core",
    "deny.toml",
    "deploy",
    "proto",
    "rustfmt.toml",
    "server",
    "target",
    "tests",
];

/// Unexpected names at the top of the repository.
pub fn stray_names(names: &[String]) -> Vec<String> {
    let known = |name: &str| name.starts_with('.') || TOP_LEVEL.contains(&name);
    names
        .iter()
        .filter(|name| !known(name))
        .map(|name| {
            format!("`{name}` is at the top level: move it into a folder, or add it to the list")
        })
        .collect()
}

/// Dependencies between crates in the wrong direction, and dependencies that core must not have.
///
/// `crates` maps each of our crates to all its dependencies; `shipped` leaves development dependencies out.
pub fn forbidden_dependencies(
    crates: &BTreeMap<String, Vec<String>>,
    shipped: &BTreeMap<String, Vec<String>>,
) -> Vec<String> {
    let mut broken = Vec::new();
    for (name, allowed) in CRATE_DEPENDENCIES {
        let Some(used) = crates.get(name) else {
            broken.push(format!("expected a crate `{name}`, found none"));
            continue;
        };
        for other in used.iter().filter(|other| other.starts_with("roundel-")) {
            if !allowed.contains(&other.as_str()) {
                broken.push(format!("`{name}` depends on `{other}`, which it may not use"));
            }
        }
    }
    for folder in CORE_CRATES {
        let name = format!("roundel-{}", folder.trim_start_matches("core/"));
        for other in shipped.get(&name).into_iter().flatten() {
            if !PURE_CRATES.contains(&other.as_str()) && !other.starts_with("roundel-") {
                broken
                    .push(format!("`{name}` depends on `{other}`, which is not on the pure list"));
            }
        }
    }
    broken
}

/// Clocks, input and output in a source file of core.
pub fn impurities(path: &str, source: &str) -> Vec<String> {
    let code = shipped_code(source);
    let words = IMPURE.iter().filter(|word| names(&code, word)).map(|word| (*word).to_owned());
    let std = paths_from("std::", &code)
        .into_iter()
        .filter(|part| IMPURE_STD.contains(&part.as_str()))
        .map(|part| format!("std::{part}"));
    words
        .chain(std)
        .map(|word| format!("{path} names `{word}`: core is pure, the caller passes what it needs"))
        .collect()
}

/// Imports in a source file of the server that do not run down. `path` is relative to `server/src`.
pub fn upward_server_imports(path: &str, source: &str) -> Vec<String> {
    let own = module_path(path);
    let Some(module) = own.first().filter(|module| *module != "main") else { return Vec::new() };
    let layer = |name: &str| SERVER_LAYERS.iter().position(|layer| *layer == name);
    let Some(own_layer) = layer(module) else {
        return vec![format!("server/src/{path}: module `{module}` is in no layer")];
    };
    crate_uses(&own, &shipped_code(source))
        .into_iter()
        .filter(|used| used != module && layer(used).is_some_and(|layer| layer >= own_layer))
        .map(|used| format!("server/src/{path} uses `{used}`, which is not below `{module}`"))
        .collect()
}

/// Cycles between files and folders that lie in the same folder. A folder's own module (`mod.rs`) is left out: it declares
/// the others and re-exports from them.
///
/// `files` are paths relative to the crate's `src` with their text.
pub fn import_cycles(files: &[(String, String)]) -> Vec<String> {
    let modules: BTreeSet<Vec<String>> = files.iter().map(|(path, _)| module_path(path)).collect();
    // For each folder: its entries, and the entries that each of them imports.
    let mut folders: BTreeMap<Vec<String>, BTreeMap<String, BTreeSet<String>>> = BTreeMap::new();
    for (path, source) in files {
        let own = module_path(path);
        for mut used in module_uses(&own, &shipped_code(source)) {
            while !used.is_empty() && !modules.contains(&used) {
                used.pop();
            }
            let shared = own.iter().zip(&used).take_while(|(own, used)| own == used).count();
            if let (Some(from), Some(to)) = (own.get(shared), used.get(shared)) {
                let folder = folders.entry(own[..shared].to_vec()).or_default();
                folder.entry(from.clone()).or_default().insert(to.clone());
            }
        }
    }
    let mut cycles = Vec::new();
    for (folder, imports) in folders {
        let mut open = imports;
        // Entries that import nothing of the others are in no cycle; without them, others may be.
        loop {
            let entries: BTreeSet<String> = open.keys().cloned().collect();
            open.values_mut().for_each(|used| used.retain(|name| entries.contains(name)));
            let before = open.len();
            open.retain(|_, used| !used.is_empty());
            if open.len() == before {
                break;
            }
        }
        if !open.is_empty() {
            let each: Vec<String> = open
                .iter()
                .map(|(from, to)| {
                    format!("{from} -> {}", to.iter().cloned().collect::<Vec<_>>().join(", "))
                })
                .collect();
            cycles.push(format!("cycle in {}: {}", folder.join("/"), each.join("; ")));
        }
    }
    cycles
}

/// Files of the server other than `model/convert` that convert between core and proto, or that name proto where only
/// core's types belong. `path` is relative to `server/src`.
///
/// Converting means building one of the [`CONVERTED`] messages where core's types are in scope. Selecting, addressing
/// or passing on what `model/convert` made is allowed.
pub fn misplaced_types(path: &str, source: &str) -> Vec<String> {
    let code = shipped_code(source);
    let (core, proto) = (names(&code, "roundel_core"), names(&code, "roundel_proto"));
    let mut broken = Vec::new();
    if !path.starts_with("model/convert") && core && proto {
        broken.extend(CONVERTED.iter().filter(|name| builds(&code, name)).map(|name| {
            format!(
                "server/src/{path} builds a {name} next to core's types: only model/convert may"
            )
        }));
    }
    let is_pure = |folder: &&str| path.starts_with(*folder);
    if PROTO_FREE.iter().any(is_pure) && proto {
        broken
            .push(format!("server/src/{path} names roundel_proto: it works on core's types only"));
    }
    broken
}

/// Folders of the server that work on core's types only.
const PROTO_FREE: [&str; 4] =
    ["capture/source", "capture/worker", "fusion/calibration", "fusion/mod.rs"];

/// Messages with the content of core's types.
const CONVERTED: [&str; 10] = [
    "Camera",
    "Detection",
    "Ellipse",
    "FrameObservations",
    "Intrinsics",
    "Object",
    "ObjectState",
    "Pose",
    "RoundelPose",
    "Snapshot",
];

/// Whether code builds a message: `v1::Name {` or `Name {` imported from v1, but not as the type that a function
/// returns or a block implements.
fn builds(code: &str, name: &str) -> bool {
    code.match_indices(name).any(|(at, _)| {
        let whole =
            !preceded_by_word(code, at) && code[at + name.len()..].trim_start().starts_with('{');
        let before = code[..at].trim_end_matches("v1::").trim_end_matches("roundel_proto::");
        let before = before.trim_end();
        let of_proto = code[..at].ends_with("v1::") || !code[..at].ends_with("::");
        let a_type =
            ["->", "for", "impl", "struct", "enum", "::"].iter().any(|end| before.ends_with(end));
        whole && of_proto && !a_type
    })
}

/// `marker/track.rs` is module `marker::track`; `lib.rs` is the root.
fn module_path(path: &str) -> Vec<String> {
    let stem = path.strip_suffix(".rs").unwrap_or(path);
    let stem = stem.strip_suffix("/mod").unwrap_or(stem);
    if stem == "lib" { Vec::new() } else { stem.split('/').map(str::to_owned).collect() }
}

/// Top-level modules that code in module `own` reaches through `crate::` or `super::`.
fn crate_uses(own: &[String], code: &str) -> Vec<String> {
    let mut used = paths_from("crate::", code);
    let mut rest = code;
    while let Some(at) = rest.find("super::") {
        let mut climbed = 0;
        rest = &rest[at..];
        while let Some(after) = rest.strip_prefix("super::") {
            climbed += 1;
            rest = after;
        }
        if climbed >= own.len() {
            used.extend(first_names(rest));
        }
    }
    used.sort_unstable();
    used.dedup();
    used
}

/// Modules and items that code in module `own` names by `crate::`, `super::` or `self::`, as absolute paths.
fn module_uses(own: &[String], code: &str) -> Vec<Vec<String>> {
    let mut found = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        if !preceded_by_word(code, at) {
            expand_use_tree(&code[at + "crate::".len()..], &mut Vec::new(), &mut found);
        }
    }
    for (at, _) in code.match_indices("self::") {
        if !preceded_by_word(code, at) {
            expand_use_tree(&code[at + "self::".len()..], &mut own.to_vec(), &mut found);
        }
    }
    let mut rest = code;
    while let Some(at) = rest.find("super::") {
        rest = &rest[at..];
        let mut base = own.to_vec();
        while let Some(after) = rest.strip_prefix("super::") {
            base.pop();
            rest = after;
        }
        expand_use_tree(rest, &mut base, &mut found);
    }
    found
}

/// Appends every path of a use tree such as `a::{b, c::{self, d}}`; returns what follows the tree.
fn expand_use_tree<'a>(
    text: &'a str,
    prefix: &mut Vec<String>,
    found: &mut Vec<Vec<String>>,
) -> &'a str {
    let text = text.trim_start();
    if let Some(mut rest) = text.strip_prefix('{') {
        loop {
            rest = rest.trim_start();
            if let Some(after) = rest.strip_prefix('}') {
                return after;
            }
            if rest.is_empty() {
                return rest;
            }
            rest = match rest.strip_prefix(',') {
                Some(after) => after,
                None => {
                    let depth = prefix.len();
                    let after = expand_use_tree(rest, prefix, found);
                    prefix.truncate(depth);
                    // Skips text that is not part of a path, such as `as Name`.
                    let end = after.find([',', '}']).unwrap_or(after.len());
                    &after[end..]
                }
            };
        }
    }
    let end = text.find(|c| !is_word(c)).unwrap_or(text.len());
    let (word, rest) = text.split_at(end);
    if !word.is_empty() && word != "self" {
        prefix.push(word.to_owned());
    }
    match rest.strip_prefix("::") {
        Some(after) if !word.is_empty() => expand_use_tree(after, prefix, found),
        _ => {
            found.push(prefix.clone());
            rest
        }
    }
}

/// The first segments of all paths that begin with `root`.
fn paths_from(root: &str, code: &str) -> Vec<String> {
    code.match_indices(root)
        .filter(|(at, _)| !preceded_by_word(code, *at))
        .flat_map(|(at, _)| first_names(&code[at + root.len()..]))
        .collect()
}

/// The first segment of each path in a list: of `a::b`, or of each in `{a::b, c::{d, e}}`.
fn first_names(text: &str) -> Vec<String> {
    let word = |text: &str| -> String {
        text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
    };
    let Some(group) = text.strip_prefix('{') else { return vec![word(text)] };
    let (mut depth, mut start, mut found) = (0, 0, Vec::new());
    for (i, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' | ',' if depth == 0 => {
                found.push(word(group[start..i].trim_start()));
                start = i + 1;
                if c == '}' {
                    break;
                }
            }
            '}' => depth -= 1,
            _ => {}
        }
    }
    found.retain(|name| !name.is_empty());
    found
}

/// Whether `code` contains this path or word as a whole.
fn names(code: &str, word: &str) -> bool {
    code.match_indices(word).any(|(at, _)| {
        let after = code[at + word.len()..].chars().next();
        let goes_on = after.is_some_and(|c| c.is_alphanumeric() || c == '_');
        // `.log()` and `.print()` are methods and `fn log` is a local name: only paths and macros refer to other
        // crates.
        let reaches = word.contains("::")
            || word.starts_with(char::is_uppercase)
            || word.starts_with("roundel_")
            || code[at + word.len()..].starts_with("::")
            || (code[at + word.len()..].starts_with('!')
                && !code[at + word.len()..].starts_with("!="))
            || code[..at].trim_end().ends_with("use");
        !goes_on && !preceded_by_word(code, at) && reaches
    })
}

fn preceded_by_word(code: &str, at: usize) -> bool {
    code[..at].chars().next_back().is_some_and(|c| c.is_alphanumeric() || c == '_' || c == '$')
}
