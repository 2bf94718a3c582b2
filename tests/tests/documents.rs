//! Checks every Markdown file of the repository: links and anchors resolve, commands exist, and the README is short.
//! Each problem names file, line and remedy.

use std::{collections::BTreeMap, fs, path::PathBuf, process::Command};

use roundel_tests::process::workspace_root;
use serde_json::Value;

const README_LINES: usize = 200;
const README_WORDS: usize = 1500;
const README_LINE_CHARS: usize = 160;
/// Cargo's subcommands that documents use.
const SUBCOMMANDS: [&str; 9] =
    ["bench", "build", "check", "clippy", "deny", "fmt", "install", "run", "test"];

/// Programs whose subcommands and options are checked.
#[derive(Clone, Copy)]
enum Program {
    Roundel,
    Tests,
}

/// Everything that documents may refer to.
struct Repository {
    root: PathBuf,
    /// Text of each document, by its path below the root.
    documents: BTreeMap<String, String>,
    /// From `cargo metadata`.
    packages: Vec<Value>,
    /// From `.cargo/config.toml`.
    aliases: BTreeMap<String, String>,
}

impl Repository {
    fn read() -> Self {
        let root = workspace_root().canonicalize().unwrap();
        let run = |program: &str, arguments: &str| {
            let mut command = Command::new(program);
            let output = command.args(arguments.split(' ')).current_dir(&root).output().unwrap();
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            String::from_utf8(output.stdout).unwrap()
        };
        let metadata = run("cargo", "metadata --no-deps --offline --format-version 1");
        let metadata: Value = serde_json::from_str(&metadata).unwrap();
        let config = fs::read_to_string(root.join(".cargo/config.toml")).unwrap();
        let alias = |line: &str| {
            let (name, words) = line.split_once(" = ")?;
            Some((name.to_owned(), words.trim_matches('"').to_owned()))
        };
        let listed = run("git", "ls-files --cached --others --exclude-standard *.md");
        let document =
            |name: &str| Some((name.to_owned(), fs::read_to_string(root.join(name)).ok()?));
        Self {
            documents: listed.lines().filter_map(document).collect(),
            packages: metadata["packages"].as_array().unwrap().clone(),
            aliases: config.lines().filter_map(alias).collect(),
            root,
        }
    }

    fn problems(&self, name: &str, text: &str) -> Vec<String> {
        let mut problems = Vec::new();
        let mut in_fence = false;
        for (line, number) in text.lines().zip(1..) {
            let mut report = |problem| problems.push(format!("{name}:{number}: {problem}"));
            if line.trim_start().starts_with("```") {
                in_fence = !in_fence;
            } else if in_fence || line.starts_with("    ") {
                self.command_problems(line).into_iter().for_each(report);
            } else {
                let code = line.split('`').skip(1).step_by(2);
                code.flat_map(|code| self.command_problems(code)).for_each(&mut report);
                let prose: String = line.split('`').step_by(2).collect();
                let links =
                    prose.split("](").skip(1).filter_map(|rest| rest.split([')', ' ']).next());
                links.filter_map(|link| self.link_problem(name, text, link)).for_each(report);
            }
        }
        problems
    }

    /// The problem of a broken link.
    fn link_problem(&self, name: &str, text: &str, link: &str) -> Option<String> {
        if link.contains("://") {
            return None;
        }
        let (path, anchor) = link.split_once('#').unwrap_or((link, ""));
        let (mut other, mut text) = (name.to_owned(), text);
        if !path.is_empty() {
            let target = self.root.join(name).parent()?.join(path).canonicalize().ok();
            let Some(below) = target.as_ref().and_then(|it| it.strip_prefix(&self.root).ok())
            else {
                return Some(format!("{path} is not in the repository: correct the link"));
            };
            other = below.to_string_lossy().into_owned();
            text = self.documents.get(&other).map_or("", String::as_str);
        }
        let anchors = anchors(text);
        let is_known = anchor.is_empty() || anchors.iter().any(|known| known == anchor);
        let known = anchors.join(", ");
        (!is_known).then(|| format!("no heading #{anchor} in {other}: use one of {known}"))
    }

    /// Problems of a line of shell that runs cargo, one of our programs or a script, or of a path of a source file.
    fn command_problems(&self, line: &str) -> Vec<String> {
        let line = line.split(" #").next().unwrap_or_default();
        line.split(['|', '&', ';', '(', ')'])
            .filter_map(|part| self.command_problem(part))
            .collect()
    }

