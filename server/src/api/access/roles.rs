//! What each route and gRPC method needs.
//!
//! Everything is listed here, so that a review needs one page. A test walks `/openapi.json` and the descriptors and fails
//! for a route or method that is missing. Missing ones need the role `setup`.

use axum::http::Method;
use matchit::Router;
use std::sync::LazyLock;

use super::answered_method;
use crate::model::access::Role;

/// What a request needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    Nothing,
    /// Credentials of any role.
    SignedIn,
    Role(Role),
}

const VIEW: Need = Need::Role(Role::View);
const FEED: Need = Need::Role(Role::Feed);
const OPERATE: Need = Need::Role(Role::Operate);
const SETUP: Need = Need::Role(Role::Setup);

/// Routes of [`openapi::described_routes`](crate::api::openapi::described_routes). All other paths are the dashboard's
/// files.
const ROUTES: &[(&str, &[(Method, Need)])] = &[
    ("/healthz", &[(Method::GET, Need::Nothing)]),
    ("/readyz", &[(Method::GET, Need::Nothing)]),
    ("/openapi.json", &[(Method::GET, Need::Nothing)]),
    ("/metrics", &[(Method::GET, VIEW)]),
    (
        "/api/v1/session",
        &[
            (Method::GET, Need::Nothing),
            (Method::POST, Need::Nothing),
            (Method::DELETE, Need::Nothing),
        ],
    ),
    ("/api/v1/info", &[(Method::GET, Need::SignedIn)]),
    ("/api/v1/time", &[(Method::GET, Need::SignedIn)]),
    ("/api/v1/snapshot", &[(Method::GET, VIEW)]),
    ("/api/v1/stream", &[(Method::GET, VIEW)]),
    ("/api/v1/objects", &[(Method::GET, VIEW)]),
    ("/api/v1/print-sizes", &[(Method::GET, VIEW)]),
    ("/api/v1/objects/{id}", &[(Method::GET, VIEW)]),
    ("/api/v1/objects/{id}/name", &[(Method::PUT, SETUP)]),
    ("/api/v1/observations", &[(Method::GET, VIEW)]),
    ("/api/v1/events", &[(Method::GET, VIEW)]),
    ("/api/v1/history", &[(Method::GET, VIEW)]),
    ("/api/v1/history.csv", &[(Method::GET, VIEW)]),
    ("/api/v1/history.parquet", &[(Method::GET, VIEW)]),
    ("/api/v1/cameras", &[(Method::GET, VIEW), (Method::POST, SETUP)]),
    (
        "/api/v1/cameras/{name}",
        &[(Method::GET, VIEW), (Method::PATCH, SETUP), (Method::DELETE, SETUP)],
    ),
    ("/api/v1/cameras/{name}/frame.jpg", &[(Method::GET, VIEW)]),
    ("/api/v1/cameras/{name}/setup", &[(Method::GET, SETUP)]),
    ("/api/v1/sources/test", &[(Method::POST, SETUP)]),
    (
        "/api/v1/calibration",
        &[(Method::GET, VIEW), (Method::POST, OPERATE), (Method::DELETE, OPERATE)],
    ),
    ("/api/v1/calibration/applied", &[(Method::PUT, OPERATE)]),
    ("/api/v1/lens", &[(Method::GET, VIEW), (Method::POST, SETUP), (Method::DELETE, SETUP)]),
    ("/api/v1/lens/finished", &[(Method::PUT, SETUP)]),
    ("/api/v1/lens/picture.jpg", &[(Method::GET, VIEW)]),
    ("/api/v1/lens/file", &[(Method::GET, VIEW)]),
    ("/api/v1/lens/applied", &[(Method::PUT, SETUP)]),
    ("/api/v1/plan", &[(Method::GET, VIEW)]),
    ("/api/v1/print", &[(Method::GET, VIEW)]),
    ("/api/v1/codes", &[(Method::GET, VIEW)]),
    (
        "/api/v1/recording",
        &[(Method::GET, VIEW), (Method::POST, OPERATE), (Method::DELETE, OPERATE)],
    ),
    ("/api/v1/recordings", &[(Method::GET, VIEW)]),
    ("/api/v1/replay", &[(Method::GET, VIEW), (Method::PATCH, OPERATE)]),
    ("/api/v1/simulation/drive", &[(Method::POST, OPERATE)]),
    ("/api/v1/simulation/push", &[(Method::POST, OPERATE)]),
    ("/api/v1/configuration", &[(Method::GET, SETUP), (Method::PUT, SETUP)]),
    ("/api/v1/configuration.toml", &[(Method::GET, SETUP)]),
    ("/api/v1/configuration/check", &[(Method::POST, SETUP)]),
    ("/api/v1/configuration/objects", &[(Method::POST, SETUP)]),
    (
        "/api/v1/configuration/objects/{name}",
        &[(Method::GET, SETUP), (Method::PATCH, SETUP), (Method::DELETE, SETUP)],
    ),
];

