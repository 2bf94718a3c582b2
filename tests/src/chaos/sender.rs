//! Honest senders: programs that detect roundels in the frames of one camera and push them to the server.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use roundel_client::{Client, PushOptions, Pusher, v1::PushTimes};
use tokio::time::sleep;

use super::{
    link::Link,
    timetable::CAMERAS,
    world::{SENSING, World},
};
use crate::sensor::Sensor;

/// The camera whose sender does not know the server's clock: its capture times are those of a counter.
const COUNTING_CAMERA: usize = CAMERAS - 1;

/// Faults of one sender.
pub struct SenderFaults {
    /// Its way to the server.
    pub link: Link,
    is_lost: AtomicBool,
}

impl SenderFaults {
    /// A sender without faults.
    pub fn new(link: Link) -> Self {
        Self { link, is_lost: AtomicBool::new(false) }
    }

    /// While it is lost, the sender does not run.
    pub fn set_lost(&self, is_lost: bool) {
        self.is_lost.store(is_lost, Ordering::Relaxed);
    }
}

/// Sends each frame of a camera when it is due.
pub async fn send(world: Arc<World>, camera: usize, faults: Arc<SenderFaults>) {
    let mut sensor = Sensor::new(&world.arena, camera, SENSING);
    let mut pusher = None;
    for number in 0.. {
        let frame = sensor.frame(number);
        let wait_s = frame.received_time.seconds_since(world.now());
        if wait_s > 0.0 {
            sleep(Duration::from_secs_f64(wait_s)).await;
        }
        if faults.is_lost.load(Ordering::Relaxed) {
            pusher = None;
            continue;
        }
        if pusher.is_none() {
            pusher = start(&world, camera, &faults);
        }
        let Some(pusher) = &pusher else { continue };
        pusher.observations(world.message(&frame));
    }
}

fn start(world: &Arc<World>, camera: usize, faults: &SenderFaults) -> Option<Pusher> {
    let client = Client::connect_lazily(&faults.link.url()).ok()?;
    let options = PushOptions::new(&world.arena.sites[camera].name).sender("honest");
    let own = world.clone();
    let options = if camera == COUNTING_CAMERA {
        options.times(PushTimes::Counter)
    } else {
        options.clock(move || own.now().as_ns())
    };
    client.push(options).ok()
}
