use roundel_proto::v1::{self, CameraSetup, ObjectSetup};

use super::*;

const TEXT: &str = r#"# The lab.
name = "lab"

# ---- Cameras ----

# The one by the door.
[[camera]]
name = "north"   # as on its label
source = "http://10.0.0.2/stream"
rate_hz = 30 # by its menu
pose = "unknown"

[[camera]]
source = 'v4l2:/dev/video0'
name = "south"
mask = [[[0, 0], [320, 0.5], [0, 200]]]
[camera.pose]
# By tape measure.
position_m = [0.0, 1.0, 2.0]
orientation_xyzw = [1, 0, 0, 0]

# What robots carry.
[[roundel]]
name = "robot"
"#;

fn read(text: &str, name: &str) -> Result<CameraSetup, EditError> {
    super::read(text, name)
}

fn remove(text: &str, name: &str) -> Result<String, EditError> {
    super::remove::<CameraSetup>(text, name)
}

fn vector(x: f64, y: f64, z: f64) -> v1::Vector3 {
    v1::Vector3 { x, y, z }
}

fn pose(x: f64, y: f64, z: f64) -> v1::CameraPoseSetup {
    let orientation = v1::Quaternion { x: 1.0, ..Default::default() };
    let pose = v1::Pose { position: Some(vector(x, y, z)), orientation: Some(orientation) };
    v1::CameraPoseSetup { pose: Some(pose), ..Default::default() }
}

fn unknown() -> v1::CameraPoseSetup {
    v1::CameraPoseSetup { unknown: true, ..Default::default() }
}

fn polygon(corners: [[f64; 2]; 3]) -> v1::MaskPolygon {
    v1::MaskPolygon { corners: corners.map(|[u, v]| v1::PixelPoint { u, v }).into() }
}

#[test]
fn cameras_are_read() {
    let north = read(TEXT, "north").unwrap();
    let expected = CameraSetup {
        name: "north".into(),
        source: "http://10.0.0.2/stream".into(),
        rate_hz: Some(30.0),
        pose: Some(unknown()),
        ..CameraSetup::default()
    };
    assert_eq!(north, expected);
    let south = read(TEXT, "south").unwrap();
    assert_eq!(south.pose, Some(pose(0.0, 1.0, 2.0)));
    assert_eq!(south.mask, [polygon([[0.0, 0.0], [320.0, 0.5], [0.0, 200.0]])]);
    assert_eq!(read(TEXT, "east"), Err(EditError::Missing { what: "camera", name: "east".into() }));
}

#[test]
fn an_added_camera_follows_the_last_one() {
    let camera = CameraSetup {
        name: "ea\"st".into(),
        source: "sim:r4_lite?camera=2".into(),
        rate_hz: Some(29.97),
        pose: Some(v1::CameraPoseSetup {
            object: "drone".into(),
            localizes: true,
            ..pose(1.0, -2.5, 3.0)
        }),
        mask: vec![polygon([[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]])],
        ..CameraSetup::default()
    };
    let text = add(TEXT, &camera).unwrap();
    let added = "\n[[camera]]\nname = 'ea\"st'\nsource = \"sim:r4_lite?camera=2\"\n\
                 pose = { position_m = [1.0, -2.5, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0], object = \"drone\", \
                 localizes = true }\nrate_hz = 29.97\nmask = [[[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]]]\n";
    assert_eq!(
        text,
        TEXT.replace("\n# What robots carry.", &format!("{added}\n# What robots carry."))
    );
    assert_eq!(read(&text, "ea\"st").unwrap(), camera);
    assert_eq!(remove(&text, "ea\"st").unwrap(), TEXT);
}

#[test]
fn changes_keep_comments_and_the_notation_of_equal_values() {
    let camera = CameraSetup {
        name: "door".into(),
        rate_hz: Some(30.0),
        pose: Some(pose(0.0, 1.0, 2.0)),
        mode: "fast".into(),
        ..CameraSetup::default()
    };
    let text = change(TEXT, "north", &camera, &["name", "rate_hz", "pose", "mode"]).unwrap();
    let expected = TEXT
        .replace("name = \"north\"", "name = \"door\"")
        .replace(
            "pose = \"unknown\"\n",
            "pose = { position_m = [0.0, 1.0, 2.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }\nmode = \"fast\"\n",
        );
    assert_eq!(text, expected);
    // A table with a header stays one, and an absent key is removed.
    let camera = CameraSetup { pose: Some(pose(0.0, 1.5, 2.0)), ..CameraSetup::default() };
    let text = change(TEXT, "south", &camera, &["pose", "mask"]).unwrap();
    let expected = TEXT
        .replace("[0.0, 1.0, 2.0]", "[0.0, 1.5, 2.0]")
        .replace("mask = [[[0, 0], [320, 0.5], [0, 200]]]\n", "");
    assert_eq!(text, expected);
    let camera = CameraSetup { pose: Some(unknown()), ..CameraSetup::default() };
    let text = change(TEXT, "south", &camera, &["pose"]).unwrap();
    assert_eq!(read(&text, "south").unwrap().pose, Some(unknown()), "{text}");
}

#[test]
fn a_removed_camera_takes_only_its_own_comment() {
    let text = remove(TEXT, "north").unwrap();
    let (begin, end) = (TEXT.find("# The one").unwrap(), TEXT.find("[[camera]]\nsource").unwrap());
    assert_eq!(text, [&TEXT[..begin], &TEXT[end..]].concat());
    let text = remove(TEXT, "south").unwrap();
    let (begin, end) = (TEXT.find("\n[[camera]]\nsource").unwrap(), TEXT.find("\n# What").unwrap());
    assert_eq!(text, [&TEXT[..begin], &TEXT[end..]].concat());
    let last = "a = 1\n\n# Cameras\n\n# One.\n[[camera]]\nname = \"a\"\n\n# The end.\n";
    assert_eq!(remove(last, "a").unwrap(), "a = 1\n\n# Cameras\n\n# The end.\n");
}