    fn command_problem(&self, command: &str) -> Option<String> {
        let is_variable = |word: &&str| word.split_once('=').is_some_and(|(name, _)| is_name(name));
        let mut words = command.split_whitespace().skip_while(is_variable);
        let first = match words.next()? {
            "cargo" => return self.cargo_problem(&words.collect::<Vec<_>>()),
            "roundel" => return self.program_problem(Program::Roundel, &words.collect::<Vec<_>>()),
            "python" => words.next()?,
            first => first,
        };
        let folders = ["tests/", "deploy/", "client/", ".ci/"];
        let is_ours = folders.iter().any(|it| first.starts_with(it)) && !first.contains('…');
        let is_source = first.contains('/') && first.ends_with(".rs");
        let exists = [&self.root, &self.root.join("server/src")].map(|it| it.join(first).exists());
        let is_missing = (is_ours || is_source) && exists == [false; 2];
        is_missing.then(|| format!("{first} is not in the repository: correct the path"))
    }

    fn cargo_problem(&self, words: &[&str]) -> Option<String> {
        let (name, words) = words.split_first()?;
        if let Some(alias) = self.aliases.get(*name) {
            let words: Vec<&str> = alias.split(' ').chain(words.iter().copied()).collect();
            return self.cargo_problem(&words);
        }
        if !SUBCOMMANDS.contains(name) {
            return Some(format!("cargo {name} is neither a subcommand nor an alias: correct it"));
        }
        let end = words.iter().position(|word| *word == "--").unwrap_or(words.len());
        let (options, rest) = words.split_at(end);
        let values = |option: &str| -> Vec<&str> {
            let pairs = options.windows(2).filter(|pair| pair[0] == option && pair[1] != "…");
            pairs.map(|pair| pair[1]).collect()
        };
        let all = options.contains(&"--workspace");
        let mut names = values("-p");
        let known = |name: &&&str| self.packages.iter().any(|package| package["name"] == ***name);
        if let Some(name) = names.iter().find(|name| !known(name)) {
            return Some(format!("no package {name}: correct -p"));
        }
        if names.is_empty() {
            names.push("roundel-server");
        }
        let is_chosen = |it: &&Value| all || names.iter().any(|name| it["name"] == *name);
        let packages: Vec<&Value> = self.packages.iter().filter(is_chosen).collect();
        let lists = values("--features");
        let features: Vec<&str> = lists.iter().flat_map(|list| list.split(',')).collect();
        for feature in &features {
            let bare = feature.rsplit('/').next().unwrap();
            if packages.iter().all(|package| package["features"][bare].is_null()) {
                return Some(format!("no feature {feature}: correct --features or -p"));
            }
        }
        for option in ["--bin", "--test", "--bench", "--example"] {
            for name in values(option) {
                let targets = packages.iter().flat_map(|it| it["targets"].as_array().unwrap());
                let is_match = |it: &&Value| it["kind"][0] == option[2..] && it["name"] == name;
                let Some(target) = targets.clone().find(is_match) else {
                    return Some(format!("no target {option} {name}: correct the name or -p"));
                };
                let mut needed = target["required-features"].as_array().into_iter().flatten();
                let has = |it: &Value| features.iter().any(|f| f.rsplit('/').next() == it.as_str());
                if let Some(feature) = needed.find(|feature| !has(feature)) {
                    return Some(format!("{option} {name} needs --features {feature}: add it"));
                }
            }
        }
        let program = match names[..] {
            ["roundel-server"] => Program::Roundel,
            ["roundel-tests"] => Program::Tests,
            _ => return None,
        };
        if *name == "run" { self.program_problem(program, rest.get(1..)?) } else { None }
    }

    /// Checks a subcommand and its options against the sources of the command line.
    fn program_problem(&self, program: Program, words: &[&str]) -> Option<String> {
        let subcommand = words.first().filter(|word| is_name(word) && !word.starts_with('-'))?;
        let (program, folder) = match program {
            Program::Roundel => ("roundel", "server/src/app/cli"),
            Program::Tests => ("roundel-tests", "tests/src/run"),
        };
        let file = self.root.join(folder).join(format!("{}.rs", subcommand.replace('-', "_")));
        if !file.exists() && !file.with_extension("").exists() {
            return Some(format!("no command {program} {subcommand}: see {program} --help"));
        }
        let mut source = fs::read_to_string(&file).unwrap_or_default();
        for entry in fs::read_dir(file.with_extension("")).into_iter().flatten().flatten() {
            source += &fs::read_to_string(entry.path()).unwrap_or_default();
        }
        // Options that several commands share.
        if source.contains("ConnectionArgs") {
            source += &fs::read_to_string(file.with_file_name("connection.rs")).unwrap_or_default();
        }
        let mut options = words.iter().filter_map(|word| word.strip_prefix("--"));
        let unknown = options.find(|option| {
            if *option == "help" {
                return false;
            }
            let field = format!(" {}: ", option.replace('-', "_"));
            !source.contains(&field) && !source.contains(&format!("\"{option}\""))
        });
        unknown.map(|option| format!("{program} {subcommand} has no --{option}: see its --help"))
    }
}

