//! Configurations of cameras that are mounted on objects or localize themselves, right and wrong.

use nalgebra::Vector3;
use roundel_core::world::MotionClass;
use roundel_server::model::config::{Config, MountConfig, ObjectRoundels, PoseConfig};

use super::{EXAMPLE, expect, lab, problems};

const ON_DRONE: &str = "object = \"drone\", ";
const STATION: &str =
    "code = 9\nposition_m = [4.0, 1.0, 0.5]\nright = [0.0, -1.0, 0.0]\ntop = [0.0, 0.0, 1.0]";
const DRONE: &str = "roundel = \"shuttle\"\ncode = 7";

fn parse(text: &str) -> Config {
    Config::parse(text, lab().path()).map_err(|p| format!("{p:#?}")).unwrap()
}

/// The mount of the camera with this index, and the name of its object.
fn mount(config: &Config, camera: usize) -> (MountConfig, &str) {
    let PoseConfig::Mounted(mount) = config.cameras[camera].pose else {
        panic!("the camera is fixed")
    };
    (mount, &config.objects[mount.object].name)
}

#[test]
fn reads_the_mounts_of_the_example() {
    let config = parse(EXAMPLE);
    let (drone, name) = mount(&config, 2);
    assert_eq!((name, drone.localizes), ("drone", false));
    // The camera looks down, with the top of its image ahead.
    let turn = drone.object_from_camera.rotation;
    assert!((turn * Vector3::z() + Vector3::z()).norm() < 1e-3);
    assert!((turn * -Vector3::y() - Vector3::x()).norm() < 1e-3);
    let (forklift, name) = mount(&config, 3);
    assert_eq!((name, forklift.localizes), ("forklift", true));
    let turn = forklift.object_from_camera.rotation;
    assert!((turn * Vector3::z() - Vector3::x()).norm() < 1e-9);
    assert!((turn * -Vector3::y() - Vector3::z()).norm() < 1e-9);
    // The forklift carries no roundels and drives on the ground.
    let ObjectRoundels::Body(body) = &config.objects[forklift.object].carries else {
        panic!("no body")
    };
    assert!(body.mounts.is_empty());
    assert_eq!(body.motion, MotionClass::Ground { height_m: Some(0.0) });
    // The station's roundel faces -x; the other references have no configured orientation.
    let station = &config.references[4];
    assert_eq!(station.code.map(|code| (code.bits, code.number)), Some((8, 9)));
    assert!((station.orientation.unwrap() * Vector3::z() + Vector3::x()).norm() < 1e-9);
    assert_eq!((config.references[0].code, config.references[0].orientation), (None, None));
}

/// Each change leaves enough information to localize the cameras.
#[test]
fn accepts_sufficient_information() {
    for (from, to) in [
        // Three references of any kind.
        (STATION, "position_m = [4.0, 1.0, 0.5]"),
        // A single reference with code and orientation, flat on the floor.
        (STATION, "code = 9\nposition_m = [4.0, 1.0, 0.5]\nyaw_deg = 180"),
        // Two plain roundels side by side on the object.
        (
            DRONE,
            "roundel = [{ kind = \"wagon\", position_m = [0, 0, 0] }, { kind = \"crawler\", position_m = [0.3, 0, 0] }]",
        ),
        // The forklift additionally has a code.
        (
            "name = \"forklift\"\nmotion",
            "name = \"forklift\"\nroundel = \"shuttle\"\ncode = 8\nmotion",
        ),
        // The default value, written explicitly.
        (ON_DRONE, "object = \"drone\", localizes = false, "),
    ] {
        assert!(EXAMPLE.contains(from), "{from}");
        parse(&EXAMPLE.replacen(from, to, 1));
    }
}

