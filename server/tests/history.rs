//! The history of object positions, queried over gRPC and REST.

use std::{net::SocketAddr, time::Duration};

use axum::body::Body;
use http_body_util::BodyExt;
use hyper_util::{client::legacy, rt::TokioExecutor};
use roundel_client::{Client, v1};
use roundel_server::{app::serve::Server, model::config::Config};
use tokio::time::{sleep, timeout};

/// Timeout of every wait; only a stalled machine reaches it.
const TIMEOUT: Duration = Duration::from_secs(60);

const CONFIG: &str = "name = \"lab\"\n[server]\nlisten = \"127.0.0.1:0\"\n[detection]\nmode = \"fast\"\n\
    [[roundel]]\nname = \"robot\"\nouter_mm = 160.0\ninner_mm = 64.0\n\
    [[camera]]\nname = \"c0\"\nsource = \"sim:?seed=1&robots=6&camera=0\"\n";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn positions_are_kept_over_a_restart() {
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
        let answer = timeout(TIMEOUT, ask).await.expect("points");
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
        assert_eq!(found.len(), run, "each run must have its own source ID");
        runs = found;
        let wrong = v1::QueryHistoryRequest { max_points: 5001, ..Default::default() };
        let error = client.history(wrong).await.unwrap_err().to_string();
        assert!(error.contains("max_points: expected 1 to 5000, found 5001"), "{error}");
        check_exports(server.local_addr(), answer.points as usize).await;
        // Sides of a region may be infinite.
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
        assert!(
            error.contains("region.max.x: expected at least 1 (region.min.x), found 0"),
            "{error}"
        );
        server.shutdown().await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn reports_a_missing_history() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(Config::parse(CONFIG, folder.path()).unwrap()).await.unwrap();
    let client = Client::connect(&format!("http://{}", server.local_addr())).await.unwrap();
    let error = client.history(v1::QueryHistoryRequest::default()).await.unwrap_err().to_string();
    assert!(error.contains("this server keeps no history: add [history]"), "{error}");
    server.shutdown().await;
}

/// Downloads the history as CSV and, if the server is built with that feature, as Parquet.
async fn check_exports(address: SocketAddr, at_least: usize) {
    let (status, text) = get(address, "history.csv").await;
    assert_eq!(status, 200);
    let text = String::from_utf8(text).unwrap();
    let mut lines = text.lines();
    let names = "time_ns,object_id,name,roundel,code,x_m,y_m,z_m,yaw_rad,source_id";
    assert_eq!(lines.next(), Some(names));
    assert!(lines.count() >= at_least);
    let (status, bytes) = get(address, "history.parquet").await;
    #[cfg(not(feature = "parquet"))]
    {
        let text = String::from_utf8(bytes).unwrap();
        assert_eq!((status, text.contains("--features parquet")), (409, true), "{text}");
    }
    #[cfg(feature = "parquet")]
    {
        use parquet::{
            file::{reader::FileReader, serialized_reader::SerializedFileReader},
            record::RowAccessor,
        };

        assert_eq!(status, 200);
        let reader = SerializedFileReader::new(axum::body::Bytes::from(bytes)).unwrap();
        let schema = reader.metadata().file_metadata().schema_descr_ptr();
        let columns: Vec<&str> = schema.columns().iter().map(|column| column.name()).collect();
        assert_eq!(columns.join(","), names);
        let rows: Vec<_> = reader.get_row_iter(None).unwrap().map(Result::unwrap).collect();
        assert!(rows.len() >= at_least, "{} rows", rows.len());
        // Compares with the CSV row by row, for the first object only: the second download may have more rows.
        let lines: Vec<Vec<&str>> =
            text.lines().skip(1).map(|it| it.split(',').collect()).collect();
        for (row, cells) in rows.iter().zip(lines.iter().take_while(|it| it[1] == lines[0][1])) {
            assert_eq!(row.get_long(1).unwrap().to_string(), cells[1]);
            assert_eq!(row.get_string(3).unwrap(), "robot");
            assert!(row.get_int(4).is_err(), "a missing code must be null");
            for (column, cell) in [(5, cells[5]), (6, cells[6]), (7, cells[7])] {
                assert_eq!(row.get_double(column).unwrap(), cell.parse::<f64>().unwrap());
            }
            assert_eq!(row.get_string(9).unwrap(), cells[9]);
        }
    }
}

async fn get(address: SocketAddr, table: &str) -> (u16, Vec<u8>) {
    let client = legacy::Client::builder(TokioExecutor::new()).build_http::<Body>();
    let url = format!("http://{address}/api/v1/{table}").parse().unwrap();
    let response = timeout(TIMEOUT, client.get(url)).await.unwrap().unwrap();
    let status = response.status().as_u16();
    (status, response.into_body().collect().await.unwrap().to_bytes().to_vec())
}
