//! Follows one robot, by its id, its name or the code on its roundel, and prints where it is.
//!
//! ```sh
//! cargo run --release -- demo                                       # in one terminal
//! cargo run --release -p roundel-client --example follow -- 3       # in another
//! ```

use anyhow::{Context, bail};
use futures::StreamExt;
use roundel_client::{
    Client, Subscription, Update, position_sigma_m, speed_m_s,
    v1::{LifeStage, Object, ObjectState},
};

const USAGE: &str = "usage: follow ROBOT [SERVER]\n\
    ROBOT is an id, a configured name, or #N for the one with code N; SERVER is http://127.0.0.1:7670 if left out";

#[tokio::main(flavor = "current_thread")]
async fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let robot = arguments.next().context(USAGE)?;
    let server = arguments.next().unwrap_or_else(|| "http://127.0.0.1:7670".to_owned());

    let client = Client::connect(&server).await?;
    let id = find(&client, &robot).await?;
    let wanted = Subscription::default().ids([id]).max_rate_hz(10.0);
    let mut snapshots = client.snapshots(wanted);
    let mut is_there = true;
    while let Some(update) = snapshots.next().await {
        match update? {
            Update::Snapshot(snapshot) => {
                match snapshot.objects.first() {
                    Some(state) => print(state),
                    None if is_there => println!("{robot} is not there"),
                    None => {}
                }
                is_there = !snapshot.objects.is_empty();
            }
            Update::Disconnected { reason, retry_in, .. } => {
                eprintln!("lost the server ({reason}); next try in {} ms", retry_in.as_millis());
            }
            Update::Reconnected { missed: Some(missed) } => eprintln!("back, missed {missed}"),
            // Ids are given anew by a new server, so the same number may be another robot.
            Update::Reconnected { missed: None } => bail!("the server was started anew"),
            _ => {}
        }
    }
    Ok(())
}

/// The id of the robot of that id, name or code.
async fn find(client: &Client, robot: &str) -> anyhow::Result<u64> {
    if let Ok(id) = robot.parse() {
        return Ok(id);
    }
    let code_of = |object: &Object| object.code.as_ref().map(|code| format!("#{}", code.number));
    let objects = client.objects().await?;
    let is_meant =
        |object: &&Object| object.name == robot || code_of(object).as_deref() == Some(robot);
    match objects.iter().find(is_meant) {
        Some(object) => Ok(object.object_id),
        None => {
            let known = objects.iter().map(|object| code_of(object).unwrap_or(object.name.clone()));
            let known: Vec<String> = known.filter(|name| !name.is_empty()).collect();
            bail!("no robot has the name or code {robot:?}; there are {known:?}")
        }
    }
}

fn print(state: &ObjectState) {
    let position = state.position.unwrap_or_default();
    let velocity = state.velocity.unwrap_or_default();
    let sigma_mm = position_sigma_m(state).unwrap_or_default().map(|sigma| sigma * 1e3);
    let seen = if state.stage == LifeStage::Tracked as i32 { "seen" } else { "predicted" };
    println!(
        "{:8.3} {:8.3} {:8.3} m  {:6.2} {:6.2} {:6.2} m/s ({:4.2})  sigma {:4.1} {:4.1} {:4.1} mm  {seen}",
        position.x,
        position.y,
        position.z,
        velocity.x,
        velocity.y,
        velocity.z,
        speed_m_s(state),
        sigma_mm[0],
        sigma_mm[1],
        sigma_mm[2],
    );
}
