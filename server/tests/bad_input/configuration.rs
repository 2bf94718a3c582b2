//! Mistakes in a configuration, and the correct example.

use nalgebra::Vector3;
use roundel_core::{
    marker::Mode,
    world::{Body, MotionClass},
};
use roundel_server::model::config::{Config, ObjectConfig, ObjectRoundels};

use super::{EXAMPLE, lab, problems};

#[test]
fn the_example_is_a_valid_configuration() {
    let folder = lab();
    let config = Config::parse(EXAMPLE, folder.path()).map_err(|p| format!("{p:#?}")).unwrap();
    assert_eq!(config.name, "lab");
    assert_eq!((config.kinds.len(), config.cameras.len(), config.references.len()), (6, 4, 5));
    // The defaults in the example are the real ones: a file without these sections reads the same.
    let sections = ["[server]", "[detection]", "[fusion]", "[limits]"];
    let mut kept = String::new();
    let mut skipping = false;
    for line in EXAMPLE.lines() {
        if line.starts_with('[') {
            skipping = sections.contains(&line);
        }
        if !skipping {
            kept.push_str(line);
            kept.push('\n');
        }
    }
    // The calibration file's path derives from the name of the configuration file.
    let file = folder.path().join("lab.toml");
    std::fs::write(&file, kept).unwrap();
    let without_defaults = Config::load(&file).unwrap();
    assert_eq!(without_defaults.server, config.server);
    assert_eq!(without_defaults.fusion, config.fusion);
    assert_eq!(without_defaults.limits, config.limits);
    let modes = |config: &Config| config.cameras.iter().map(|it| it.mode).collect::<Vec<_>>();
    assert_eq!(modes(&without_defaults), modes(&config));
    // Coded roundels have a fixed ratio of diameters.
    let unwritten = EXAMPLE.replacen("inner_mm = 73.2\n", "", 1);
    let unwritten = Config::parse(&unwritten, folder.path()).unwrap();
    let [written, unwritten] = [&config, &unwritten].map(|config| config.kinds[2].clone());
    assert!((written.inner_diameter_m - unwritten.inner_diameter_m).abs() < 1e-12);
    assert_eq!(written.pattern, unwritten.pattern);
}

#[test]
fn objects_are_identified_by_a_kind_a_code_or_several_roundels() {
    let folder = lab();
    let read = |text: &str| -> Vec<ObjectConfig> {
        Config::parse(text, folder.path()).map_err(|p| format!("{p:#?}")).unwrap().objects
    };
    let objects = read(EXAMPLE);
    let bodies: Vec<&Body> = objects
        .iter()
        .filter_map(|object| match &object.carries {
            ObjectRoundels::Body(body) => Some(body),
            ObjectRoundels::Kind { .. } => None,
        })
        .collect();
    let [two, carrier, ..] = bodies[..] else { panic!("{objects:?}") };
    assert_eq!((objects.len(), objects[2].name.as_str()), (5, "carrier"));
    assert_eq!(two.motion, MotionClass::Ground { height_m: Some(0.25) });
    let codes = |body: &Body| -> Vec<u16> {
        body.mounts.iter().map(|mount| mount.code.map_or(0, |code| code.number)).collect()
    };
    assert_eq!((codes(two), codes(carrier)), (vec![12], vec![3, 4, 0]));
    // Directions of the roundels' x, y and z axes.
    let axes = |index: usize| {
        let turn = carrier.mounts[index].object_from_roundel.rotation;
        [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| (turn * axis).map(f64::round))
    };
    assert_eq!(axes(1), [Vector3::y(), -Vector3::x(), Vector3::z()]);
    assert_eq!(axes(2), [Vector3::y(), Vector3::z(), Vector3::x()]);
    // A TOML array of tables reads the same.
    let begin = EXAMPLE.find("roundel = [").unwrap();
    let end = begin + EXAMPLE[begin..].find("\n]\n").unwrap() + 3;
    let tables = "[[object.roundel]]\nkind = \"shuttle\"\ncode = 3\nposition_m = [0.2, 0.0, 0.3]\n";
    let listed = read(&format!("{}{tables}{}", &EXAMPLE[..begin], &EXAMPLE[end..]));
    let ObjectRoundels::Body(listed) = &listed[2].carries else { panic!("{listed:?}") };
    assert_eq!(listed.mounts, carrier.mounts[..1]);
    // An object without its own motion uses that of its first roundel's kind, at the height of that roundel.
    let shuttle = EXAMPLE.replacen(
        "inner_mm = 73.2",
        "inner_mm = 73.2\nmotion = \"ground\"\nheight_m = 0.4",
        1,
    );
    let ObjectRoundels::Body(driving) = &read(&shuttle)[2].carries else { panic!("no body") };
    let MotionClass::Ground { height_m: Some(height_m) } = driving.motion else { panic!("flies") };
    assert!((height_m - 0.1).abs() < 1e-12);
}

#[test]
fn each_camera_has_its_own_mode_or_the_common_one() {
    let folder = lab();
    let modes = |text: &str| -> Vec<Mode> {
        let config = Config::parse(text, folder.path()).map_err(|p| format!("{p:#?}")).unwrap();
        config.cameras.iter().map(|camera| camera.mode).collect()
    };
    assert_eq!(modes(EXAMPLE), [Mode::Fast, Mode::Precise, Mode::Precise, Mode::Precise]);
    let all = EXAMPLE.replacen("mode = \"precise\"", "mode = \"fast\"", 1);
    assert_eq!(modes(&all), [Mode::Fast; 4]);
    let own = EXAMPLE.replacen("mode = \"fast\"\n", "", 1);
    assert_eq!(modes(&own), [Mode::Precise; 4]);
}

