//! Follows one robot, by its name, the code on its roundel or its id, and prints where it is.
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
    ROBOT is a configured name, #N for the one with code N, or an id, which lasts until the server is started anew; SERVER is http://127.0.0.1:7670 if left out";

#[tokio::main(flavor = "current_thread")]
async fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let robot = arguments.next().context(USAGE)?;
    let server = arguments.next().unwrap_or_else(|| "http://127.0.0.1:7670".to_owned());

    let client = Client::connect(&server).await?;
    let wanted = Wanted::of(&robot);
    tell_who_is_there(&client, &wanted).await?;
    let mut snapshots = client.snapshots(wanted.subscription().max_rate_hz(10.0));
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
            Update::Reconnected { gap, restarted, missed } => {
                let missed = missed.map_or("started anew".to_owned(), |it| format!("missed {it}"));
                eprintln!("back after {gap:.1?}, {missed}");
                // Ids are given anew then, so the same number may be another robot; names and codes stay.
                if restarted && matches!(wanted, Wanted::Id(_)) {
                    bail!(
                        "which robot {robot} was, nobody knows any more; give its name or its code"
                    );
                }
            }
            _ => {}
        }
    }
    Ok(())
}

/// Which robot.
enum Wanted {
    Id(u64),
    Name(String),
    Code(u32),
}

impl Wanted {
    fn of(robot: &str) -> Self {
        if let Some(number) = robot.strip_prefix('#').and_then(|number| number.parse().ok()) {
            return Self::Code(number);
        }
        robot.parse().map_or_else(|_| Self::Name(robot.to_owned()), Self::Id)
    }

    fn subscription(&self) -> Subscription {
        match self {
            Self::Id(id) => Subscription::default().ids([*id]),
            Self::Name(name) => Subscription::default().names([name]),
            Self::Code(number) => Subscription::default().codes([*number]),
        }
    }

    fn is(&self, object: &Object) -> bool {
        match self {
            Self::Id(id) => object.object_id == *id,
            Self::Name(name) => object.name == *name,
            Self::Code(number) => object.code.is_some_and(|code| code.number == *number),
        }
    }
}

/// Says who else there is if this one is not there yet; it is followed as soon as it is.
async fn tell_who_is_there(client: &Client, wanted: &Wanted) -> anyhow::Result<()> {
    let objects = client.objects().await?;
    if !objects.iter().any(|object| wanted.is(object)) {
        let called = |object: &Object| match object.code {
            _ if !object.name.is_empty() => object.name.clone(),
            Some(code) => format!("#{}", code.number),
            None => object.object_id.to_string(),
        };
        eprintln!("not seen yet; there are {:?}", objects.iter().map(called).collect::<Vec<_>>());
    }
    Ok(())
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