#[test]
fn inline_tables_are_edited() {
    let text =
        "camera = [{ name = \"a\", source = \"sim:\" }, { name = \"b\", source = \"sim:\" }]\n";
    let camera = CameraSetup { source: "push:".into(), ..CameraSetup::default() };
    let changed = change(text, "b", &camera, &["source"]).unwrap();
    assert_eq!(changed, text.replace("\"b\", source = \"sim:\"", "\"b\", source = \"push:\""));
    let camera = CameraSetup { name: "c".into(), source: "sim:".into(), ..camera };
    let added = add(text, &camera).unwrap();
    assert_eq!(read(&added, "c").unwrap(), camera);
    assert_eq!(read(&remove(&added, "a").unwrap(), "c").unwrap(), camera);
}

#[test]
fn keys_are_found_by_location_and_by_name() {
    let at = |words: &str| key_at::<CameraSetup>(TEXT, TEXT.find(words).unwrap());
    assert_eq!(at("name = \"north\""), Some((0, "name")));
    assert_eq!(at("30 # by"), Some((0, "rate_hz")));
    assert_eq!(at("by its menu"), None);
    assert_eq!(at("320, 0.5"), Some((1, "mask")));
    assert_eq!(at("orientation_xyzw"), Some((1, "pose")));
    assert_eq!(at("name = \"robot\""), None);
    assert_eq!(key_named::<CameraSetup>("missing key `pose` in [[camera]]"), Some("pose"));
    assert_eq!(key_named::<CameraSetup>("`outer_mm` is not `mode`"), Some("mode"));
    assert_eq!(key_named::<CameraSetup>("nothing at all"), None);
}

const OBJECTS: &str = r#"
[[object]] # the first one
name = "cart"
roundel = "robot"
code = 3
offset_m = [0, 0, 0.1] # to the floor

[[object]]
name = "drone"
[[object.roundel]]
kind = "robot"
code = 4
position_m = [0.2, 0, 0] # by tape
[[object.roundel]]
kind = "robot"
code = 5
position_m = [-0.2, 0, 0]
yaw_deg = 90

[[camera]]
name = "eye"
pose = { position_m = [0, 0, 0], orientation_xyzw = [0, 0, 0, 1], object = "drone" } # below
[[camera]]
name = "other"
[camera.pose]
position_m = [0, 0, 0]
orientation_xyzw = [0, 0, 0, 1]
object = "cart"
"#;

#[test]
fn objects_are_read_in_both_forms() {
    let all: Vec<ObjectSetup> = read_all(OBJECTS).unwrap();
    let [cart, drone] = &all[..] else { panic!("{all:?}") };
    assert_eq!(cart.roundel, "robot");
    assert_eq!((cart.code, cart.offset_m), (Some(3), Some(vector(0.0, 0.0, 0.1))));
    let mounts = &drone.roundels;
    assert_eq!((mounts[0].code, mounts[0].position_m), (Some(4), Some(vector(0.2, 0.0, 0.0))));
    assert_eq!((mounts[1].code, mounts[1].yaw_deg), (Some(5), Some(90.0)));
    let added = add(OBJECTS, &ObjectSetup { name: "other".into(), ..drone.clone() }).unwrap();
    let back: ObjectSetup = super::read(&added, "other").unwrap();
    assert_eq!(back.roundels, drone.roundels);
    assert_eq!(super::remove::<ObjectSetup>(&added, "other").unwrap(), OBJECTS);
}

#[test]
fn equal_values_of_an_object_keep_their_notation() {
    let mut drone: ObjectSetup = super::read(OBJECTS, "drone").unwrap();
    assert_eq!(change(OBJECTS, "drone", &drone, ObjectSetup::KEYS).unwrap(), OBJECTS);
    drone.roundels[1].position_m = Some(vector(-0.3, 0.0, 0.0));
    let text = change(OBJECTS, "drone", &drone, &["roundel"]).unwrap();
    assert_eq!(text, OBJECTS.replace("[-0.2, 0, 0]", "[-0.3, 0.0, 0.0]"));
    let cart = ObjectSetup { offset_m: Some(vector(0.0, 0.0, 0.2)), ..ObjectSetup::default() };
    let text = change(OBJECTS, "cart", &cart, &["offset_m", "code"]).unwrap();
    let expected =
        OBJECTS.replace("[0, 0, 0.1] #", "[0.0, 0.0, 0.2] #").replacen("code = 3\n", "", 1);
    assert_eq!(text, expected);
}

#[test]
fn a_list_of_roundels_is_replaced_by_a_kind() {
    let drone = ObjectSetup { roundel: "robot".into(), code: Some(6), ..ObjectSetup::default() };
    // The fields `roundel` and `roundels` correspond to the key `roundel`.
    let text = change(OBJECTS, "drone", &drone, &["roundel", "roundel", "code"]).unwrap();
    let read: ObjectSetup = super::read(&text, "drone").unwrap();
    assert_eq!((read.roundel.as_str(), read.code), ("robot", Some(6)), "{text}");
    assert!(read.roundels.is_empty(), "{text}");
}

#[test]
fn mounted_cameras_follow_a_renamed_object() {
    let text = rename_carrier(OBJECTS, "drone", "bee").unwrap();
    assert_eq!(text, OBJECTS.replace("object = \"drone\" }", "object = \"bee\" }"));
    let text = rename_carrier(OBJECTS, "cart", "wagon").unwrap();
    assert_eq!(text, OBJECTS.replace("object = \"cart\"", "object = \"wagon\""));
}
