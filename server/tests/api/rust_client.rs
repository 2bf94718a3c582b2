//! The Rust client (`roundel-client`) against this server.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex},
    time::Duration,
};

use axum::http::{HeaderMap, Uri};
use futures::StreamExt;
use roundel_client::{
    Client, Code, Error, LinkState, Snapshots, Subscription, Update, coded, named, predicted, v1,
};
use roundel_server::api::ApiLimits;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpListener,
    time::timeout,
};

use super::rig::{self, Rig, TIMEOUT, objects};

async fn next(snapshots: &mut Snapshots) -> Update {
    timeout(TIMEOUT, snapshots.next()).await.expect("no update arrives").unwrap().unwrap()
}

/// The next update that is not a failed connection attempt.
async fn next_after_retries(snapshots: &mut Snapshots) -> Update {
    loop {
        match next(snapshots).await {
            Update::Disconnected { .. } => {}
            update => return update,
        }
    }
}

fn sequence(update: &Update) -> u64 {
    match update {
        Update::Snapshot(snapshot) => snapshot.sequence,
        other => panic!("expected a snapshot, found {other:?}"),
    }
}

#[tokio::test]
async fn calls_return_the_servers_state() {
    let rig = Rig::start().await;
    rig.publish(objects(3));
    // The scheme of the address is optional.
    let client = Client::connect(&rig.address).await.unwrap();
    assert_eq!(client.address(), rig.url());
    assert_eq!(client.info().await.unwrap().name, "lab");
    assert_eq!(client.objects().await.unwrap().len(), 3);
    assert_eq!(client.cameras().await.unwrap()[0].name, "north");
    assert_eq!(client.snapshot().await.unwrap().objects.len(), 3);

    let wanted = Subscription::default()
        .ids([1, 2])
        .region([1.5, -9.0, 0.0], [9.0, 9.0, f64::INFINITY])
        .horizon(Duration::from_millis(100))
        .without_covariance();
    let Update::Snapshot(snapshot) = next(&mut client.snapshots(wanted)).await else { panic!() };
    assert_eq!(snapshot.objects.len(), 1);
    assert_eq!(snapshot.objects[0].position.unwrap().x, 2.1);
    assert!(snapshot.objects[0].covariance.is_empty());

    // Selects by name and code, in a stream and in a single call; only object 2 has a name.
    let by_name = Subscription::default().names(["cart \"one\""]).codes_of(8, [3]);
    let once = client.snapshot_of(by_name.clone().without_covariance()).await.unwrap();
    let Update::Snapshot(snapshot) = next(&mut client.snapshots(by_name)).await else { panic!() };
    for snapshot in [&snapshot, &once] {
        assert_eq!(named(snapshot, "cart \"one\"").map(|it| it.object_id), Some(2));
        assert_eq!((snapshot.objects.len(), coded(snapshot, 2).is_some()), (1, true));
    }
    assert!(once.objects[0].covariance.is_empty() && !snapshot.objects[0].covariance.is_empty());

    let refused = client.snapshots(Subscription::default().max_rate_hz(-1.0)).next().await;
    let Some(Err(error)) = refused else { panic!("{refused:?}") };
    assert!(matches!(
        &error,
        Error::Refused { code: Code::InvalidArgument, field: Some(field), .. } if field == "max_rate_hz"
    ));
    assert!(!error.is_temporary());
    assert!(error.to_string().contains("max_rate_hz: expected a rate above 0"), "{error}");
    let error = client.observations(&["east"]).await.unwrap_err();
    assert!(error.to_string().contains("no camera \"east\"; there are: north"), "{error}");
    assert!(client.events(5000).await.is_err());
    rig.stop().await;
}

