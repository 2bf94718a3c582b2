use super::*;

const BEGIN: i64 = 1_700_000_000_000_000_000;
const DAY_S: i64 = 86_400;

fn at(seconds: i64) -> Timestamp {
    Timestamp::from_ns(BEGIN + seconds * 1_000_000_000)
}

/// Objects at (id, 0, 0) for some seconds, in the tiers from `finest` on.
fn store(folder: &Path, objects: u64, seconds: i64, finest: usize) -> Store {
    let mut store = Store::open(&folder.join("h.sqlite")).unwrap();
    for id in 1..=objects {
        let name = format!("robot {id}");
        let identity = HistoryObject { run: "r".into(), id, name, kind: "k".into(), code: 0 };
        let key = store.key(&identity, at(0)).unwrap();
        for (tier, grade) in TIERS.iter().enumerate().skip(finest) {
            let steps = seconds * 1_000_000_000 / grade.step_ns;
            let point = |step: i64| HistoryPoint {
                time: Timestamp::from_ns(BEGIN + step * grade.step_ns),
                position_m: [id as f64, 0.0, 0.0],
                yaw_rad: (id == 1).then_some(0.5),
            };
            let points: Vec<_> = (0..steps).map(|step| (tier, key, point(step))).collect();
            store.add(&points).unwrap();
        }
    }
    store
}

fn all(from: i64, until: i64) -> HistoryQuery {
    HistoryQuery {
        objects: Vec::new(),
        region_m: None,
        from: at(from),
        until: at(until),
        max_points: MAX_POINTS,
        step_s: None,
    }
}

fn count(answer: &HistoryResult) -> usize {
    answer.objects.iter().map(|(_, points)| points.len()).sum()
}

#[test]
fn queries_return_almost_the_maximum_number_of_points() {
    let folder = tempfile::tempdir().unwrap();
    let store = store(folder.path(), 10, DAY_S, 1);
    for (from, until, most) in [(0, DAY_S, 5000), (0, 3600, 5000), (100, 200, 500), (0, DAY_S, 50)]
    {
        let answer = store.query(&HistoryQuery { max_points: most, ..all(from, until) }).unwrap();
        let found = count(&answer);
        assert!(found <= most && found * 12 >= most, "{found} of {most}, {} s", answer.step_s);
        let (_, points) = &answer.objects[3];
        let step_s = points[1].time.seconds_since(points[0].time);
        assert!((step_s - answer.step_s).abs() < 1e-9, "{step_s} {}", answer.step_s);
    }
    assert_eq!(store.query(&all(0, 1)).unwrap().kept.unwrap().0, at(0));
}

#[test]
fn objects_and_regions_are_selected() {
    let folder = tempfile::tempdir().unwrap();
    let store = store(folder.path(), 5, 1000, 1);
    let ids = |query: &HistoryQuery| {
        let answer = store.query(query).unwrap();
        answer.objects.iter().map(|(identity, _)| identity.id).collect::<Vec<_>>()
    };
    let objects = ["robot 2", "4"].map(str::to_owned).to_vec();
    assert_eq!(ids(&HistoryQuery { objects, ..all(0, 1000) }), [2, 4]);
    let region_m = Some([[2.5, -1.0, -1.0], [4.5, 1.0, 1.0]]);
    assert_eq!(ids(&HistoryQuery { region_m, ..all(0, 1000) }), [3, 4]);
    assert_eq!(ids(&all(2000, 3000)), Vec::<u64>::new());
    let export = HistoryQuery { step_s: Some(1.0), max_points: 10_000, ..all(0, 1000) };
    assert_eq!(count(&store.query(&export).unwrap()), 5 * 1000);
    let error = store.query(&HistoryQuery { max_points: 100, ..export }).unwrap_err().to_string();
    assert!(error.contains("at most 100 points"), "{error}");
    assert_eq!(store.query(&all(0, 1000)).unwrap().objects[0].1[0].yaw_rad, Some(0.5));
}

#[test]
fn finer_tiers_expire_before_coarser_ones() {
    let folder = tempfile::tempdir().unwrap();
    let store = store(folder.path(), 2, 2000, 1);
    // The tier of 1 s keeps the last 700 s, coarser tiers keep everything.
    while store.expire(at(2000), Duration::from_secs(100)).unwrap() {}
    let finest = |from, until| {
        let query = HistoryQuery { step_s: Some(1.0), max_points: 100_000, ..all(from, until) };
        count(&store.query(&query).unwrap())
    };
    assert_eq!((finest(0, 1299), finest(1300, 2000)), (0, 2 * 700));
    // Without a step, a query falls back to a tier that still has the points.
    let old = store.query(&all(0, 1000)).unwrap();
    assert!(count(&old) == 2 * 101 && (old.step_s - 10.0).abs() < 1e-9, "{}", old.step_s);
    let coarse = HistoryQuery { step_s: Some(10.0), ..all(0, 2000) };
    assert_eq!(count(&store.query(&coarse).unwrap()), 2 * 200);
    while store.expire(at(10_000_000), Duration::from_secs(100)).unwrap() {}
    assert_eq!(store.query(&all(0, 2000)).unwrap().kept, None);
}

#[test]
fn foreign_and_newer_files_are_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.sqlite");
    std::fs::write(&path, "name = \"lab\"\n".repeat(100)).unwrap();
    let error = Store::open(&path).err().unwrap().to_string();
    assert!(error.contains("x.sqlite") && error.contains("`file` in [history]"), "{error}");
    let path = folder.path().join("newer.sqlite");
    let store = Store::open(&path).unwrap();
    store.connection.pragma_update(None, "user_version", FORMAT_VERSION + 1).unwrap();
    let error = Store::open(&path).err().unwrap().to_string();
    assert!(error.contains("was written by a newer Roundel"), "{error}");
}
