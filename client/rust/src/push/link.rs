//! One connection after the other: greeting, probes, sending, acknowledgements.
//!
//! A connection of its own, since one on which nothing comes back any more is given up as a whole: a network that
//! was cut says nothing, and a probe that is not answered for [`SILENCE`] is the first sign.

use std::{sync::Arc, time::Duration};

use futures::stream;
use tokio::{
    sync::mpsc,
    time::{Instant, MissedTickBehavior, interval, sleep, timeout},
};
use tonic::{Streaming, transport::Endpoint};

use super::{MAX_MESSAGE_BYTES, Shared, backlog::Item};
use crate::{
    ClockOffset, Error,
    backoff::Backoff,
    error::chain,
    v1::{
        self, push_client::PushClient, push_request::Message as Request,
        push_response::Message as Response,
    },
};

const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
const PROBE_EVERY: Duration = Duration::from_millis(500);
/// The first probes come quickly: nothing is sent before the server's clock is known.
const FIRST_PROBES: u32 = 8;
const FIRST_PROBE_EVERY: Duration = Duration::from_millis(20);
/// Nothing from the server for so long: the way to it is broken.
const SILENCE: Duration = Duration::from_secs(2);
/// Messages between the backlog and the socket. What has left the backlog cannot grow too old any more, so few.
const ON_THE_WAY: usize = 4;

/// Connects, and connects again.
pub(super) async fn run(shared: Arc<Shared>, address: String, endpoint: Endpoint) {
    let endpoint = endpoint.connect_timeout(CONNECT_TIMEOUT).tcp_nodelay(true);
    let mut backoff = Backoff::default();
    loop {
        let error = connection(&shared, &address, &endpoint, &mut backoff).await;
        let refused = !error.is_temporary();
        shared.publish(|status| {
            status.connected = false;
            status.error = error.to_string();
            status.refused = refused;
        });
        sleep(backoff.next_pause()).await;
    }
}

/// One connection, from its greeting to its end, and why it ended.
async fn connection(
    shared: &Shared,
    address: &str,
    endpoint: &Endpoint,
    backoff: &mut Backoff,
) -> Error {
    let unreachable = |reason: String| Error::Unreachable { address: address.to_owned(), reason };
    let channel = match endpoint.connect().await {
        Ok(channel) => channel,
        Err(error) => return unreachable(chain(&error)),
    };
    let (outgoing, received) = mpsc::channel::<v1::PushRequest>(ON_THE_WAY);
    let requests = stream::unfold(received, |mut received| async move {
        let request = received.recv().await?;
        Some((request, received))
    });
    let mut client = PushClient::new(channel).max_encoding_message_size(MAX_MESSAGE_BYTES);
    let (next_sequence, dropped) = {
        let backlog = &shared.lock().backlog;
        (backlog.next_sequence(), backlog.dropped_before_next())
    };
    let greeting = v1::PushGreeting {
        camera: shared.options.camera.clone(),
        sender: shared.options.sender.clone(),
        run_id: shared.run_id.clone(),
        times: shared.options.times as i32,
        next_sequence,
        dropped,
    };
    // Room for the first one is there.
    let _ = outgoing.send(message(Request::Greeting(greeting))).await;
    let answers = match timeout(SILENCE, client.send(requests)).await {
        Ok(Ok(answers)) => answers.into_inner(),
        Ok(Err(status)) => return Error::from_status(address, &status),
        Err(_) => return unreachable(silence()),
    };
    Talk { shared, address, outgoing }.run(answers, backoff).await
}

fn silence() -> String {
    format!("the server says nothing for {:.0} s", SILENCE.as_secs_f64())
}

fn message(message: Request) -> v1::PushRequest {
    v1::PushRequest { message: Some(message) }
}

/// A connection that was made.
struct Talk<'a> {
    shared: &'a Shared,
    address: &'a str,
    outgoing: mpsc::Sender<v1::PushRequest>,
}