/// A word of letters, digits, dashes and underscores.
fn is_name(word: &str) -> bool {
    !word.is_empty() && word.chars().all(|c| c.is_alphanumeric() || "-_".contains(c))
}

/// Anchors of a document's headings, as GitHub makes them.
fn anchors(text: &str) -> Vec<String> {
    let mut anchors: Vec<String> = Vec::new();
    for line in text.split("```").step_by(2).flat_map(str::lines) {
        let heading = line.trim_start_matches('#');
        if heading.len() == line.len() || !heading.starts_with(' ') {
            continue;
        }
        let kept = heading.trim().chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c));
        let anchor = kept.collect::<String>().to_lowercase().replace(' ', "-");
        let count = anchors.iter().filter(|known| **known == anchor).count();
        anchors.push(if count == 0 { anchor } else { format!("{anchor}-{count}") });
    }
    anchors
}

/// Excess length of the README.
fn length_problems(text: &str) -> Vec<String> {
    let (lines, words) = (text.lines().count(), text.split_whitespace().count());
    let mut problems = Vec::new();
    if lines > README_LINES || words > README_WORDS {
        problems.push(format!(
            "README.md:{lines}: {lines} lines and {words} words, at most {README_LINES} and \
             {README_WORDS}: move something to another document"
        ));
    }
    for (line, number) in text.lines().zip(1..) {
        if line.chars().count() > README_LINE_CHARS {
            problems.push(format!(
                "README.md:{number}: above {README_LINE_CHARS} characters: break it"
            ));
        }
    }
    problems
}

#[test]
fn links_and_commands_of_all_documents_hold() {
    let repository = Repository::read();
    assert!(repository.documents.len() > 15, "{:?}", repository.documents.keys());
    let mut problems = length_problems(&repository.documents["README.md"]);
    for (name, text) in &repository.documents {
        problems.extend(repository.problems(name, text));
    }
    assert!(problems.is_empty(), "{} problems:\n{}", problems.len(), problems.join("\n"));
}

#[test]
fn problems_are_found_with_their_lines() {
    let repository = Repository::read();
    let cases = [
        ("# A b\n\n[c](#a-b) [d](../README.md#figures) ![e](run) [f](https://x.y)", ""),
        ("a [b](no/file.md)", "x.md:1: no/file.md is not"),
        ("a [b](../../etc)", "../../etc is not"),
        ("a [b](../README.md#no)", "no heading #no in README.md"),
        ("# A\n# A\n\n[b](#a-1)\n[b](#a-2)", "x.md:5: no heading #a-2"),
        ("a `cargo test -p roundel-none`", "no package roundel-none"),
        (
            "```sh\nA=b cargo bench -p roundel-core --bench none\n```",
            "x.md:2: no target --bench none",
        ),
        ("    cargo run -p roundel-core --bin none", "no target --bin none"),
        ("    cargo run -p roundel-tests -- recall > x", ""),
        ("    cargo scenarios --short alone", ""),
        ("    cargo run -p roundel-tests -- chaos --none", "roundel-tests chaos has no --none"),
        ("    cargo run -p roundel-tests -- none", "no command roundel-tests none"),
        ("    cargo build --features none", "no feature none"),
        ("    cargo bench -p roundel-server --bench decode", "needs --features \"gst\""),
        ("    cargo nonsense", "cargo nonsense"),
        ("    cargo run --release -- demo --none", "roundel demo has no --none"),
        ("    cargo demo --robots 3", ""),
        ("    roundel none", "no command roundel none"),
        ("    ls && tests/none  # why", "tests/none is not"),
        ("see `model/hub.rs` and `core/src/none.rs`", "core/src/none.rs is not"),
    ];
    for (text, expected) in cases {
        let found = repository.problems("tests/x.md", text);
        let count = usize::from(!expected.is_empty());
        assert!(found.len() == count && found.concat().contains(expected), "{text}: {found:?}");
    }
    assert_eq!(length_problems("a\n"), Vec::<String>::new());
    assert_eq!(length_problems(&"a\n".repeat(201)).len(), 1);
    assert_eq!(length_problems(&"a ".repeat(1501)).len(), 2);
    assert_eq!(length_problems(&"é".repeat(161)).len(), 1);
}
