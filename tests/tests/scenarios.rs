//! Short versions of the scenarios of `roundel_tests::scenario`, without speeds: `cargo run --release -p
//! roundel-tests -- scenarios` measures those.

use roundel_tests::{
    scenario::{BAND, Length, Row, Run, crossing, fault, moving, plane, swarm},
    score::Score,
};

/// Runs a scenario of one row. All identities must be right, no covariance too small, and that of positions not too
/// large.
fn sound(run: Run, objects: usize) -> Row {
    let row = safe(run, objects);
    let shares = row.shares().unwrap();
    assert!(BAND.contains(&shares[0]), "{}: {shares:?}", row.scenario);
    row
}

/// The same without a limit on large covariances.
fn safe(run: Run, objects: usize) -> Row {
    let mut rows = run(Length::Short);
    assert_eq!(rows.len(), 1);
    let row = rows.remove(0);
    println!("{}: {:?}, inside {:.3?}", row.scenario, row.parts, row.shares());
    let Score { ids, swaps, strays, misses, wrong_codes, unusable, .. } =
        row.score.clone().unwrap();
    assert_eq!((ids, swaps, strays, misses), (objects, 0, 0, 0), "{}", row.scenario);
    assert_eq!((wrong_codes, unusable), (0, 0), "{}", row.scenario);
    let shares = row.shares().unwrap();
    assert!(shares.iter().all(|share| *share >= *BAND.start()), "{}: {shares:?}", row.scenario);
    row
}

#[test]
fn sixty_four_objects_keep_their_ids() {
    sound(swarm::alone, 64);
}

#[test]
fn sixty_four_objects_keep_their_ids_when_frames_are_late() {
    sound(swarm::late, 64);
}

#[test]
fn coded_robots_keep_their_ids_and_codes() {
    sound(swarm::r4, 24);
    // Scored from half a second to a second, while the filter still allows for all motions that robots are capable
    // of.
    safe(swarm::r16, 200);
}

#[test]
fn plain_roundels_that_pass_each_other_are_not_swapped() {
    assert!(sound(crossing::crossing, 20).holds());
}

#[test]
fn faulty_streams_do_no_harm_and_are_counted() {
    let counted: [Run; 9] = [
        fault::twice,
        fault::overdue,
        fault::reordered,
        fault::missing,
        fault::stopped,
        fault::hour_ahead,
        fault::hour_behind,
        fault::hour_for_good,
        fault::everything,
    ];
    for run in counted {
        let row = sound(run, 24);
        assert!(row.holds(), "{:?}", row.parts);
    }
}

#[test]
fn robots_on_a_floor_are_located_as_well_as_by_a_homography() {
    for row in plane::plane(Length::Short) {
        println!("{}: {:?}", row.scenario, row.parts);
        assert!(row.holds(), "{}: {:?}", row.scenario, row.parts);
    }
}

#[test]
fn moving_cameras_localize_themselves() {
    for row in moving::drone(Length::Short).into_iter().chain(moving::docking(Length::Short)) {
        println!("{}: {:?}, inside {:.3?}", row.scenario, row.parts, row.shares());
        assert!(row.holds(), "{}: {:?}", row.scenario, row.parts);
        // Systematic errors leave few independent samples in such a short time.
        let shares = row.shares().unwrap();
        assert!(shares[0] >= 0.85 && shares[2] >= 0.92, "{}: {shares:?}", row.scenario);
    }
}
