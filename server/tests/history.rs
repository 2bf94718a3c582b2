//! A history that a server keeps, asked over gRPC and REST.

use std::time::Duration;

use roundel_client::{Client, v1};
use roundel_server::{config::Config, serve::Server};
use tokio::time::{sleep, timeout};

/// Nothing here takes so long but on a machine that stands still.
const PATIENCE: Duration = Duration::from_secs(60);

const CONFIG: &str = "name = \"lab\"\n[server]\nlisten = \"127.0.0.1:0\"\n[detection]\nmode = \"fast\"\n\
    [[roundel]]\nname = \"robot\"\nouter_mm = 160.0\ninner_mm = 64.0\n\
    [[camera]]\nname = \"c0\"\nsource = \"sim:?seed=1&robots=6&camera=0\"\n";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn where_objects_were_is_kept_over_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let text = format!("{CONFIG}[history]\nfile = \"kept.sqlite\"\n");
    let mut runs = Vec::new();
    for run in 1..=2 {
        let server = Server::start(Config::parse(&text, folder.path()).unwrap()).await.unwrap();
        let client = Client::connect(&format!("http://{}", server.local_addr())).await.unwrap();
        let ask = async {
            loop {
                let request = v1::QueryHistoryRequest::default();
                let answer = client.history(request).await.unwrap();
                let of_this_run = |it: &&v1::ObjectHistory| !runs.contains(&it.source_id);
                let fresh = answer.objects.iter().filter(of_this_run);
                if fresh.map(|it| it.points.len()).sum::<usize>() > 20 {
                    return answer;
                }
                sleep(Duration::from_millis(50)).await;
            }
        };
        let answer = timeout(PATIENCE, ask).await.expect("points");
        assert_eq!(
            answer.points as usize,
            answer.objects.iter().map(|it| it.points.len()).sum::<usize>()
        );
        for object in &answer.objects {
            assert_eq!((object.object_id > 0, object.roundel.as_str()), (true, "robot"));
            let times: Vec<i64> = object.points.iter().map(|point| point.time_ns).collect();
            assert!(times.windows(2).all(|pair| pair[1] > pair[0]), "{times:?}");
            assert!(object.points.iter().all(|point| point.position.is_some()));
        }
        let mut found: Vec<String> = answer.objects.iter().map(|it| it.source_id.clone()).collect();
        found.sort_unstable();
        found.dedup();
        assert_eq!(found.len(), run, "each run is told from the others");
        runs = found;
        let wrong = v1::QueryHistoryRequest { max_points: 5001, ..Default::default() };
        let error = client.history(wrong).await.unwrap_err().to_string();
        assert!(error.contains("max_points: expected 1 to 5000, found 5001"), "{error}");
        // A side may be infinitely far, as of every box that a client asks for.
        let corner = |x, y, z| Some(v1::Vector3 { x, y, z });
        let far = f64::INFINITY;
        let part = |min, max| v1::QueryHistoryRequest {
            region: Some(v1::Box { min, max }),
            ..Default::default()
        };
        let everywhere = part(corner(-far, -far, -far), corner(far, far, far));
        assert!(client.history(everywhere).await.unwrap().points >= answer.points);
        let nowhere = part(corner(500.0, 0.0, 0.0), corner(far, far, far));
        assert_eq!(client.history(nowhere).await.unwrap().points, 0);
        let wrong = part(corner(1.0, 0.0, 0.0), corner(0.0, 1.0, 1.0));
        let error = client.history(wrong).await.unwrap_err().to_string();
        assert!(error.contains("max.x: expected at least 1 (min.x), found 0"), "{error}");
        server.shutdown().await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn without_one_that_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(Config::parse(CONFIG, folder.path()).unwrap()).await.unwrap();
    let client = Client::connect(&format!("http://{}", server.local_addr())).await.unwrap();
    let error = client.history(v1::QueryHistoryRequest::default()).await.unwrap_err().to_string();
    assert!(error.contains("this server keeps no history: [history]"), "{error}");
    server.shutdown().await;
    std::fs::write(folder.path().join("taken"), "no database ".repeat(100)).unwrap();
    let text = format!("{CONFIG}[history]\nfile = \"taken\"\n");
    let refused = Server::start(Config::parse(&text, folder.path()).unwrap()).await;
    let error = refused.err().unwrap().to_string();
    assert!(error.contains("taken") && error.contains("`file` in [history]"), "{error}");
}
