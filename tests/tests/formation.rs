//! The Rust client's examples against the demo: a circle of robots, and a recording of it.

use std::{f64::consts::TAU, process::Command};

use anyhow::ensure;
use roundel_client::Client;
use roundel_tests::process::{self, Server};

const ROBOTS: usize = 12;
const RADIUS_M: f64 = 2.0;
/// Root mean square distance from the places that a formation may have.
const GOOD_M: f64 = 0.03;

fn run(example: &str, arguments: &[&str]) -> anyhow::Result<String> {
    let output = Command::new(process::example(example)?).args(arguments).output()?;
    let said = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
    ensure!(output.status.success(), "{example} ended with {}:\n{said}", output.status);
    Ok(said)
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_form_a_circle_keep_it_while_one_is_pushed_and_are_recorded() -> anyhow::Result<()> {
    let folder = tempfile::tempdir()?;
    let arguments = ["demo", "--listen", "127.0.0.1:0", "--robots", "12", "--seed", "5"];
    let server = Server::start(&arguments, folder.path())?;
    let said = tokio::task::spawn_blocking({
        let url = server.url();
        move || run("formation", &[&url])
    });
    let said = said.await??;
    ensure!(said.contains("pushing robot") && said.contains("formed in"), "{said}");

    // Robots that hear nothing stop: judged by itself, whatever the example says.
    let client = Client::connect(&server.url()).await?;
    let snapshot = client.snapshot().await?;
    let mut taken = [0_u32; ROBOTS];
    let mut squares_m2 = 0.0;
    for state in &snapshot.objects {
        let at = state.position.unwrap_or_default();
        let turn = at.y.atan2(at.x).rem_euclid(TAU) / TAU * ROBOTS as f64;
        let place = turn.round() as usize % ROBOTS;
        taken[place] += 1;
        let (sine, cosine) = (place as f64 / ROBOTS as f64 * TAU).sin_cos();
        squares_m2 += (at.x - RADIUS_M * cosine).powi(2) + (at.y - RADIUS_M * sine).powi(2);
    }
    ensure!(taken == [1; ROBOTS], "expected one robot at each place, found {taken:?}");
    let rms_m = (squares_m2 / ROBOTS as f64).sqrt();
    ensure!(
        rms_m <= GOOD_M,
        "expected at most {GOOD_M} m rms, found {rms_m}; the example said:\n{said}"
    );

    let file = folder.path().join("run.csv");
    let said = run("record", &[&file.to_string_lossy(), "1", &server.url()])?;
    let text = std::fs::read_to_string(&file)?;
    let lines: Vec<&str> = text.lines().collect();
    let snapshots = (lines.len() - 1) / ROBOTS;
    ensure!(said.contains(&format!("{snapshots} snapshots written")), "{said}");
    ensure!(snapshots > 1 && (lines.len() - 1).is_multiple_of(ROBOTS), "{} lines", lines.len());
    let columns = lines[0].split(',').count();
    ensure!(lines.iter().all(|line| line.split(',').count() == columns), "{text}");
    Ok(())
}
