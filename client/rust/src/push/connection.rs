//! The connections of a pusher, one after the other: greeting, probes, sending, acknowledgements.
//!
//! Each has its own channel and is closed when the server sends nothing for [`SILENCE_TIMEOUT`], since a cut network reports
//! no error.

use std::{sync::Arc, time::Duration};

use backon::ExponentialBackoff;
use futures::stream;
use tokio::{
    sync::mpsc,
    time::{Instant, MissedTickBehavior, interval, sleep, timeout},
};
use tonic::Streaming;

use super::{MAX_MESSAGE_BYTES, Shared, queue::Item};
use crate::{
    ClockOffset, Error, backoff,
    call_headers::CallHeaders,
    connector::Connector,
    v1::{
        self, push_client::PushClient, push_request::Message as Request,
        push_response::Message as Response,
    },
};

const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
const PROBE_INTERVAL: Duration = Duration::from_millis(500);
/// The first probes have a shorter interval, since nothing is sent before the server's clock is known.
const FIRST_PROBES: u32 = 8;
const FIRST_PROBE_INTERVAL: Duration = Duration::from_millis(20);
/// A server that sends nothing for this long is unreachable.
const SILENCE_TIMEOUT: Duration = Duration::from_secs(2);
/// Capacity of the channel between queue and socket. Small, since items no longer expire there.
const CHANNEL_CAPACITY: usize = 4;

/// Connects and reconnects until the task is aborted.
pub(super) async fn run(shared: Arc<Shared>, connector: Connector, headers: CallHeaders) {
    let connector = connector.configure(|endpoint| endpoint.connect_timeout(CONNECT_TIMEOUT));
    let mut delays = backoff::delays();
    loop {
        let error = connect(&shared, &connector, &headers, &mut delays).await;
        let refused = !error.is_temporary();
        shared.publish(|status| {
            status.connected = false;
            status.error = error.to_string();
            status.refused = refused;
        });
        sleep(delays.next().unwrap_or_default()).await;
    }
}

/// Runs one connection. Returns the error that ended it.
async fn connect(
    shared: &Shared,
    connector: &Connector,
    headers: &CallHeaders,
    delays: &mut ExponentialBackoff,
) -> Error {
    let address = connector.address.as_str();
    let unreachable = |reason: String| Error::Unreachable { address: address.to_owned(), reason };
    let channel = match connector.connect().await {
        Ok(channel) => channel,
        Err(error) => return Error::from_transport(address, &error),
    };
    let (outgoing, received) = mpsc::channel::<v1::PushRequest>(CHANNEL_CAPACITY);
    let requests = stream::unfold(received, |mut received| async move {
        let request = received.recv().await?;
        Some((request, received))
    });
    let mut client = PushClient::with_interceptor(channel, headers.clone())
        .max_encoding_message_size(MAX_MESSAGE_BYTES);
    let (next_sequence, dropped) = {
        let queue = &shared.lock().queue;
        (queue.next_sequence(), queue.dropped_before_next())
    };
    let greeting = v1::PushGreeting {
        camera: shared.options.camera.clone(),
        sender: shared.options.sender.clone(),
        run_id: shared.run_id.clone(),
        times: shared.options.times as i32,
        next_sequence,
        dropped,
    };
    // The channel is empty, so this does not block.
    let _ = outgoing.send(message(Request::Greeting(greeting))).await;
    let answers = match timeout(SILENCE_TIMEOUT, client.send(requests)).await {
        Ok(Ok(answers)) => answers.into_inner(),
        Ok(Err(status)) => return Error::from_status(address, &status),
        Err(_) => return unreachable(silence_reason()),
    };
    Connection { shared, address, outgoing }.run(answers, delays).await
}

fn silence_reason() -> String {
    format!("the server sent nothing for {:.0} s", SILENCE_TIMEOUT.as_secs_f64())
}

fn message(message: Request) -> v1::PushRequest {
    v1::PushRequest { message: Some(message) }
}

/// An established connection.
struct Connection<'a> {
    shared: &'a Shared,
    address: &'a str,
    outgoing: mpsc::Sender<v1::PushRequest>,
}