#[tokio::test]
async fn latest_holds_the_newest_snapshot_and_counts_replaced_ones() {
    let rig = Rig::start().await;
    let client = Client::connect(&rig.address).await.unwrap();
    let mut latest = client.latest(Subscription::default().roundels(["robot"]));
    assert_eq!(latest.value().unwrap(), None);
    rig.publish(objects(3));
    let first = timeout(TIMEOUT, latest.next()).await.unwrap().unwrap();
    assert_eq!((first.sequence, first.objects.len(), latest.skipped()), (1, 2, 0));
    let mut all = client.snapshots(Subscription::default());
    next(&mut all).await;
    for sequence in 2..=6 {
        rig.publish(objects(3));
        assert_eq!(self::sequence(&next(&mut all).await), sequence);
    }
    // Nothing has been read since: of five snapshots the newest is available, and the four before it were replaced.
    let replaced = async {
        while latest.skipped() + latest.missed() < 4 {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    };
    timeout(TIMEOUT, replaced).await.expect("replaced snapshots are not counted");
    assert_eq!((latest.skipped(), latest.missed()), (4, 0));
    assert_eq!(latest.value().unwrap().unwrap().sequence, 6);
    assert_eq!(latest.skipped(), 4, "a snapshot that was read must not count as skipped");
    let waiting = timeout(Duration::from_millis(50), latest.next()).await;
    assert!(waiting.is_err(), "a snapshot was returned twice: {waiting:?}");

    let mut refused = client.latest(Subscription::default().roundels(["unheard"]));
    let error = timeout(TIMEOUT, refused.next()).await.unwrap().unwrap_err();
    assert!(error.to_string().contains("any of robot, cart"), "{error}");
    assert_eq!(refused.value().unwrap_err(), error);
    rig.stop().await;
}

#[tokio::test]
async fn a_slow_reader_learns_how_many_snapshots_it_missed() {
    const LAST: u64 = 100;
    let rig = Rig::start().await;
    let connect = || Client::connect(&rig.address);
    let mut slow = connect().await.unwrap().snapshots(Subscription::default());
    let mut quick = connect().await.unwrap().snapshots(Subscription::default());
    rig.publish(objects(1));
    assert_eq!(sequence(&next(&mut slow).await), 1);
    assert_eq!(sequence(&next(&mut quick).await), 1);
    // A snapshot has about 60 kB, of which a stream buffers only a few.
    for published in 2..=LAST {
        rig.publish(objects(150));
        assert_eq!(sequence(&next(&mut quick).await), published);
    }
    assert_eq!(quick.missed(), 0, "a slow subscriber must not affect another");
    let (mut received, mut newest) = (1, 1);
    while newest < LAST {
        newest = sequence(&next(&mut slow).await);
        received += 1;
    }
    assert!(slow.missed() > LAST / 2, "{} were missed", slow.missed());
    assert_eq!(received + slow.missed(), LAST);
    rig.stop().await;
}

#[tokio::test]
async fn prediction_and_clock_offset_match_the_server() {
    let rig = Rig::start().await;
    let mut moving = objects(3);
    for (index, object) in moving.iter_mut().enumerate() {
        object.acceleration_m_s2 = nalgebra::Vector3::new(0.5, -1.0, 0.1) * index as f64;
        object.angular_velocity_rad_s = nalgebra::Vector3::new(0.2, 0.1, 1.0);
        object.yaw_observed = true;
    }
    rig.publish(moving);
    let client = Client::connect(&rig.address).await.unwrap();
    let ahead = Subscription::default().horizon(Duration::from_millis(250));
    let Update::Snapshot(theirs) = next(&mut client.snapshots(ahead)).await else { panic!() };
    let own = predicted(&client.snapshot().await.unwrap(), 0.25);
    assert_eq!(own.pose_time_ns, theirs.pose_time_ns);
    for (own, theirs) in own.objects.iter().zip(&theirs.objects) {
        let (p, q) = (own.position.unwrap(), theirs.position.unwrap());
        assert!((p.x - q.x).abs() + (p.y - q.y).abs() + (p.z - q.z).abs() < 1e-12, "{p:?} {q:?}");
        let (p, q) = (own.velocity.unwrap(), theirs.velocity.unwrap());
        assert!((p.x - q.x).abs() + (p.y - q.y).abs() < 1e-12, "{p:?} {q:?}");
        let (p, q) = (own.orientation.unwrap(), theirs.orientation.unwrap());
        let dot = p.x * q.x + p.y * q.y + p.z * q.z + p.w * q.w;
        assert!((dot.abs() - 1.0).abs() < 1e-12, "{p:?} {q:?}");
    }
    let clock = client.clock_offset().await.unwrap();
    // Client and server share one clock, so the offset is within the round trip.
    assert!(clock.offset_ns.abs() <= clock.round_trip_ns + 10_000_000, "{clock:?}");
    let refused = client.drive([(1, [0.1, 0.0, 0.0])]).await.unwrap_err();
    assert!(refused.to_string().contains("nothing is simulated here"), "{refused}");
    let refused = client.push_robot(1, [9.0, 0.0, 0.0], TIMEOUT).await.unwrap_err();
    assert!(refused.to_string().contains("at most 2 m/s"), "{refused}");
    rig.stop().await;
}

#[tokio::test]
async fn reconnects_and_reports_the_gap() {
    let hub = rig::hub("run");
    let rig = Rig::start_with(hub.clone(), ApiLimits::default(), "127.0.0.1:0").await;
    let address = rig.address.clone();
    rig.publish(objects(1));
    let client = Client::connect(&address).await.unwrap();
    let mut snapshots = client.snapshots(Subscription::default());
    assert_eq!(sequence(&next(&mut snapshots).await), 1);
    rig.publish(objects(1));
    assert_eq!(sequence(&next(&mut snapshots).await), 2);
    let mut events = client.events(0).await.unwrap();

    rig.stop().await;
    let lost = next(&mut snapshots).await;
    let Update::Disconnected { reason, tries: 0, .. } = &lost else { panic!("{lost:?}") };
    assert!(reason.contains("shutting down"), "{reason}");
    assert!(events.next().await.unwrap().is_err(), "events end with the connection");
    let failed = next(&mut snapshots).await;
    let Update::Disconnected { reason, tries: 1, .. } = &failed else { panic!("{failed:?}") };
    assert!(reason.contains("refused"), "{reason}");

    // The same run of the server, as after a network failure: three snapshots were published meanwhile.
    tokio::time::sleep(Duration::from_millis(30)).await;
    let rig = Rig::start_with(hub, ApiLimits::default(), &address).await;
    (0..4).for_each(|_| rig.publish(objects(1)));
    let back = next_after_retries(&mut snapshots).await;
    let Update::Reconnected { gap, restarted: false, missed: Some(3) } = back else {
        panic!("{back:?}")
    };
    assert!(gap >= Duration::from_millis(30), "{gap:?}");
    assert_eq!(sequence(&next(&mut snapshots).await), 6);
    assert_eq!(snapshots.missed(), 3);
    rig.stop().await;

    // A new run: its sequence restarts, so the number of missed snapshots is unknown.
    let rig = Rig::start_with(rig::hub("next run"), ApiLimits::default(), &address).await;
    rig.publish(objects(1));
    let back = next_after_retries(&mut snapshots).await;
    let Update::Reconnected { restarted: true, missed: None, .. } = back else {
        panic!("{back:?}")
    };
    assert_eq!(sequence(&next(&mut snapshots).await), 1);
    rig.publish(objects(1));
    assert_eq!(sequence(&next(&mut snapshots).await), 2);
    rig.stop().await;
}

#[tokio::test]
async fn a_first_connection_to_a_late_server_is_not_a_reconnection() {
    let (listener, address) = free_port().await;
    drop(listener);
    let client = Client::connect_lazily(&address).unwrap();
    let mut snapshots = client.snapshots(Subscription::default());
    let early = next(&mut snapshots).await;
    assert!(matches!(early, Update::Disconnected { tries: 1, .. }), "{early:?}");
    let mut latest = client.latest(Subscription::default());
    assert_eq!(latest.link().tries, 0);
    let link = timeout(TIMEOUT, latest.link_changed()).await.unwrap();
    assert!(link.state == LinkState::Connecting && link.tries > 0, "{link:?}");
    assert_eq!(link.losses, 0);
    let rig = Rig::start_with(rig::hub("run"), ApiLimits::default(), &address).await;
    rig.publish(objects(1));
    assert_eq!(sequence(&next_after_retries(&mut snapshots).await), 1);
    timeout(TIMEOUT, latest.next()).await.unwrap().unwrap();
    while latest.link().state != LinkState::Connected {
        timeout(TIMEOUT, latest.link_changed()).await.unwrap();
    }
    assert_eq!((latest.link().tries, latest.link().losses), (0, 0));
    rig.stop().await;
}

#[tokio::test]
async fn recent_rejects_a_stale_snapshot() {
    let rig = Rig::start().await;
    let address = rig.address.clone();
    let client = Client::connect(&address).await.unwrap();
    let mut latest = client.latest(Subscription::default());
    let Err(Error::Stale { age: None, link, .. }) = latest.recent(TIMEOUT) else { panic!() };
    assert_eq!((link.state, latest.age()), (LinkState::Connecting, None));
    rig.publish(objects(2));
    timeout(TIMEOUT, latest.next()).await.unwrap().unwrap();
    assert_eq!(latest.recent(TIMEOUT).unwrap().sequence, 1);
    while latest.link().state != LinkState::Connected {
        timeout(TIMEOUT, latest.link_changed()).await.unwrap();
    }
    // The server is connected but publishes nothing.
    tokio::time::sleep(Duration::from_millis(20)).await;
    let error = latest.recent(Duration::from_millis(20)).unwrap_err();
    let Error::Stale { age: Some(age), link, .. } = &error else { panic!("{error:?}") };
    assert!(*age >= Duration::from_millis(20) && link.state == LinkState::Connected, "{error}");
    assert!(error.is_temporary());

    rig.stop().await;
    while latest.link().state != LinkState::Lost {
        timeout(TIMEOUT, latest.link_changed()).await.unwrap();
    }
    let error = latest.recent(Duration::ZERO).unwrap_err().to_string();
    assert!(error.contains("the connection is lost: "), "{error}");
    assert_eq!(
        latest.value().unwrap().unwrap().sequence,
        1,
        "the last snapshot must remain available"
    );
    let rig = Rig::start_with(rig::hub("next run"), ApiLimits::default(), &address).await;
    rig.publish(objects(3));
    let back = timeout(TIMEOUT, latest.next()).await.unwrap().unwrap();
    assert_eq!((back.source_id.as_str(), back.objects.len()), ("next run", 3));
    while latest.link().state != LinkState::Connected {
        timeout(TIMEOUT, latest.link_changed()).await.unwrap();
    }
    let link = latest.link();
    assert_eq!((link.losses, link.restarts, link.tries), (1, 1, 0));
    assert!(link.reason.is_some(), "the reason of the last loss must remain");
    rig.stop().await;
}

#[tokio::test]
async fn calls_time_out_and_streams_do_not() {
    // The connection is accepted, but never answered.
    let (listener, address) = free_port().await;
    let client = Client::connect_lazily(&address).unwrap().with_timeout(Duration::from_millis(200));
    let error =
        timeout(TIMEOUT, client.info()).await.expect("the call does not time out").unwrap_err();
    assert!(matches!(error, Error::TimedOut { .. }) && error.is_temporary(), "{error:?}");
    drop(listener);
    // The timeout does not apply to streams.
    let rig = Rig::start().await;
    rig.publish(objects(1));
    let timeout_of_calls = Duration::from_millis(50);
    let client = Client::connect(&rig.address).await.unwrap().with_timeout(timeout_of_calls);
    let mut snapshots = client.snapshots(Subscription::default());
    next(&mut snapshots).await;
    tokio::time::sleep(3 * timeout_of_calls).await;
    rig.publish(objects(1));
    assert_eq!(sequence(&next(&mut snapshots).await), 2);
    rig.stop().await;
}

#[tokio::test]
async fn slow_calls_have_a_longer_timeout() {
    // A fake server records the timeout of each call and rejects it.
    let timeouts = Arc::new(Mutex::new(BTreeMap::new()));
    let (recorded, (listener, address)) = (timeouts.clone(), free_port().await);
    let record = move |call: Uri, headers: HeaderMap| async move {
        let call = call.path().trim_start_matches("/roundel.v1.Roundel/").to_owned();
        let deadline = headers["grpc-timeout"].to_str().unwrap().to_owned();
        recorded.lock().unwrap().insert(call, deadline);
        [("content-type", "application/grpc"), ("grpc-status", "12")]
    };
    let app = axum::Router::new().fallback(record);
    let other = tokio::spawn(async move { axum::serve(listener, app).await });
    let client = Client::connect_lazily(&address).unwrap();
    let usual = ["AddObject", "GetServerInfo", "ListObjects"].map(|call| (call, "15000000u"));
    let long = [
        "TestSource",
        "AddCamera",
        "ChangeCamera",
        "RemoveCamera",
        "ApplyConfiguration",
        "StopRecording",
        "QueryHistory",
    ];
    let long = long.map(|call| (call, "60000000u"));
    let owned = |(call, deadline): (&str, &str)| (call.to_owned(), deadline.to_owned());
    let expected: BTreeMap<_, _> = usual.into_iter().chain(long).map(owned).collect();
    timeout(TIMEOUT, call_everything(&client)).await.unwrap();
    assert_eq!(std::mem::take(&mut *timeouts.lock().unwrap()), expected);
    // An explicit timeout applies to all calls.
    let client = client.with_timeout(Duration::from_secs(20));
    timeout(TIMEOUT, call_everything(&client)).await.unwrap();
    let deadline = std::mem::take(&mut *timeouts.lock().unwrap());
    assert!(
        deadline.len() == 10 && deadline.values().all(|deadline| deadline == "20000000u"),
        "{deadline:?}"
    );
    other.abort();
}

/// Every slow call, and some others; all are rejected.
async fn call_everything(client: &Client) {
    let camera = v1::CameraSetup::default;
    client.info().await.unwrap_err();
    client.objects().await.unwrap_err();
    client.add_object(v1::ObjectSetup::default()).await.unwrap_err();
    client.test_source("sim:", None).await.unwrap_err();
    client.add_camera(camera()).await.unwrap_err();
    client.change_camera("north", camera(), &[]).await.unwrap_err();
    client.remove_camera("north").await.unwrap_err();
    client.apply_configuration("", "").await.unwrap_err();
    client.stop_recording().await.unwrap_err();
    client.history(v1::QueryHistoryRequest::default()).await.unwrap_err();
}

async fn free_port() -> (TcpListener, String) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    (listener, address)
}