impl Talk<'_> {
    async fn run(self, mut answers: Streaming<v1::PushResponse>, backoff: &mut Backoff) -> Error {
        // When the server last said something.
        let mut heard = Instant::now();
        let mut is_welcome = false;
        let mut probes = 0;
        let mut quick = interval(FIRST_PROBE_EVERY);
        let mut steady = interval(PROBE_EVERY);
        quick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        steady.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            let knows_time = self.knows_time();
            let wants_to_send = is_welcome && knows_time;
            tokio::select! {
                answer = answers.message() => match answer {
                    Ok(Some(v1::PushResponse { message: Some(answer) })) => {
                        heard = Instant::now();
                        is_welcome |= matches!(answer, Response::Welcome(_));
                        self.take(answer);
                        if is_welcome && self.knows_time() {
                            backoff.reset();
                        }
                    }
                    Ok(Some(_)) => {}
                    Ok(None) => return self.lost("the server ended the stream".to_owned()),
                    Err(status) => return Error::from_status(self.address, &status),
                },
                _ = quick.tick(), if is_welcome && probes < FIRST_PROBES => {
                    probes += 1;
                    self.probe();
                }
                _ = steady.tick() => {
                    if heard.elapsed() > SILENCE {
                        return self.lost(silence());
                    }
                    self.probe();
                }
                () = self.shared.news.notified(), if wants_to_send => self.send_all(),
                _ = self.outgoing.reserve(), if wants_to_send && self.has_work() => self.send_all(),
            }
        }
    }

    fn lost(&self, reason: String) -> Error {
        Error::Unreachable { address: self.address.to_owned(), reason }
    }

    /// Whether times can be brought to the server's clock, or need not be.
    fn knows_time(&self) -> bool {
        let now_ns = self.shared.now_ns();
        self.shared.options.times != v1::PushTimes::Server
            || self.shared.lock().clock.offset_at(now_ns).is_some()
    }

    fn has_work(&self) -> bool {
        let state = self.shared.lock();
        (state.trouble.is_some() && !state.trouble_told)
            || state.picture.is_some()
            || state.backlog.can_take()
    }

    /// A probe that finds no room is not sent: it would only measure the queue.
    fn probe(&self) {
        let now_ns = self.shared.now_ns();
        let (next_sequence, known) = {
            let mut state = self.shared.lock();
            state.backlog.expire(now_ns);
            (state.backlog.next_sequence(), state.clock.offset_at(now_ns))
        };
        let probe = v1::PushProbe {
            sent_time_ns: now_ns,
            next_sequence,
            round_trip_ms: known.map_or(0.0, |known| known.round_trip_ns as f64 * 1e-6),
            clock_deviation_ms: known.map_or(0.0, |known| known.deviation_ns as f64 * 1e-6),
        };
        let _ = self.outgoing.try_send(message(Request::Probe(probe)));
    }

    /// Sends what there is and what there is room for.
    fn send_all(&self) {
        while let Ok(room) = self.outgoing.try_reserve() {
            let now_ns = self.shared.now_ns();
            let mut state = self.shared.lock();
            let offset = state.clock.offset_at(now_ns);
            if let Some((sequence, item)) = state.backlog.take(now_ns) {
                drop(state);
                let convert = self.shared.options.times == v1::PushTimes::Server;
                room.send(message(on_servers_clock(sequence, &item, offset.filter(|_| convert))));
            } else if let Some(error) = state.trouble.clone().filter(|_| !state.trouble_told) {
                state.trouble_told = true;
                room.send(message(Request::Trouble(v1::PushedTrouble { error })));
            } else if let Some(mut picture) = state.picture.take() {
                drop(state);
                if let Some(seen) = &mut picture.observations {
                    move_times(seen, offset.map_or(0, |offset| offset.offset_ns));
                }
                room.send(message(Request::Picture(picture)));
            } else {
                return;
            }
        }
    }

    fn take(&self, answer: Response) {
        let now_ns = self.shared.now_ns();
        match answer {
            Response::Welcome(welcome) => {
                let window_ns = (welcome.late_window_ms.clamp(0.0, 3.6e6) * 1e6) as i64;
                {
                    let mut state = self.shared.lock();
                    // It may be another server, or have been started anew.
                    state.clock.forget();
                    state.trouble_told = false;
                    state.backlog.welcome(welcome.newest_sequence, window_ns, now_ns);
                }
                self.shared.publish(|status| {
                    (status.connected, status.refused) = (true, false);
                    status.connections += 1;
                    status.error.clear();
                });
            }
            Response::Acknowledgement(v1::PushAcknowledgement { sequence }) => {
                self.shared.lock().backlog.acknowledge(sequence);
                self.shared.publish(|_| {});
            }
            Response::ProbeAnswer(answer) => {
                let own = [answer.sent_time_ns, now_ns];
                let servers = [answer.received_time_ns, answer.replied_time_ns];
                self.shared.lock().clock.learn(own, servers);
            }
            Response::Calibration(calibration) => {
                self.shared.calibration.send_replace(Some(calibration));
            }
            Response::PictureRequest(_) => {
                self.shared.picture_requests.send_modify(|requests| *requests += 1);
            }
        }
    }
}

/// The item with its number and, where the clocks' difference is given, with times of the server's.
fn on_servers_clock(sequence: u64, item: &Item, offset: Option<ClockOffset>) -> Request {
    let offset_ns = offset.map_or(0, |offset| offset.offset_ns);
    let clock = |given: Option<v1::CaptureClock>| {
        let deviation_ms = offset.map_or(0.0, |offset| offset.deviation_ns as f64 * 1e-6);
        let given = given?;
        Some(v1::CaptureClock { deviation_ms: given.deviation_ms.hypot(deviation_ms), ..given })
    };
    match item {
        Item::Frame(frame) => {
            let mut frame = v1::PushedFrame::clone(frame);
            frame.sequence = sequence;
            frame.capture_time_ns = frame.capture_time_ns.saturating_add(offset_ns);
            frame.clock = clock(frame.clock);
            Request::Frame(frame)
        }
        Item::Observations(observations) => {
            let mut seen = v1::PushedObservations::clone(observations);
            seen.sequence = sequence;
            seen.clock = clock(seen.clock);
            if let Some(frame) = &mut seen.observations {
                move_times(frame, offset_ns);
            }
            Request::Observations(seen)
        }
    }
}

fn move_times(frame: &mut v1::FrameObservations, offset_ns: i64) {
    let times = [&mut frame.capture_time_ns, &mut frame.received_time_ns];
    let rows = frame.detections.iter_mut().map(|it| &mut it.capture_time_ns);
    rows.chain(times).for_each(|time| *time = time.saturating_add(offset_ns));
}