/// gRPC services and their methods; `*` is every method of a service.
const METHODS: &[(&str, &str, Need)] = &[
    ("grpc.health.v1.Health", "*", Need::Nothing),
    ("grpc.reflection.v1.ServerReflection", "*", VIEW),
    ("roundel.v1.Push", "Send", FEED),
    ("roundel.v1.Roundel", "GetServerInfo", Need::SignedIn),
    ("roundel.v1.Roundel", "GetTime", Need::SignedIn),
    ("roundel.v1.Roundel", "GetSnapshot", VIEW),
    ("roundel.v1.Roundel", "SubscribeSnapshots", VIEW),
    ("roundel.v1.Roundel", "ListObjects", VIEW),
    ("roundel.v1.Roundel", "ListPrintSizes", VIEW),
    ("roundel.v1.Roundel", "GetObservations", VIEW),
    ("roundel.v1.Roundel", "SubscribeObservations", VIEW),
    ("roundel.v1.Roundel", "SubscribeEvents", VIEW),
    ("roundel.v1.Roundel", "QueryHistory", VIEW),
    ("roundel.v1.Roundel", "ListCameras", VIEW),
    ("roundel.v1.Roundel", "GetPicture", VIEW),
    ("roundel.v1.Roundel", "GetCalibration", VIEW),
    ("roundel.v1.Roundel", "WatchCalibration", VIEW),
    ("roundel.v1.Roundel", "GetRecording", VIEW),
    ("roundel.v1.Roundel", "ListRecordings", VIEW),
    ("roundel.v1.Roundel", "GetReplay", VIEW),
    ("roundel.v1.Roundel", "StartCalibration", OPERATE),
    ("roundel.v1.Roundel", "CancelCalibration", OPERATE),
    ("roundel.v1.Roundel", "ApplyCalibration", OPERATE),
    ("roundel.v1.Roundel", "StartRecording", OPERATE),
    ("roundel.v1.Roundel", "StopRecording", OPERATE),
    ("roundel.v1.Roundel", "ControlReplay", OPERATE),
    ("roundel.v1.Roundel", "DriveRobots", OPERATE),
    ("roundel.v1.Roundel", "PushRobot", OPERATE),
    ("roundel.v1.Roundel", "TestSource", SETUP),
    ("roundel.v1.Roundel", "GetCameraSetup", SETUP),
    ("roundel.v1.Roundel", "AddCamera", SETUP),
    ("roundel.v1.Roundel", "ChangeCamera", SETUP),
    ("roundel.v1.Roundel", "RemoveCamera", SETUP),
    ("roundel.v1.Roundel", "GetObjectSetup", SETUP),
    ("roundel.v1.Roundel", "AddObject", SETUP),
    ("roundel.v1.Roundel", "ChangeObject", SETUP),
    ("roundel.v1.Roundel", "RemoveObject", SETUP),
    ("roundel.v1.Roundel", "NameObject", SETUP),
    ("roundel.v1.Roundel", "GetConfiguration", SETUP),
    ("roundel.v1.Roundel", "CheckConfiguration", SETUP),
    ("roundel.v1.Roundel", "ApplyConfiguration", SETUP),
];

