//! The Rust client's examples with the demo: robots form a circle, and a recording of it.

use std::{f64::consts::TAU, process::Command};

use anyhow::{Context, ensure};
use futures::StreamExt;
use roundel_client::{Client, Subscription, Update, v1::Snapshot};
use roundel_tests::process::{self, Server};

const ROBOTS: usize = 12;
const RADIUS_M: f64 = 2.0;
/// Maximum rms distance of a formation from its places.
const GOOD_M: f64 = 0.03;
/// Minimum displacement of a robot by a push of a second at 1 m/s.
const PUSHED_M: f64 = 0.3;

fn run(example: &str, arguments: &[&str]) -> anyhow::Result<String> {
    let output = Command::new(process::example(example)?).args(arguments).output()?;
    let printed = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
    ensure!(output.status.success(), "{example} ended with {}:\n{printed}", output.status);
    Ok(printed)
}

/// A formation as observed by a subscriber independent of the example.
#[derive(Debug, Default)]
struct Watch {
    /// Id of the object at each place once the circle is complete.
    ids: Vec<u64>,
    /// Largest distance of each object from its place since then.
    farthest_m: Vec<f64>,
    /// Current distance; infinite until the circle is complete, and while an object is lost.
    rms_m: f64,
}

impl Watch {
    fn see(&mut self, snapshot: &Snapshot) {
        if self.ids.is_empty() {
            let at_places = (0..ROBOTS).map(|place| nearest(snapshot, place));
            let (ids, off_m): (Vec<u64>, Vec<f64>) = at_places.unzip();
            self.rms_m = f64::INFINITY;
            if rms(&off_m) <= GOOD_M {
                (self.ids, self.farthest_m) = (ids, vec![0.0; ROBOTS]);
            }
        }
        if !self.ids.is_empty() {
            let off_m = |(place, id): (usize, &u64)| {
                let found = snapshot.objects.iter().find(|state| state.object_id == *id);
                found.map_or(f64::INFINITY, |state| off_m(state.position, place))
            };
            let off_m: Vec<f64> = self.ids.iter().enumerate().map(off_m).collect();
            self.rms_m = rms(&off_m);
            // A lost object has an infinite distance, which is not a push.
            let seen = self.farthest_m.iter_mut().zip(off_m).filter(|(_, off_m)| off_m.is_finite());
            seen.for_each(|(farthest_m, off_m)| *farthest_m = farthest_m.max(off_m));
        }
    }
}

/// The object nearest to a place on the circle, and its distance.
fn nearest(snapshot: &Snapshot, place: usize) -> (u64, f64) {
    let each = snapshot.objects.iter().map(|state| (state.object_id, off_m(state.position, place)));
    each.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, f64::INFINITY))
}

fn off_m(position: Option<roundel_client::v1::Vector3>, place: usize) -> f64 {
    let at = position.unwrap_or_default();
    let (sine, cosine) = (place as f64 / ROBOTS as f64 * TAU).sin_cos();
    (at.x - RADIUS_M * cosine).hypot(at.y - RADIUS_M * sine)
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_form_a_circle_keep_it_while_one_is_pushed_and_are_recorded() -> anyhow::Result<()> {
    let folder = tempfile::tempdir()?;
    let arguments = ["demo", "--listen", "127.0.0.1:0", "--robots", "12", "--seed", "5"];
    let server = Server::start(&arguments, folder.path())?;
    let client = Client::connect(&server.url()).await?;
    let mut updates = client.snapshots(Subscription::default());
    let mut driving = tokio::task::spawn_blocking({
        let url = server.url();
        move || run("formation", &[&url])
    });
    let mut watch = Watch::default();
    let printed = loop {
        tokio::select! {
            ended = &mut driving => break ended??,
            update = updates.next() => {
                if let Update::Snapshot(snapshot) = update.context("the stream has ended")?? {
                    watch.see(&snapshot);
                }
            }
        }
    };
    // Robots without commands stop, so they stand where the example left them.
    watch.see(&client.snapshot().await?);
    let pushed = printed.lines().find_map(|line| line.strip_prefix("pushing robot "));
    let pushed = pushed.and_then(|rest| rest.strip_suffix(" away")?.parse::<u64>().ok());
    let place = watch.ids.iter().position(|id| Some(*id) == pushed);
    let place = place.with_context(|| format!("expected {pushed:?} in {watch:?}:\n{printed}"))?;
    for (other, farthest_m) in watch.farthest_m.iter().enumerate() {
        // One robot was pushed away, and no other.
        let is_sound =
            if other == place { *farthest_m >= PUSHED_M } else { *farthest_m <= PUSHED_M / 2.0 };
        ensure!(is_sound, "expected a push of place {place} alone, found {watch:?}:\n{printed}");
    }
    ensure!(
        watch.rms_m <= GOOD_M,
        "expected at most {GOOD_M} m rms after the push, found {watch:?}; the example printed:\n{printed}"
    );

    let file = folder.path().join("run.csv");
    let printed = run("record", &[&file.to_string_lossy(), "1", &server.url()])?;
    let text = std::fs::read_to_string(&file)?;
    let lines: Vec<&str> = text.lines().collect();
    let snapshots = (lines.len() - 1) / ROBOTS;
    ensure!(printed.contains(&format!("{snapshots} snapshots written")), "{printed}");
    ensure!(snapshots > 1 && (lines.len() - 1).is_multiple_of(ROBOTS), "{} lines", lines.len());
    let columns = lines[0].split(',').count();
    ensure!(lines.iter().all(|line| line.split(',').count() == columns), "{text}");
    Ok(())
}