#[test]
fn names_what_is_wrong_with_a_mount() {
    let folder = lab();
    for (from, to, expected) in [
        (
            ON_DRONE,
            "object = \"dorne\", ",
            "no [[object]] is named \"dorne\"; did you mean \"drone\"?",
        ),
        (
            ON_DRONE,
            "object = \"blimp\", ",
            "configured: `robot one`, `robot two`, `carrier`, `drone`, `forklift`",
        ),
        (ON_DRONE, "object = 7, ", "`object` must be a text in quotes that is not empty, found 7"),
        (
            ON_DRONE,
            "object = \"robot one\", ",
            "object \"robot one\" does not say which way its camera looks: its plain roundel looks the same \
             however it is turned",
        ),
        (
            DRONE,
            "roundel = \"crawler\"",
            "object \"drone\" does not say which way its camera looks: its elliptical disc looks the same \
             after half a turn",
        ),
        (
            DRONE,
            "roundel = [{ kind = \"wagon\", position_m = [0, 0, 0] }]",
            "its roundels look the same when it turns about their normal",
        ),
        (
            DRONE,
            "roundel = [{ kind = \"crawler\", position_m = [0, 0, 0] }]",
            "its elliptical disc looks the same after half a turn",
        ),
        (
            ", localizes = true",
            ", localizes = \"yes\"",
            "`localizes` must be true or false, found the text \"yes\"",
        ),
        (
            "object = \"forklift\", ",
            "",
            "`localizes` is for a camera that rides on an object, and `object` is missing",
        ),
        (
            ", localizes = true",
            "",
            "object \"forklift\" carries no roundel, and its camera does not say where it is",
        ),
        ("object = \"forklift\", ", "object = \"drone\", ", "missing key `roundel` in [[object]]"),
        (
            "name = \"forklift\"\nmotion",
            "name = \"forklift\"\ncode = 8\nmotion",
            "`code` is for an object with one roundel, and `roundel` is missing",
        ),
        ("position_m = [0.3, 0.0, 0.4], ", "", "missing key `position_m` in pose"),
        (
            "orientation_xyzw = [-0.5, 0.5, -0.5, 0.5]",
            "orientation_xyzw = [0, 0, 0, 0]",
            "length 0",
        ),
        ("code = 9", "code = 90", "`code` must be 1 to 16, found 90"),
        ("code = 9", "code = 7", "reference 5 and object \"drone\" carry code 7"),
        (
            "roundel = \"robot\"\n",
            "roundel = \"reference\"\n",
            "reference 1 and object \"robot one\" carry the same kind of roundel",
        ),
        (
            "roundel = \"shuttle\"\ncode = 7",
            "roundel = \"shuttle\"",
            "write the `code` of the object's own roundel",
        ),
        (
            "[[object]]",
            "[[reference]]\nroundel = \"shuttle\"\ncode = 9\nposition_m = [4, 0, 0.5]\n[[object]]",
            "references 5 and 6 carry code 9",
        ),
        ("top = [0.0, 0.0, 1.0]\n", "", "missing key `top` in [[reference]]"),
        (
            "top = [0.0, 0.0, 1.0]\n",
            "top = [0.0, 1.0, 1.0]\n",
            "the ways in the world that the print's",
        ),
        (
            "position_m = [2.0, 0.0, 0.0]\n",
            "position_m = [2.0, 0.0, 0.0]\ncode = 3\n",
            "roundels \"reference\" have no codes",
        ),
    ] {
        expect(folder.path(), (from, to), expected);
    }
}

/// Removes the part of a text from `from` up to `to`.
fn without(text: &str, from: &str, to: &str) -> String {
    let begin = text.find(from).unwrap();
    let end = begin + text[begin..].find(to).unwrap();
    format!("{}{}", &text[..begin], &text[end..])
}

#[test]
fn a_localizing_camera_needs_sufficient_references() {
    let folder = lab();
    let known = "pose = { position_m = [0.0, 0.0, 5.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }";
    let fixed = EXAMPLE.replacen("pose = \"unknown\"", known, 1);
    let none = without(&fixed, "[[reference]]", "# Names for");
    let text = problems(&none, folder.path());
    assert!(
        text.contains("`localizes = true` needs reference roundels, and none are configured"),
        "{text}"
    );
    // Two references, neither of which has both a code and an orientation.
    let two = without(
        &fixed,
        "[[reference]]\nroundel = \"reference\"\nposition_m = [0.0, 1.5",
        "# One with",
    );
    let unturned = without(&two, "right = [0.0, -1.0", "\n# Names for");
    let text = problems(
        &without(&unturned, "[[reference]]", "[[reference]]\nroundel = \"shuttle"),
        folder.path(),
    );
    assert!(text.contains("none has both a `code` and its orientation"), "{text}");
    // One reference with both is enough for a mounted camera; a fixed one needs three.
    let one = without(&fixed, "[[reference]]", "# One with");
    parse(&one);
    let text = problems(&one.replacen(known, "pose = \"unknown\"", 1), folder.path());
    assert!(text.contains("expected at least 3 reference roundels, found 1"), "{text}");
}

#[test]
fn an_object_with_a_camera_must_be_seen_or_localize_itself() {
    let folder = lab();
    let mounted = without(EXAMPLE, "[[camera]]", "# A camera may ride");
    let text = problems(&mounted, folder.path());
    let expected =
        "no camera can say where \"drone\" is, which this one rides on: all cameras ride";
    assert!(text.contains(expected), "{text}");
    assert_eq!(text.matches("help:").count(), 1, "the forklift localizes itself:\n{text}");
    // This check is skipped while another camera has an error.
    let text = problems(&mounted.replacen("fps=30", "fsp=30", 1), folder.path());
    assert!(!text.contains(expected), "{text}");
}