/// What a request needs, by method and path.
pub fn need(method: &Method, path: &str) -> Need {
    listed(method, path).unwrap_or(match is_interface(path) {
        true => SETUP,
        false => Need::Nothing,
    })
}

/// Whether a path is one of the APIs, and not the dashboard's.
fn is_interface(path: &str) -> bool {
    path.starts_with("/api/v")
        || service_and_method(path).is_some_and(|(name, _)| name.contains('.'))
}

fn listed(method: &Method, path: &str) -> Option<Need> {
    static ROUTER: LazyLock<Router<&'static [(Method, Need)]>> = LazyLock::new(|| {
        let mut router = Router::new();
        for (path, methods) in ROUTES {
            router.insert(*path, *methods).expect("the paths are valid and differ");
        }
        router
    });
    if let Ok(route) = ROUTER.at(path) {
        let method = answered_method(method);
        return route.value.iter().find(|(listed, _)| listed == method).map(|(_, need)| *need);
    }
    let (service, method) = service_and_method(path)?;
    let is_listed = |(listed, name, _): &&(&str, &str, Need)| {
        *listed == service && (*name == method || *name == "*")
    };
    METHODS.iter().find(is_listed).map(|(_, _, need)| *need)
}

fn service_and_method(path: &str) -> Option<(&str, &str)> {
    path.strip_prefix('/')?.split_once('/')
}

#[cfg(test)]
mod tests {
    use prost::Message;
    use prost_types::FileDescriptorSet;
    use utoipa::openapi::path::Operation;

    use super::*;
    use crate::api::openapi;

    #[test]
    fn every_described_route_is_listed_and_no_other() {
        let document = openapi::described_routes().into_openapi();
        let mut described = 0;
        for (path, item) in &document.paths.paths {
            let operations: [(Method, &Option<Operation>); 5] = [
                (Method::GET, &item.get),
                (Method::POST, &item.post),
                (Method::PUT, &item.put),
                (Method::PATCH, &item.patch),
                (Method::DELETE, &item.delete),
            ];
            let filled = path.replace("{id}", "7").replace("{name}", "north");
            for (method, _) in operations.iter().filter(|(_, operation)| operation.is_some()) {
                assert!(listed(method, &filled).is_some(), "{method} {path} has no role");
                described += 1;
            }
        }
        assert_eq!(described, ROUTES.iter().map(|(_, methods)| methods.len()).sum::<usize>());
    }

    #[test]
    fn every_grpc_method_is_listed_and_no_other() {
        let files = FileDescriptorSet::decode(roundel_proto::DESCRIPTORS).unwrap().file;
        let mut described = 0;
        for file in &files {
            for service in &file.service {
                for method in &service.method {
                    let path = format!("/{}.{}/{}", file.package(), service.name(), method.name());
                    assert!(listed(&Method::POST, &path).is_some(), "{path} has no role");
                    described += 1;
                }
            }
        }
        let own = METHODS.iter().filter(|(service, ..)| service.starts_with("roundel."));
        assert_eq!(described, own.count());
    }

    #[test]
    fn what_is_not_listed_needs_setup_unless_it_is_a_file_of_the_dashboard() {
        for path in [
            "/api/v1/new",
            "/api/v2/snapshot",
            "/roundel.v1.Roundel/New",
            "/other.v1.Service/Method",
        ] {
            assert_eq!(need(&Method::GET, path), SETUP, "{path}");
        }
        assert_eq!(need(&Method::PUT, "/api/v1/cameras"), SETUP);
        for path in ["/", "/index.html", "/api", "/js/main.js", "/vendor/uplot.js"] {
            assert_eq!(need(&Method::GET, path), Need::Nothing, "{path}");
        }
        assert_eq!(need(&Method::HEAD, "/api/v1/cameras"), VIEW);
    }
}
