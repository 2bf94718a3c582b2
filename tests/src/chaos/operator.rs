//! A person who changes the configuration of the running server. What the server confirms must survive.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use roundel_client::{Client, v1::ObjectSetup};
use tokio::time::{sleep, timeout};

use super::world::CODED;

const PAUSE: Duration = Duration::from_millis(300);
const PATIENCE: Duration = Duration::from_secs(3);
/// Codes that no robot has.
const FIRST_CODE: u32 = 20;
const CODES: u32 = 6;

/// Configured objects by name: whether each exists; `None`: the last change was not confirmed.
pub type Confirmed = Arc<Mutex<BTreeMap<String, Option<bool>>>>;

/// Adds and removes objects forever.
pub async fn change_objects(client: Client, confirmed: Confirmed) {
    let client = client.with_timeout(PATIENCE);
    for step in 0.. {
        let (round, index) = (step / CODES, step % CODES);
        let name = format!("cart {index}");
        let adds = round % 2 == 0;
        set(&confirmed, &name, None);
        let is_confirmed = if adds {
            let (roundel, code) = (CODED.to_owned(), Some(FIRST_CODE + index));
            let object = ObjectSetup { name: name.clone(), roundel, code, ..Default::default() };
            matches!(timeout(PATIENCE, client.add_object(object)).await, Ok(Ok(change)) if is_kept(&change.kept))
        } else {
            matches!(timeout(PATIENCE, client.remove_object(&name)).await, Ok(Ok(change)) if is_kept(&change.kept))
        };
        if is_confirmed {
            set(&confirmed, &name, Some(adds));
        }
        sleep(PAUSE).await;
    }
}

/// Whether the server names the file in which it has stored a change.
fn is_kept(kept: &str) -> bool {
    kept.starts_with("saved in ")
}

fn set(confirmed: &Confirmed, name: &str, exists: Option<bool>) {
    let mut confirmed = confirmed.lock().unwrap_or_else(PoisonError::into_inner);
    confirmed.insert(name.to_owned(), exists);
}
