//! A camera whose pose is "unknown" localizes itself by reference roundels in rendered pictures.

use std::{fs, time::Duration};

use anyhow::{Context, ensure};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use roundel_client::Client;
use roundel_tests::{
    arena::{Arena, Kind, Path},
    export::Export,
    process::Server,
    render::Print,
};

/// Positions of the references; all their distances differ.
const REFERENCES_M: [[f64; 3]; 4] =
    [[-2.6, -1.6, 0.3], [0.1, -1.3, 0.3], [-2.1, 0.5, 0.3], [-0.6, 0.1, 0.3]];

/// One camera, with references instead of robots.
fn arena() -> Arena {
    let mut arena = Arena::r4_lite(5, REFERENCES_M.len(), 0);
    let kind = Kind {
        name: "reference".into(),
        outer_diameter_m: 0.16,
        inner_diameter_m: 0.096,
        inner_minor_m: None,
        code_bits: None,
    };
    for (robot, place) in arena.robots.iter_mut().zip(REFERENCES_M) {
        robot.path = Path::still(Vector3::from(place));
        robot.kind = kind.name.clone();
        robot.print = Print::plain(kind.outer_diameter_m, kind.inner_diameter_m, 0.25);
    }
    arena.kinds.push(kind);
    arena.sites.truncate(1);
    arena
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_localizes_itself_by_references() -> anyhow::Result<()> {
    let arena = arena();
    let folder = tempfile::tempdir()?;
    let installation = Export::lab(60).write(&arena, folder.path())?;
    let config = fs::read_to_string(&installation.config)?;
    let mut config: String = config
        .lines()
        .map(|line| if line.starts_with("pose = ") { "pose = \"unknown\"" } else { line })
        .flat_map(|line| [line, "\n"])
        .collect();
    for [x, y, z] in REFERENCES_M {
        config += &format!(
            "\n[[reference]]\nroundel = \"reference\"\nposition_m = [{x:?}, {y:?}, {z:?}]\n"
        );
    }
    fs::write(&installation.config, config)?;

    let server = Server::serve(&installation.config)?;
    let client = Client::connect(&server.url()).await?;
    let mut found = None;
    for _ in 0..600 {
        let cameras = client.cameras().await?;
        found = cameras.first().and_then(|camera| camera.pose);
        if found.is_some() {
            break;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let pose = found.with_context(|| format!("no pose in a minute:\n{}", server.log()))?;
    let (p, q) = (pose.position.unwrap_or_default(), pose.orientation.unwrap_or_default());
    let truth = &arena.sites[0].world_from_camera;
    let off_m = (Vector3::new(p.x, p.y, p.z) - truth.translation.vector).norm();
    let turned = UnitQuaternion::from_quaternion(Quaternion::new(q.w, q.x, q.y, q.z));
    let off_rad = turned.angle_to(&truth.rotation);
    println!("off by {:.1} mm and {:.3} degrees", off_m * 1e3, off_rad.to_degrees());
    ensure!(off_m < 0.03, "off by {off_m} m");
    ensure!(off_rad.to_degrees() < 0.4, "turned by {} degrees", off_rad.to_degrees());
    Ok(())
}
