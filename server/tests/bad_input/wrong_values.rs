//! Wrong values in the configuration file.

use std::fs;

use super::{camera_yaml, expect, lab};

#[test]
fn names_wrong_values_with_their_line() {
    let folder = lab();
    let yaml = camera_yaml();
    fs::write(folder.path().join("short.yaml"), yaml.replace("319.5, ", "")).unwrap();
    for (from, to, expected) in [
        ("outer_mm = 160.0", "outer_mm = 0", "`outer_mm` must be a number above 0"),
        ("outer_mm = 160.0", "outer_mm = -160.0", "found -160.0"),
        ("outer_mm = 160.0", "outer_mm = nan", "found nan"),
        ("outer_mm = 160.0", "outer_mm = \"160\"", "found the text \"160\""),
        ("outer_mm = 160.0\n", "", "missing key `outer_mm` in [[roundel]]"),
        ("inner_mm = 64.0", "inner_mm = 160", "`inner_mm` must be below `outer_mm` = 160"),
        (
            "inner_mm = 64.0",
            "inner_mm = 76.0",
            "cannot be distinguished: inner to outer diameter 0.475 and 0.500",
        ),
        (
            "inner_mm = 64.0",
            "inner_mm = 96.0\ninner_minor_mm = 90.0",
            "`inner_minor_mm` must be 32.0 to 86.4 here (0.2 of `outer_mm` to 0.9 of `inner_mm`), found 90",
        ),
        (
            "code = { bits = 8, min_distance = 2 }",
            "code = { bits = 8, min_distance = 2 }\ninner_minor_mm = 60.0",
            "`inner_minor_mm` is the shorter diameter of an elliptical disc, which has no `code`",
        ),
        (
            "[[camera]]",
            "[[roundel]]\nname = \"other\"\nouter_mm = 100\ninner_mm = 62\ninner_minor_mm = 41\n[[camera]]",
            "roundels \"crawler\" and \"other\" cannot be distinguished: the disc's diameters are 0.600 and \
             0.400 of the outer one, and 0.620 and 0.410",
        ),
        ("name = \"reference\"", "name = \"robot\"", "two kinds of roundel are named \"robot\""),
        (
            "inner_mm = 64.0",
            "inner_mm = 31.0",
            "`inner_mm` must be 0.2 to 0.8 of `outer_mm` = 160, found 31, which is 0.194 of it",
        ),
        (
            "code = { bits = 8, min_distance = 2 }",
            "code = { bits = 8 }\n[[roundel]]\nname = \"cart\"\nouter_mm = 300\ncode = { bits = 8 }",
            "roundels \"shuttle\" and \"cart\" cannot be distinguished: both have codes of 8 bits",
        ),
        (
            "allow_origins = []",
            "allow_origins = [\"https://lab.example.org/page\"]",
            "leave out the path: \"https://lab.example.org\"",
        ),
        (
            "allow_origins = []",
            "allow_origins = [\"lab.example.org\"]",
            "`allow_origins` must be a list of origins of pages, found \"lab.example.org\"",
        ),
        (
            "allow_origins = []",
            "allow_origins = \"*\"",
            "`allow_origins` must be a list of origins of pages, found the text \"*\"",
        ),
        (
            "allow_hosts = []",
            "allow_hosts = [\"http://lab\"]",
            "`allow_hosts` must be a list of host names, found \"http://lab\"",
        ),
        (
            "trusted_proxies = []",
            "trusted_proxies = [\"proxy\"]",
            "`trusted_proxies` must be IP addresses, found \"proxy\"",
        ),
        (
            "[detection]",
            "[[access]]\nname = \"alice\"\nrole = \"view\"\n[detection]",
            "an entry of [[access]] needs a `token`, `password`, `certificate` or `forwarded`",
        ),
        (
            "[detection]",
            "[[access]]\nname = \"a\"\nrole = \"view\"\ntoken = \"secret\"\n[detection]",
            "`token` must be \"sha256:\" and 64 hexadecimal digits",
        ),
        (
            "[detection]",
            "[[access]]\nname = \"a\"\nrole = \"root\"\nforwarded = \"a\"\n[detection]",
            "`role` must be \"view\" or \"feed\" or \"operate\" or \"setup\", found the text \"root\"",
        ),
        (
            "[detection]",
            "[[access]]\nname = \"a\"\nrole = \"view\"\npassword = \"secret\"\n[detection]",
            "`password` must be an argon2id hash",
        ),
        (
            "[detection]",
            "[[access]]\nname = \"a\"\nrole = \"feed\"\nforwarded = \"a\"\ncameras = [\"nowhere\"]\n[detection]",
            "no camera is named \"nowhere\"",
        ),
        (
            "[detection]",
            "[[access]]\nname = \"a\"\nrole = \"view\"\nforwarded = \"a\"\nexpires = \"2027\"\n[detection]",
            "`expires` must be a date, found the text \"2027\"",
        ),
        ("bits = 8", "bits = 1", "`bits` must be a whole number from 2 to 16, found 1"),
        ("bits = 8", "bits = 8.5", "`bits` must be a whole number from 2 to 16, found 8.5"),
        ("bits = 8, ", "", "missing key `bits` in code"),
        ("min_distance = 2", "min_distance = 0", "`min_distance` must be a whole number from 1"),
        (
            "min_distance = 2",
            "min_distance = 7",
            "`min_distance`: expected a Hamming distance of 1 to",
        ),
        ("code = { bits = 8, min_distance = 2 }", "code = 8", "`code` must be a table"),
        (
            "mode = \"precise\"",
            "mode = \"precice\"",
            "`mode` must be \"precise\" or \"fast\", found the text \"precice\"; did you mean \"precise\"?",
        ),
        (
            "polarity = \"white_ring\"",
            "polarity = \"white-ring\"",
            "`polarity` must be \"black_ring\" or \"white_ring\", found the text \"white-ring\"; did \
             you mean \"white_ring\"?",
        ),
        (
            "polarity = \"white_ring\"",
            "polarity = \"black_ring\"",
            "roundels \"robot\" and \"dark\" cannot be distinguished",
        ),
        ("mode = \"fast\"", "mode = 1", "`mode` must be \"precise\" or \"fast\", found 1"),
        (
            "[[0, 0], [200, 0], [200, 90], [0, 90]]",
            "[[0, 0], [200, 0]]",
            "polygon 1 of `mask` must have at least 3 corners, found 2",
        ),
        (
            "[[0, 0], [200, 0], [200, 90], [0, 90]]",
            "[[0, 0], [200], [200, 90]]",
            "corner 2 of polygon 1 of `mask` must be [u, v], two finite numbers of pixels, found [200]",
        ),
        (
            "[520, 330]",
            "[520, nan]",
            "corner 2 of polygon 2 of `mask` must be [u, v], two finite numbers of pixels, found [520, nan]",
        ),
        (
            "[[400, 480], [520, 330], [640, 480]]",
            "[[400, 480], [520, 530], [640, 480]]",
            "polygon 2 of `mask` covers no pixel of the frame of 640 x 480",
        ),
        (
            "[[400, 480], [520, 330], [640, 480]]",
            "[[-1, -1], [640, -1], [640, 480], [-1, 480]]",
            "`mask` covers the whole frame of 640 x 480 pixels",
        ),
        (
            "[[400, 480], [520, 330], [640, 480]]",
            "7",
            "polygon 2 of `mask` must be a list of corners, found 7",
        ),
        ("name = \"south\"", "name = \"north\"", "cameras 1 and 2 are both named \"north\""),
        ("name = \"south\"", "name = \" \"", "`name` must be a text in quotes that is not empty"),
        (
            "\"images:frames/south",
            "\"video:frames/south",
            "no source begins with `video:`: expected `images:`, `sim:`",
        ),
        ("\"images:frames/south", "\"image:frames/south", "did you mean `images:`?"),
        ("fps=30&loop=true\"\n# ROS", "fsp=30&loop=true\"\n# ROS", "unknown option `fsp`"),
        ("calibration = \"south.yaml\"", "calibration = \"sth.yaml\"", "sth.yaml"),
        (
            "calibration = \"south.yaml\"",
            "calibration = \"short.yaml\"",
            "short.yaml:7: `camera_matrix.data` must have 9 numbers, found 8",
        ),
        ("calibration = \"south.yaml\"\n", "", "missing key `calibration` in [[camera]]"),
        (
            "pose = \"unknown\"",
            "pose = \"unkown\"",
            "`pose` must be a table or \"unknown\", found the text \"unkown\"",
        ),
        ("pose = \"unknown\"", "pose = 3", "`pose` must be a table or \"unknown\""),
        ("pose = \"unknown\"\n", "", "missing key `pose` in [[camera]]"),
        ("0.921, -0.364", "0.5, -0.364", "must be a quaternion of length 1, found length 0.6"),
        (
            "0.921, -0.364, 0.052, -0.131",
            "0.921, -0.364, 0.052",
            "a list of 4 finite numbers, found 3",
        ),
        (
            "line_time_us = 0.0",
            "line_time_us = -1",
            "`line_time_us` must be a number from 0 to 10000, found -1",
        ),
        (
            "clock_uncertainty_ms = 0.0",
            "clock_uncertainty_ms = -1",
            "`clock_uncertainty_ms` must be a number from 0 to 10000, found -1",
        ),
        (
            "tolerance = 0.03",
            "tolerance = 3",
            "`tolerance` must be a number from 0 to 0.1, found 3",
        ),
        (
            "time_budget = 0.6",
            "time_budget = 1.5",
            "`time_budget` must be a number above 0, at most 1, found 1.5",
        ),
        ("motion = \"ground\"", "motion = \"wheels\"", "`motion` must be \"free\" or \"ground\""),
        ("motion = \"ground\"\n", "", "`height_m` is the height of what drives"),
        ("height_m = 0.3", "height_m = inf", "`height_m` must be a number from -1000 to 1000"),
        (
            "position_m = [2.0, 0.0, 0.0]",
            "position_m = [0.0, 0.0, 0.0]",
            "references 1 and 2 have the same place",
        ),
        (
            "position_m = [2.0, 0.0, 0.0]",
            "position_m = [2.0, inf, 0.0]",
            "`position_m` must be a list of 3 finite numbers",
        ),
        (
            "roundel = \"robot\"",
            "roundel = \"robto\"",
            "no [[roundel]] is named \"robto\"; did you mean \"robot\"?",
        ),
        (
            "[fusion]",
            "[[object]]\nname = \"two\"\nroundel = \"robot\"\n[fusion]",
            "carry the same kind of roundel",
        ),
        ("code = 12", "code = 3", "objects \"robot two\" and \"carrier\" carry code 3"),
        ("code = 4,", "code = 3,", "object \"carrier\" carries code 3 twice"),
        ("code = 12", "code = 17", "`code` must be 1 to 16, found 17"),
        ("code = 4,", "code = 0,", "`code` must be 1 to 16, found 0"),
        ("code = 4,", "code = 4.5,", "`code` must be a whole number from 0 to 65535, found 4.5"),
        ("code = 4, ", "", "missing key `code` in [[object.roundel]]"),
        ("kind = \"dark\"", "kind = \"dark\", code = 1", "roundels \"dark\" have no codes"),
        (
            "kind = \"dark\"",
            "kind = \"robot\"",
            "objects \"robot one\" and \"carrier\" carry the same kind of roundel",
        ),
        (
            "kind = \"dark\"",
            "kind = \"drak\"",
            "no [[roundel]] is named \"drak\"; did you mean \"dark\"?",
        ),
        (
            "position_m = [0.2, 0.0, 0.3]",
            "yaw_deg = 3",
            "missing key `position_m` in [[object.roundel]]",
        ),
        (
            "yaw_deg = 90.0",
            "yaw_deg = 900",
            "`yaw_deg` must be a number from -360 to 360, found 900",
        ),
        ("top = [0.0, 0.0, 1.0] }", "yaw_deg = 1 }", "`right` and `top` any print: found both"),
        (
            "top = [0.0, 0.0, 1.0] }",
            "top = [0.0, 1.0, 1.0] }",
            "at right angles, found 45.0 degrees",
        ),
        ("top = [0.0, 0.0, 1.0] }", "top = [0.0, 0.0, 0.0] }", "must point somewhere, found zeros"),
        (", top = [0.0, 0.0, 1.0]", "", "missing key `top` in [[object.roundel]]"),
        ("name = \"carrier\"", "name = \"robot two\"", "two objects are named \"robot two\""),
        (
            "name = \"carrier\"",
            "name = \"carrier\"\ncode = 5",
            "`code` is for an object with one roundel, and `roundel` lists several",
        ),
        (
            "[fusion]",
            "[[object]]\nname = \"none\"\nroundel = []\n[fusion]",
            "`roundel` lists no roundel",
        ),
        (
            "motion = \"ground\"\nheight_m = 0.25",
            "height_m = 0.25",
            "`height_m` is the height of what drives",
        ),
        (
            "listen = \"127.0.0.1:7670\"",
            "listen = \"localhost\"",
            "`listen` must be an IP address with a port, found \"localhost\"",
        ),
        (
            "snapshot_rate_hz = 60.0",
            "snapshot_rate_hz = 1e6",
            "`snapshot_rate_hz` must be a number above 0, at most 1000",
        ),
        ("prompt = false", "prompt = 1", "`prompt` must be"),
        ("watch = true", "watch = \"yes\"", "`watch` must be"),
        (
            "uncertainty_mm = 0.5",
            "uncertainty_mm = 0.0",
            "`uncertainty_mm` must be a number above 0, at most 1000",
        ),
        (
            "acceleration_m_s2 = 1.5",
            "acceleration_m_s2 = 0",
            "`acceleration_m_s2` must be a number above 0",
        ),
        (
            "lost_after_ms = 2000.0",
            "lost_after_ms = 100.0",
            "`lost_after_ms` must be above `predicted_after_ms` = 150",
        ),
        ("max_objects = 1000", "max_objects = 0", "`max_objects` must be a whole number from 1"),
        ("max_clients = 2000", "max_clients = 1.5", "`max_clients` must be a whole number from 1"),
        ("[limits]", "[limits", "not valid TOML"),
        ("[server]", "server = 3\n[sever]", "`server` must be a table"),
        ("name = \"lab\"", "name = \"lab\"\nname = \"b\"", "not valid TOML: duplicate key"),
    ] {
        expect(folder.path(), (from, to), expected);
    }
}