impl Connection<'_> {
    async fn run(
        self,
        mut answers: Streaming<v1::PushResponse>,
        delays: &mut ExponentialBackoff,
    ) -> Error {
        let mut last_received = Instant::now();
        let mut is_welcomed = false;
        let mut sent_probes = 0;
        let mut first_probes = interval(FIRST_PROBE_INTERVAL);
        let mut probe_ticks = interval(PROBE_INTERVAL);
        first_probes.set_missed_tick_behavior(MissedTickBehavior::Delay);
        probe_ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            let can_send = is_welcomed && self.is_clock_known();
            tokio::select! {
                answer = answers.message() => match answer {
                    Ok(Some(v1::PushResponse { message: Some(answer) })) => {
                        last_received = Instant::now();
                        is_welcomed |= matches!(answer, Response::Welcome(_));
                        self.handle(answer);
                        if is_welcomed && self.is_clock_known() {
                            *delays = backoff::delays();
                        }
                    }
                    Ok(Some(_)) => {}
                    Ok(None) => return self.lost("the server ended the stream".to_owned()),
                    Err(status) => return Error::from_status(self.address, &status),
                },
                _ = first_probes.tick(), if is_welcomed && sent_probes < FIRST_PROBES => {
                    sent_probes += 1;
                    self.probe();
                }
                _ = probe_ticks.tick() => {
                    if last_received.elapsed() > SILENCE_TIMEOUT {
                        return self.lost(silence_reason());
                    }
                    self.probe();
                }
                () = self.shared.work_available.notified(), if can_send => self.send_all(),
                _ = self.outgoing.reserve(), if can_send && self.has_work() => self.send_all(),
            }
        }
    }

    fn lost(&self, reason: String) -> Error {
        Error::Unreachable { address: self.address.to_owned(), reason }
    }

    /// Whether times can be converted to the server's clock, or need no conversion.
    fn is_clock_known(&self) -> bool {
        let now_ns = self.shared.now_ns();
        self.shared.options.times != v1::PushTimes::Server
            || self.shared.lock().clock.offset_at(now_ns).is_some()
    }

    fn has_work(&self) -> bool {
        let state = self.shared.lock();
        (state.trouble.is_some() && !state.is_trouble_sent)
            || state.picture.is_some()
            || state.queue.can_send()
    }

    /// Skips the probe if the channel is full, since it would measure the delay of the queue.
    fn probe(&self) {
        let now_ns = self.shared.now_ns();
        let (next_sequence, offset) = {
            let mut state = self.shared.lock();
            state.queue.expire(now_ns);
            (state.queue.next_sequence(), state.clock.offset_at(now_ns))
        };
        let probe = v1::PushProbe {
            sent_time_ns: now_ns,
            next_sequence,
            round_trip_ms: offset.map_or(0.0, |offset| offset.round_trip_ns as f64 * 1e-6),
            clock_deviation_ms: offset.map_or(0.0, |offset| offset.deviation_ns as f64 * 1e-6),
        };
        let _ = self.outgoing.try_send(message(Request::Probe(probe)));
    }

    /// Sends items until there are none or the channel is full.
    fn send_all(&self) {
        while let Ok(permit) = self.outgoing.try_reserve() {
            let now_ns = self.shared.now_ns();
            let mut state = self.shared.lock();
            let offset = state.clock.offset_at(now_ns);
            if let Some((sequence, item)) = state.queue.take(now_ns) {
                drop(state);
                let convert = self.shared.options.times == v1::PushTimes::Server;
                permit.send(message(to_request(sequence, &item, offset.filter(|_| convert))));
            } else if let Some(error) = state.trouble.clone().filter(|_| !state.is_trouble_sent) {
                state.is_trouble_sent = true;
                permit.send(message(Request::Trouble(v1::PushedTrouble { error })));
            } else if let Some(mut picture) = state.picture.take() {
                drop(state);
                if let Some(frame) = &mut picture.observations {
                    shift_times(frame, offset.map_or(0, |offset| offset.offset_ns));
                }
                permit.send(message(Request::Picture(picture)));
            } else {
                return;
            }
        }
    }

    fn handle(&self, answer: Response) {
        let now_ns = self.shared.now_ns();
        match answer {
            Response::Welcome(welcome) => {
                let window_ns = (welcome.late_window_ms.clamp(0.0, 3.6e6) * 1e6) as i64;
                {
                    let mut state = self.shared.lock();
                    // It may be another or a restarted server, with another clock.
                    state.clock.reset();
                    state.is_trouble_sent = false;
                    state.queue.reconnect(welcome.newest_sequence, window_ns, now_ns);
                }
                self.shared.publish(|status| {
                    (status.connected, status.refused) = (true, false);
                    status.connections += 1;
                    status.error.clear();
                });
            }
            Response::Acknowledgement(v1::PushAcknowledgement { sequence }) => {
                self.shared.lock().queue.acknowledge(sequence);
                self.shared.publish(|_| {});
            }
            Response::ProbeAnswer(answer) => {
                let own = [answer.sent_time_ns, now_ns];
                let server = [answer.received_time_ns, answer.replied_time_ns];
                self.shared.lock().clock.add_probe(own, server);
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

/// The item with its sequence number, and with times of the server's clock if an offset is given.
fn to_request(sequence: u64, item: &Item, offset: Option<ClockOffset>) -> Request {
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
            let mut pushed = v1::PushedObservations::clone(observations);
            pushed.sequence = sequence;
            pushed.clock = clock(pushed.clock);
            if let Some(frame) = &mut pushed.observations {
                shift_times(frame, offset_ns);
            }
            Request::Observations(pushed)
        }
    }
}

fn shift_times(frame: &mut v1::FrameObservations, offset_ns: i64) {
    let times = [&mut frame.capture_time_ns, &mut frame.received_time_ns];
    let rows = frame.detections.iter_mut().map(|it| &mut it.capture_time_ns);
    rows.chain(times).for_each(|time| *time = time.saturating_add(offset_ns));
}