/// The keys in a line of TOML with their columns, including table names and keys of inline tables.
fn keys(line: &str) -> Vec<(usize, &str)> {
    if line.starts_with('#') {
        return Vec::new();
    }
    if line.starts_with('[') {
        let name = line.trim_matches(['[', ']']);
        return vec![(line.find(name).unwrap(), name)];
    }
    // Options inside quoted strings are not keys.
    let outside: String = line
        .split('"')
        .enumerate()
        .map(|(part, text)| if part % 2 == 0 { text.to_owned() } else { " ".repeat(text.len()) })
        .collect::<Vec<_>>()
        .join(" ");
    outside
        .match_indices('=')
        .map(|(equals, _)| {
            let before = outside[..equals].trim_end();
            let start = before.rfind([' ', '{', ',']).map_or(0, |at| at + 1);
            (start, &line[start..before.len()])
        })
        .collect()
}

#[test]
fn every_mistyped_key_is_named_with_its_location_and_a_correction() {
    let folder = lab();
    let lines: Vec<&str> = EXAMPLE.lines().collect();
    let mut checked = 0;
    for (number, line) in lines.iter().enumerate() {
        for (column, key) in keys(line) {
            // Doubles the last letter but one.
            let at = key.len() - 1;
            let typed = format!("{}{}{}", &key[..at], &key[at - 1..at], &key[at..]);
            let mut broken: Vec<String> = lines.iter().map(ToString::to_string).collect();
            broken[number].replace_range(column..column + key.len(), &typed);
            let text = problems(&broken.join("\n"), folder.path());
            let place = format!("lab.toml:{}:{}: unknown key `{typed}`", number + 1, column + 1);
            assert!(text.contains(&place), "no \"{place}\" in\n{text}");
            assert!(text.contains(&format!("did you mean `{key}`?")), "{key}:\n{text}");
            assert!(!text.contains(&format!("missing key `{key}`")), "{key}:\n{text}");
            checked += 1;
        }
    }
    assert!(checked > 53, "only {checked} keys were found in the example");
}

#[test]
fn distinguishes_one_polygon_from_a_list() {
    let folder = lab();
    let begin = EXAMPLE.find("mask = [").unwrap();
    let end = begin + EXAMPLE[begin..].find("\n]\n").unwrap() + 3;
    let with = |mask: &str| format!("{}{mask}\n{}", &EXAMPLE[..begin], &EXAMPLE[end..]);
    for (mask, expected) in [
        ("mask = [[0, 0], [200, 0], [200, 90]]", "found the corners of one"),
        ("mask = \"left\"", "`mask` must be a list of polygons, found the text \"left\""),
    ] {
        let text = problems(&with(mask), folder.path());
        assert!(text.contains(expected), "{mask} does not give \"{expected}\" but\n{text}");
    }
    assert!(Config::parse(&with("mask = []"), folder.path()).is_ok());
}

#[test]
fn names_missing_sections() {
    let folder = lab();
    let text = problems("", folder.path());
    assert!(text.contains("no kind of roundel is configured"), "{text}");
    assert!(text.contains("no camera is configured"), "{text}");

    // Without mounted cameras, and so without what only those need.
    let (from, to) =
        (EXAMPLE.find("# A camera may ride").unwrap(), EXAMPLE.find("# Roundels with").unwrap());
    let (one, next) =
        (EXAMPLE.find("# One with a code").unwrap(), EXAMPLE.find("# Names for").unwrap());
    let forklift = EXAMPLE.find("[[object]]\nname = \"forklift\"").unwrap();
    let rest = EXAMPLE.find("[fusion]").unwrap();
    let parts = [&EXAMPLE[..from], &EXAMPLE[to..one], &EXAMPLE[next..forklift], &EXAMPLE[rest..]];
    let standing = parts.concat();
    let cut = |text: &str, begin: usize| {
        let end = text.find("# Names for objects").unwrap();
        format!("{}{}", &text[..begin], &text[end..])
    };
    let three = cut(&standing, standing.rfind("[[reference]]").unwrap());
    let two = cut(&three, three.rfind("[[reference]]").unwrap());
    assert!(Config::parse(&three, folder.path()).is_ok());
    let text = problems(&two, folder.path());
    assert!(text.contains("expected at least 3 reference roundels, found 2"), "{text}");

    let line = three.replacen("[0.0, 1.5, 0.0]", "[4.0, 0.0, 0.0]", 1);
    let text = problems(&line, folder.path());
    assert!(text.contains("all reference roundels lie in one line"), "{text}");

    let none = cut(&standing, standing.find("[[reference]]").unwrap());
    let text = problems(&none, folder.path());
    assert!(text.contains("`pose = \"unknown\"` needs reference roundels, and none"), "{text}");
}

#[test]
fn reports_all_problems_in_order() {
    let folder = lab();
    let broken = EXAMPLE
        .replacen("listen =", "listne =", 1)
        .replacen("outer_mm = 160.0", "outer_mm = true", 1)
        .replacen("max_objects = 1000", "max_objects = -1", 1);
    let text = problems(&broken, folder.path());
    let places: Vec<usize> = ["listne", "`outer_mm` must be", "`max_objects` must be"]
        .map(|part| text.find(part).unwrap_or_else(|| panic!("no {part} in\n{text}")))
        .to_vec();
    assert!(places.is_sorted(), "not in the order of the lines:\n{text}");
}