#[tokio::test]
async fn connection_errors_distinguish_wrong_addresses() {
    let error = Client::connect("ws://127.0.0.1:7670").await.unwrap_err();
    assert!(matches!(error, Error::InvalidAddress { .. }), "{error}");

    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    drop(listener);
    let error = Client::connect(&address).await.unwrap_err();
    assert!(matches!(error, Error::Unreachable { .. }), "{error:?}");
    let text = error.to_string();
    assert!(text.contains("refused") && text.contains("roundel serve"), "{text}");

    // A web server that supports only HTTP/1.1.
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let web = tokio::spawn(async move {
        while let Ok((mut stream, _)) = listener.accept().await {
            let mut request = [0; 1024];
            let _ = stream.read(&mut request).await;
            let _ =
                stream.write_all(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n").await;
        }
    });
    let error = timeout(TIMEOUT, Client::connect(&address)).await.unwrap().unwrap_err();
    assert!(matches!(error, Error::NotRoundel { .. }), "{error:?}");
    web.abort();
}

#[tokio::test]
async fn rejects_another_grpc_server() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let (_, health) = tonic_health::server::health_reporter();
    let routes = tonic::service::Routes::new(health).into_axum_router();
    let other = tokio::spawn(async move { axum::serve(listener, routes).await });
    let error = timeout(TIMEOUT, Client::connect(&address)).await.unwrap().unwrap_err();
    assert!(matches!(error, Error::NotRoundel { .. }), "{error:?}");
    other.abort();
}
