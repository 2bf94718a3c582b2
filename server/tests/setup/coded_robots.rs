//! Naming coded robots of one kind while they are tracked, with printed roundels through the real pipeline.

use std::{collections::BTreeMap, fs, path::Path};

use roundel_client::Client;
use roundel_core::{
    camera::{Camera, Intrinsics, Lens},
    marker::{CodeLayout, Kind, Pattern},
};
use roundel_proto::v1;
use roundel_server::{
    app::serve::Server,
    lab::print::{self, PageSize, PrintItem, lay_out_pages},
    model::{camera_file, config::Config},
};

use super::rig::TIMEOUT;

pub const TEXT: &str = r#"name = "lab"
[server]
listen = "127.0.0.1:0"
[[roundel]]
name = "shuttle"
outer_mm = 122.0
code = { bits = 8, min_distance = 2 }
[[camera]]
name = "above"
source = "images:pictures/*.png?fps=25&loop=true"
calibration = "camera.yaml"
pose = { position_m = [0.0, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }
"#;
const NUMBERS: [u16; 2] = [5, 9];
/// Renders a page of 400 x 300 mm as 640 x 480 pixels.
const DPI: f64 = 40.64;

/// Renders a page with these roundels, as `roundel print` lays it out, as the camera's image.
pub fn draw(folder: &Path, numbers: [u16; 2]) {
    let pattern = Pattern::Coded(CodeLayout { bits: 8, min_distance: 2 });
    let kind = Kind { pattern, ..Kind::plain("shuttle", 0.122, 0.122 * CodeLayout::RATIO) };
    let item =
        |number| PrintItem { kind: kind.clone(), number: Some(number), label: String::new() };
    let page = PageSize { width_mm: 400.0, height_mm: 300.0 };
    let pages = lay_out_pages(&numbers.map(item), page).unwrap();
    assert_eq!(pages.len(), 1);
    let picture = fs::File::create(folder.join("pictures/0.png")).unwrap();
    print::png(&pages[0], DPI, picture).unwrap();
}

/// A folder for a server whose camera sees a page with both roundels.
pub fn lab() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("pictures")).unwrap();
    draw(folder.path(), NUMBERS);
    let camera = Camera::new(Intrinsics {
        width: 640,
        height: 480,
        fx_px: 600.0,
        fy_px: 600.0,
        cx_px: 319.5,
        cy_px: 239.5,
        lens: Lens::PlumbBob([0.0; 5]),
    });
    let lens = camera_file::write("camera.yaml", &camera.unwrap());
    fs::write(folder.path().join("camera.yaml"), lens).unwrap();
    fs::write(folder.path().join("lab.toml"), TEXT).unwrap();
    folder
}

/// Tracked objects by code number: ID and name.
async fn coded(client: &Client) -> BTreeMap<u32, (u64, String)> {
    let Ok(snapshot) = client.snapshot().await else { return BTreeMap::new() };
    let tracked = snapshot.objects.into_iter().filter(|it| it.stage() == v1::LifeStage::Tracked);
    tracked.filter_map(|it| Some((it.code?.number, (it.object_id, it.name)))).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn robots_of_one_kind_are_named_by_their_codes() {
    let folder = lab();
    let config = || Config::load(&folder.path().join("lab.toml")).unwrap();
    let server = Server::start(config()).await.unwrap();
    let client = Client::connect(&format!("http://{}", server.local_addr())).await.unwrap();
    let before = until(&client, |seen| seen.len() == 2).await;
    assert!(before.keys().copied().eq(NUMBERS.map(u32::from)), "{before:?}");
    for (number, name) in [(5, "bee"), (9, "wasp")] {
        let object = client.name_object(before[&number].0, name).await.unwrap().object.unwrap();
        assert_eq!((object.roundel.as_str(), object.code), ("shuttle", Some(number)));
    }
    let named = |seen: &BTreeMap<u32, (u64, String)>| {
        seen.get(&5).is_some_and(|it| it.1 == "bee")
            && seen.get(&9).is_some_and(|it| it.1 == "wasp")
    };
    let after = until(&client, named).await;
    for number in [5, 9] {
        assert_eq!(after[&number].0, before[&number].0, "a named object must keep its ID");
    }
    server.shutdown().await;
    // The names survive a restart of the server.
    let server = Server::start(config()).await.unwrap();
    let client = Client::connect(&format!("http://{}", server.local_addr())).await.unwrap();
    until(&client, named).await;
    server.shutdown().await;
}

async fn until(
    client: &Client,
    is_reached: impl Fn(&BTreeMap<u32, (u64, String)>) -> bool,
) -> BTreeMap<u32, (u64, String)> {
    let look = async {
        loop {
            let seen = coded(client).await;
            if is_reached(&seen) {
                return seen;
            }
            tokio::time::sleep(std::time::Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(TIMEOUT, look).await.expect("the robots never reach the expected state")
}
