//! Dependencies between crates and modules, purity of core, and conversion between core's types and messages.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use roundel_tests::{
    layering::{
        CORE_CRATES, CRATE_DEPENDENCIES, forbidden_dependencies, import_cycles, impurities,
        misplaced_types, shipped_code, stray_names, upward_server_imports,
    },
    process::workspace_root,
};

/// Every Rust source under a folder, with its path relative to it.
fn sources(folder: &Path) -> Vec<(String, String)> {
    fn collect(folder: &Path, found: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).unwrap().map(Result::unwrap) {
            let path = entry.path();
            if path.is_dir() {
                collect(&path, found);
            } else if path.extension().is_some_and(|end| end == "rs") {
                found.push(path);
            }
        }
    }
    let mut found = Vec::new();
    collect(folder, &mut found);
    found
        .into_iter()
        .map(|path| {
            let name = path.strip_prefix(folder).unwrap().to_string_lossy().replace('\\', "/");
            (name, fs::read_to_string(&path).unwrap())
        })
        // Files that are test modules as a whole (`#[cfg(test)] mod tests;`) do not ship.
        .filter(|(name, _)| !name.ends_with("/tests.rs") && !name.contains("/tests/"))
        .collect()
}

fn assert_clean(broken: &[String]) {
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn the_top_level_has_the_known_folders_only() {
    let names: Vec<String> = fs::read_dir(workspace_root())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
        .collect();
    assert_clean(&stray_names(&names));
}

#[test]
fn crates_depend_one_way() {
    let output = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
        .args(["metadata", "--no-deps", "--offline", "--format-version", "1"])
        .current_dir(workspace_root())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let (mut all, mut shipped) = (BTreeMap::new(), BTreeMap::new());
    for package in metadata["packages"].as_array().unwrap() {
        let name = package["name"].as_str().unwrap().to_owned();
        let dependencies = package["dependencies"].as_array().unwrap();
        let names = |development: bool| -> Vec<String> {
            dependencies
                .iter()
                .filter(|dependency| development || dependency["kind"].as_str() != Some("dev"))
                .map(|dependency| dependency["name"].as_str().unwrap().to_owned())
                .collect()
        };
        all.insert(name.clone(), names(true));
        shipped.insert(name, names(false));
    }
    assert_clean(&forbidden_dependencies(&all, &shipped));
}

#[test]
fn core_is_pure() {
    let mut broken = Vec::new();
    for folder in CORE_CRATES {
        let files = sources(&workspace_root().join(folder).join("src"));
        assert!(!files.is_empty(), "{folder}");
        for (path, source) in &files {
            broken.extend(impurities(&format!("{folder}/src/{path}"), source));
        }
    }
    assert_clean(&broken);
}

#[test]
fn imports_of_the_server_run_down() {
    let files = sources(&workspace_root().join("server/src"));
    let broken: Vec<_> =
        files.iter().flat_map(|(path, source)| upward_server_imports(path, source)).collect();
    assert_clean(&broken);
}

#[test]
fn files_do_not_import_each_other_in_a_cycle() {
    for folder in ["proto", "server", "client/rust", "tests"].into_iter().chain(CORE_CRATES) {
        let files = sources(&workspace_root().join(folder).join("src"));
        assert!(!files.is_empty(), "{folder}");
        assert_clean(&import_cycles(&files));
    }
}

#[test]
fn upward_imports_of_the_server_are_rejected() {
    for (path, source, used) in [
        ("model/hub.rs", "use crate::archive::record::Tap;", "archive"),
        ("fusion/mod.rs", "use crate::{api::{ApiState, error::E}, model::hub::Hub};", "api"),
        ("lab/plan/mod.rs", "fn f() { crate::archive::eval::run() }", "archive"),
        ("api/ws/socket.rs", "use super::super::super::app::cli;", "app"),
    ] {
        let broken = upward_server_imports(path, source);
        assert_eq!(broken.len(), 1, "{path}: {source}: {broken:?}");
        assert!(broken[0].contains(&format!("`{used}`")), "{broken:?}");
    }
    let good = "use crate::{capture::worker, model::hub::Hub, fusion::calibration};";
    assert_clean(&upward_server_imports("fusion/mod.rs", good));
    assert!(upward_server_imports("gadget/mod.rs", "")[0].contains("no layer"));
}

#[test]
fn cycles_are_found_at_every_depth() {
    let files = |list: &[(&str, &str)]| -> Vec<(String, String)> {
        list.iter().map(|(path, text)| ((*path).to_owned(), (*text).to_owned())).collect()
    };
    let top = [("a/mod.rs", "use crate::b::x::Y as Z;"), ("b/x.rs", "use crate::{a::{self, T}};")];
    assert_eq!(import_cycles(&files(&top)).len(), 1);
    let deep =
        [("a/b.rs", "use super::c::D;"), ("a/c.rs", "fn f() { super::b::g() }"), ("a/mod.rs", "")];
    assert_eq!(import_cycles(&files(&deep)), ["cycle in a: b -> c; c -> b"]);
    let three =
        [("a.rs", "use crate::b::X;"), ("b.rs", "use crate::c::X;"), ("c.rs", "use crate::a::X;")];
    assert_eq!(import_cycles(&files(&three)).len(), 1);
    let none = [
        ("a/mod.rs", "mod b; mod c; pub use b::B; use self::c::C;"),
        ("a/b.rs", "use super::{Own, c::{self, C}}; use crate::d::D;"),
        ("a/c.rs", "use super::Own; #[cfg(test)] mod tests { use super::super::b::B; }"),
        ("d.rs", "// crate::a::b"),
    ];
    assert_clean(&import_cycles(&files(&none)));
}

#[test]
fn only_one_file_converts_between_core_and_proto() {
    let files = sources(&workspace_root().join("server/src"));
    assert!(!files.is_empty());
    let broken: Vec<_> =
        files.iter().flat_map(|(path, source)| misplaced_types(path, source)).collect();
    assert_clean(&broken);
}

#[test]
fn an_unexpected_folder_is_rejected() {
    let names = ["core", "README.md", ".ci", "scripts"].map(str::to_owned);
    let broken = stray_names(&names);
    assert_eq!(broken.len(), 1);
    assert!(broken[0].contains("`scripts`"));
}

#[test]
fn wrong_dependencies_are_rejected() {
    let own = |list: &[&str]| list.iter().map(|name| (*name).to_owned()).collect::<Vec<String>>();
    let crates = |fusion: &[&str], client: &[&str]| -> BTreeMap<String, Vec<String>> {
        let mut all: BTreeMap<_, _> =
            CRATE_DEPENDENCIES.iter().map(|(name, used)| ((*name).to_owned(), own(used))).collect();
        all.insert("roundel-fusion".to_owned(), own(fusion));
        all.insert("roundel-client".to_owned(), own(client));
        all
    };
    let broken = |fusion: &[&str], client: &[&str]| {
        let all = crates(fusion, client);
        forbidden_dependencies(&all, &all)
    };
    assert_clean(&broken(&["nalgebra", "roundel-vision"], &["roundel-proto", "tonic"]));
    assert_eq!(broken(&["tokio"], &[]).len(), 1);
    assert_eq!(broken(&["roundel-proto"], &[]).len(), 1);
    assert_eq!(broken(&[], &["roundel-core"]).len(), 1);
    assert_eq!(forbidden_dependencies(&BTreeMap::new(), &BTreeMap::new()).len(), 9);
}

#[test]
fn impure_code_is_rejected_and_comments_about_it_are_not() {
    for bad in [
        "fn now() -> f64 { std::time::Instant::now().elapsed().as_secs_f64() }",
        "use std::time::SystemTime;",
        "fn f() { println!(\"x\"); }",
        "fn f() { let s = std::fs::read_to_string(\"x\"); }",
        "use std::{collections::HashMap, env};",
        "use std::{time::Instant as Clock};",
        "fn f() { std::net::TcpStream::connect(\"\"); }",
        "use tracing::info;",
        "fn f() { log::warn!(\"\") }",
    ] {
        assert!(!impurities("x.rs", bad).is_empty(), "{bad}");
    }
    for good in [
        "//! No Instant here, no println! either.\nfn f(x: f64) -> f64 { x.log(2.0) }",
        "/* std::fs */ const A: &str = \"SystemTime::now()\";",
        "const A: &str = r#\"std::fs \" println!\"#; fn log(x: f64) -> f64 { x }",
        "fn f() {}\n#[cfg(test)]\nmod tests { fn g() { println!(\"{}\", '{'); } }",
        "struct Instant { at: f64 } fn f<'a>(x: &'a str) -> &'a str { x }",
    ] {
        assert_clean(&impurities("x.rs", good));
    }
    // Code after a test item is checked again.
    assert_eq!(impurities("x.rs", "#[cfg(test)]\nuse a::{b};\nfn f() { dbg!(1); }").len(), 1);
}

#[test]
fn conversions_elsewhere_are_rejected() {
    let both = "use roundel_core::world; use roundel_proto::v1;\n";
    let convert = "fn f(s: &world::Snapshot) -> v1::Snapshot { v1::Snapshot { sequence: 1 } }";
    let pass_on = "fn f(s: &world::Snapshot) -> v1::Snapshot { convert::snapshot(s) }";
    assert_clean(&misplaced_types("model/convert.rs", &format!("{both}{convert}")));
    assert_clean(&misplaced_types("api/grpc.rs", &format!("{both}{pass_on}")));
    assert_clean(&misplaced_types("api/query.rs", "use roundel_proto::v1; f(v1::Pose { x })"));
    assert_clean(&misplaced_types(
        "capture/worker/mod.rs",
        "// roundel_proto\nuse roundel_core::frame::Frame;",
    ));
    for (path, source) in [
        ("archive/record.rs", format!("{both}{convert}")),
        ("model/hub.rs", format!("{both}use v1::Pose; fn f() {{ let p = Pose {{ x }}; }}")),
        ("fusion/mod.rs", "use roundel_proto::v1::Snapshot;".to_owned()),
        ("capture/source/images.rs", "use roundel_proto::v1::Camera;".to_owned()),
    ] {
        assert_eq!(misplaced_types(path, &source).len(), 1, "{path}");
    }
}

#[test]
fn test_code_is_removed() {
    let code = shipped_code("fn a() {} // b\n#[cfg(test)]\nmod tests { fn c() {} }\nfn d() {}");
    assert!(code.contains("fn a()") && code.contains("fn d()"));
    assert!(!code.contains('b') && !code.contains("fn c"));
}
