//! Measured sizes of prints: REST, gRPC and metrics.

use roundel_core::{
    id::{CameraId, KindId},
    world::{KindPrintSize, PrintSize, PrintSizeState},
};
use roundel_proto::v1;
use serde_json::Value;

use super::rig::Rig;

#[tokio::test]
async fn serves_the_sizes_of_prints() {
    let rig = Rig::start().await;
    let print = |json: Value| json["print_sizes"][0].clone();
    let exact = print(rig.get("/api/v1/print-sizes").await.json());
    assert_eq!((&exact["state"], &exact["factor"]), (&"exact".into(), &1.0.into()));
    let size = PrintSize { factor: 0.97, deviation: 0.0004, flatness_m: 0.0 };
    let (kind, cameras) = (KindId(0), vec![CameraId(1)]);
    let state = PrintSizeState::Measured;
    rig.hub.set_print_sizes([KindPrintSize { kind, size, state, cameras }].into_iter());
    let measured = print(rig.get("/api/v1/print-sizes").await.json());
    let expected = serde_json::json!({
        "roundel": exact["roundel"], "factor": 0.97, "deviation": 0.0004, "state": "measured", "cameras": ["south side"],
    });
    assert_eq!(measured, expected);
    let grpc =
        super::grpc::connect(&rig).await.list_print_sizes(v1::ListPrintSizesRequest {}).await;
    assert_eq!(grpc.unwrap().into_inner().print_sizes[0].factor, 0.97);
    let name = exact["roundel"].as_str().unwrap();
    let metrics = rig.get("/metrics").await;
    let line = format!("roundel_print_size_ratio{{roundel=\"{name}\"}} 0.97");
    assert!(metrics.text().contains(&line), "{}", metrics.text());
    rig.stop().await;
}
