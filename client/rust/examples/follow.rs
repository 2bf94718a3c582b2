//! Follows one robot by name, code or id, and prints its position.
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
    ROBOT is a configured name, #N for code N, or an id, which is valid until the server restarts; SERVER defaults to http://127.0.0.1:7670";

#[tokio::main(flavor = "current_thread")]
async fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let robot = arguments.next().context(USAGE)?;
    let server = arguments.next().unwrap_or_else(|| "http://127.0.0.1:7670".to_owned());

    let client = Client::connect(&server).await?;
    let selector = Selector::parse(&robot);
    report_if_missing(&client, &selector).await?;
    let mut snapshots = client.snapshots(selector.subscription().max_rate_hz(10.0));
    let mut is_tracked = true;
    while let Some(update) = snapshots.next().await {
        match update? {
            Update::Snapshot(snapshot) => {
                match snapshot.objects.first() {
                    Some(state) => print(state),
                    None if is_tracked => println!("{robot} is not tracked"),
                    None => {}
                }
                is_tracked = !snapshot.objects.is_empty();
            }
            Update::Disconnected { reason, retry_in, .. } => {
                eprintln!(
                    "connection lost ({reason}); next attempt in {} ms",
                    retry_in.as_millis()
                );
            }
            Update::Reconnected { gap, restarted, missed } => {
                let outcome =
                    missed.map_or("server restarted".to_owned(), |it| format!("missed {it}"));
                eprintln!("connected again after {gap:.1?}, {outcome}");
                if restarted && matches!(selector, Selector::Id(_)) {
                    bail!(
                        "the restarted server assigns new ids, so robot {robot} is unknown; use its name or code"
                    );
                }
            }
            _ => {}
        }
    }
    Ok(())
}

enum Selector {
    Id(u64),
    Name(String),
    Code(u32),
}

impl Selector {
    fn parse(robot: &str) -> Self {
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

    fn matches(&self, object: &Object) -> bool {
        match self {
            Self::Id(id) => object.object_id == *id,
            Self::Name(name) => object.name == *name,
            Self::Code(number) => object.code.is_some_and(|code| code.number == *number),
        }
    }
}

/// Lists the tracked robots if this one is not among them. It is followed as soon as it is tracked.
async fn report_if_missing(client: &Client, selector: &Selector) -> anyhow::Result<()> {
    let objects = client.objects().await?;
    if !objects.iter().any(|object| selector.matches(object)) {
        let label = |object: &Object| match object.code {
            _ if !object.name.is_empty() => object.name.clone(),
            Some(code) => format!("#{}", code.number),
            None => object.object_id.to_string(),
        };
        eprintln!(
            "not tracked yet; tracked are {:?}",
            objects.iter().map(label).collect::<Vec<_>>()
        );
    }
    Ok(())
}

fn print(state: &ObjectState) {
    let position = state.position.unwrap_or_default();
    let velocity = state.velocity.unwrap_or_default();
    let sigma_mm = position_sigma_m(state).unwrap_or_default().map(|sigma| sigma * 1e3);
    let stage = if state.stage == LifeStage::Tracked as i32 { "seen" } else { "predicted" };
    println!(
        "{:8.3} {:8.3} {:8.3} m  {:6.2} {:6.2} {:6.2} m/s ({:4.2})  sigma {:4.1} {:4.1} {:4.1} mm  {stage}",
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
