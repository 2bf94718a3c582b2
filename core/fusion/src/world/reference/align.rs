//! Camera pose by weighted least squares from detections of references.
//!
//! The start is the closed form for isotropic covariances (Kabsch 1976, Umeyama 1991: singular value decomposition of
//! the weighted cross covariance).

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, SymmetricEigen, UnitQuaternion, Vector3};

use super::{PLACE_SIGMA_M, Placement, ReferenceError, Sighting};
use roundel_vision::rigid::{Covariance6, Rigid};

/// Smallest extent of points across a line, relative to that along it.
const COLLINEAR: f64 = 0.02;
/// Number of Gauss-Newton steps; the start is the solution for isotropic covariances.
const STEPS: usize = 5;

/// `world_from_camera` by weighted least squares over three or more pairs that are not on one line.
///
/// Starts from the closed form for isotropic covariances ([`kabsch`]), then weights each pair by its whole
/// covariance, in which depth is less certain than bearing, and that of the stated position ([`PLACE_SIGMA_M`]).
pub fn align(
    world_m: &[Vector3<f64>],
    sightings: &[Sighting],
) -> Result<Placement, ReferenceError> {
    let stated: Vec<_> = world_m.iter().map(|place_m| (*place_m, PLACE_SIGMA_M)).collect();
    align_stated(&stated, sightings)
}

/// The same with a standard deviation of each stated position's coordinates, metres.
pub fn align_stated(
    stated: &[(Vector3<f64>, f64)],
    sightings: &[Sighting],
) -> Result<Placement, ReferenceError> {
    let world_m: Vec<Vector3<f64>> = stated.iter().map(|(place_m, _)| *place_m).collect();
    check(&world_m, sightings)?;
    let variances: Vec<f64> = stated.iter().map(|(_, deviation_m)| deviation_m.powi(2)).collect();
    let weights: Vec<f64> = std::iter::zip(sightings, &variances)
        .map(|(sighting, variance)| 1.0 / (sighting.covariance.trace() + variance))
        .collect();
    let pairs: Vec<[Vector3<f64>; 2]> = std::iter::zip(&world_m, sightings)
        .map(|(world, sighting)| [*world, sighting.position_m])
        .collect();
    let (mut rotation, mut origin_m, scale) = kabsch(&pairs, &weights);
    let mut covariance = Covariance6::identity();
    for _ in 0..STEPS {
        let mut information = Covariance6::zeros();
        let mut gradient = SVector::<f64, 6>::zeros();
        for (index, (world, sighting)) in world_m.iter().zip(sightings).enumerate() {
            let turned = rotation * sighting.position_m;
            let turn = rotation.matrix();
            let error = turn * sighting.covariance * turn.transpose()
                + Matrix3::from_diagonal_element(variances[index]);
            let weight = error.cholesky().ok_or(ReferenceError::NotFinite { index })?.inverse();
            let mut jacobian = SMatrix::<f64, 3, 6>::zeros();
            jacobian.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
            jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-turned.cross_matrix());
            let weighted = jacobian.transpose() * weight;
            information += weighted * jacobian;
            gradient += weighted * (world - turned - origin_m);
        }
        // The points are not on one line, so only rounding can make this singular.
        let factor = information.cholesky().ok_or(ReferenceError::Collinear { spread_m: 0.0 })?;
        let change = factor.solve(&gradient);
        origin_m += change.fixed_rows::<3>(0);
        rotation = Rotation3::new(change.fixed_rows::<3>(3).into_owned()) * rotation;
        covariance = factor.inverse();
    }
    Ok(placement(&world_m, sightings, rotation, origin_m, scale, covariance))
}

/// Rotation, origin and scale that minimize Σ w |to - R from - t|² over pairs `[to, from]`.
pub fn kabsch(pairs: &[[Vector3<f64>; 2]], weights: &[f64]) -> (Rotation3<f64>, Vector3<f64>, f64) {
    let middle = |which: usize| middle(pairs.iter().map(|pair| pair[which]), weights);
    let (to_middle, from_middle) = (middle(0), middle(1));
    let mut cross = Matrix3::zeros();
    for ([to, from], weight) in std::iter::zip(pairs, weights) {
        cross += (to - to_middle) * (from - from_middle).transpose() * *weight;
    }
    let rotation = nearest_rotation(&cross);
    let (mut together, mut alone) = (0.0, 0.0);
    for ([to, from], weight) in std::iter::zip(pairs, weights) {
        let ray = from - from_middle;
        together += weight * (to - to_middle).dot(&(rotation * ray));
        alone += weight * ray.norm_squared();
    }
    (rotation, to_middle - rotation * from_middle, together / alone)
}

/// Proper rotation R that maximizes tr(Rᵀ M).
fn nearest_rotation(matrix: &Matrix3<f64>) -> Rotation3<f64> {
    let decomposed = matrix.svd(true, true);
    let (Some(u), Some(v_t)) = (decomposed.u, decomposed.v_t) else {
        return Rotation3::identity();
    };
    let mut signs = Vector3::repeat(1.0);
    if (u * v_t).determinant() < 0.0 {
        // A reflection: flip the axis with the smallest singular value.
        signs[decomposed.singular_values.imin()] = -1.0;
    }
    Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&signs) * v_t)
}

/// Weighted root mean square extent of points along their longest direction and along the next.
pub fn spread(points: &[Vector3<f64>], weights: &[f64]) -> [f64; 2] {
    let middle = middle(points.iter().copied(), weights);
    let scatter: Matrix3<f64> = std::iter::zip(points, weights)
        .map(|(point, weight)| (point - middle) * (point - middle).transpose() * *weight)
        .sum::<Matrix3<f64>>()
        / weights.iter().sum::<f64>();
    let mut values: [f64; 3] = SymmetricEigen::new(scatter).eigenvalues.into();
    values.sort_by(f64::total_cmp);
    [values[2], values[1]].map(|value| value.max(0.0).sqrt())
}

fn middle(points: impl Iterator<Item = Vector3<f64>>, weights: &[f64]) -> Vector3<f64> {
    let total: f64 = weights.iter().sum();
    points.zip(weights).map(|(point, weight)| point * (weight / total)).sum()
}

/// The paper's section 4.4.1 as a rigid motion: for each triplet of pairs not on one line, the motion from the
/// triplet's frame in the camera to that in the world; the result is the mean over triplets.
///
/// A triplet's frame is orthonormal: origin at its first point, x towards the second, z normal to all three. The
/// mean rotation is the chordal one. The covariance is that of [`align`].
pub fn mean_over_triplets(
    world_m: &[Vector3<f64>],
    sightings: &[Sighting],
) -> Result<Placement, ReferenceError> {
    let aligned = align(world_m, sightings)?;
    let mut rotations = Matrix3::zeros();
    let mut origin_m = Vector3::zeros();
    let mut triplets = 0.0;
    let n = world_m.len();
    for (i, j, k) in
        (0..n).flat_map(|i| (i + 1..n).flat_map(move |j| (j + 1..n).map(move |k| (i, j, k))))
    {
        let camera = [i, j, k].map(|index| sightings[index].position_m);
        let (Some(world_axes), Some(camera_axes)) =
            (triplet_axes(&[world_m[i], world_m[j], world_m[k]]), triplet_axes(&camera))
        else {
            continue;
        };
        let rotation = world_axes * camera_axes.transpose();
        rotations += rotation;
        origin_m += world_m[i] - rotation * camera[0];
        triplets += 1.0;
    }
    if triplets == 0.0 {
        return Err(ReferenceError::Collinear { spread_m: 0.0 });
    }
    let rotation = nearest_rotation(&rotations);
    let Placement { covariance, scale, .. } = aligned;
    Ok(placement(world_m, sightings, rotation, origin_m / triplets, scale, covariance))
}

/// Orthonormal axes of three points as columns; `None` if they are on one line.
fn triplet_axes(points: &[Vector3<f64>; 3]) -> Option<Matrix3<f64>> {
    let (first, second) = (points[1] - points[0], points[2] - points[0]);
    let across = first.cross(&second);
    if across.norm() < COLLINEAR * first.norm_squared().max(second.norm_squared()) {
        return None;
    }
    let (x, z) = (first.normalize(), across.normalize());
    Some(Matrix3::from_columns(&[x, z.cross(&x), z]))
}

fn check(world_m: &[Vector3<f64>], sightings: &[Sighting]) -> Result<(), ReferenceError> {
    if world_m.len() != sightings.len() {
        return Err(ReferenceError::Unpaired {
            references: world_m.len(),
            sightings: sightings.len(),
        });
    }
    if world_m.len() < 3 {
        return Err(ReferenceError::TooFew { found: world_m.len() });
    }
    for (index, (world, sighting)) in world_m.iter().zip(sightings).enumerate() {
        let finite = world.iter().chain(&sighting.position_m).all(|value| value.is_finite());
        if !finite || sighting.covariance.cholesky().is_none() {
            return Err(ReferenceError::NotFinite { index });
        }
    }
    for points in [world_m.to_vec(), sightings.iter().map(|s| s.position_m).collect()] {
        let [along_m, across_m] = spread(&points, &vec![1.0; points.len()]);
        if across_m <= COLLINEAR * along_m {
            return Err(ReferenceError::Collinear { spread_m: across_m });
        }
    }
    Ok(())
}

fn placement(
    world_m: &[Vector3<f64>],
    sightings: &[Sighting],
    rotation: Rotation3<f64>,
    origin_m: Vector3<f64>,
    scale: f64,
    covariance: Covariance6,
) -> Placement {
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    let residuals_m: Vec<f64> = world_m
        .iter()
        .zip(sightings)
        .map(|(world, sighting)| (world - rotation * sighting.position_m - origin_m).norm())
        .collect();
    let squares: f64 = residuals_m.iter().map(|r| r * r).sum();
    Placement {
        world_from_camera: Rigid::from_parts(origin_m.into(), rotation),
        covariance: 0.5 * (covariance + covariance.transpose()),
        rms_m: (squares / residuals_m.len() as f64).sqrt(),
        residuals_m,
        scale,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn layout() -> Vec<Vector3<f64>> {
        [[0.0, 0.0, 0.0], [2.0, 0.0, 0.1], [0.0, 1.5, 0.0], [2.0, 1.7, 0.0]]
            .map(Vector3::from)
            .to_vec()
    }

    fn observe(world_from_camera: &Rigid, world_m: &[Vector3<f64>]) -> Vec<Sighting> {
        world_m
            .iter()
            .map(|point| Sighting {
                position_m: world_from_camera.inverse() * nalgebra::Point3::from(*point)
                    - nalgebra::Point3::origin(),
                covariance: Matrix3::from_diagonal(&Vector3::new(1e-6, 1e-6, 1e-4)),
            })
            .collect()
    }

    proptest! {
        #[test]
        fn exact_pairs_give_the_exact_pose(
            x in -3.0..3.0f64, y in -3.0..3.0f64, z in 1.0..6.0f64,
            a in -3.0..3.0f64, b in -3.0..3.0f64, c in -3.0..3.0f64,
        ) {
            let truth = Rigid::new(Vector3::new(x, y, z), Vector3::new(a, b, c));
            for place in [align, mean_over_triplets] {
                let found = place(&layout(), &observe(&truth, &layout())).unwrap();
                let off = found.world_from_camera.inverse() * truth;
                prop_assert!(off.translation.vector.norm() < 1e-9);
                prop_assert!(off.rotation.angle() < 1e-9);
                prop_assert!(found.rms_m < 1e-9 && (found.scale - 1.0).abs() < 1e-9);
                prop_assert!(found.covariance.cholesky().is_some());
            }
        }
    }

    #[test]
    fn the_covariance_matches_the_errors() {
        use rand::SeedableRng;
        use rand_distr::{Distribution, StandardNormal};
        let truth = Rigid::new(Vector3::new(0.4, -0.7, 4.0), Vector3::new(3.0, 0.2, 0.1));
        let exact = observe(&truth, &layout());
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let mut draw = || -> f64 { StandardNormal.sample(&mut random) };
        let mut squares = 0.0;
        let runs = 2000;
        for _ in 0..runs {
            let world_m: Vec<_> = layout()
                .iter()
                .map(|p| p + Vector3::from_fn(|_, _| PLACE_SIGMA_M * draw()))
                .collect();
            let noisy: Vec<_> = exact
                .iter()
                .map(|s| Sighting {
                    position_m: s.position_m
                        + Vector3::new(1e-3 * draw(), 1e-3 * draw(), 1e-2 * draw()),
                    ..*s
                })
                .collect();
            let found = align(&world_m, &noisy).unwrap();
            let off = found.world_from_camera.translation.vector - truth.translation.vector;
            let turn = (truth.rotation * found.world_from_camera.rotation.inverse()).scaled_axis();
            let error = SVector::<f64, 6>::new(-off.x, -off.y, -off.z, turn.x, turn.y, turn.z);
            squares +=
                roundel_vision::rigid::mahalanobis_squared(&error, &found.covariance).unwrap();
        }
        let mean = squares / runs as f64;
        assert!((mean - 6.0).abs() < 0.3, "{mean}");
    }

    #[test]
    fn a_wrong_scale_is_reported_and_not_applied() {
        let truth = Rigid::new(Vector3::new(0.4, -0.7, 4.0), Vector3::new(3.0, 0.2, 0.1));
        let mut sightings = observe(&truth, &layout());
        for sighting in &mut sightings {
            sighting.position_m /= 1.03;
        }
        let found = align(&layout(), &sightings).unwrap();
        assert!((found.scale - 1.03).abs() < 1e-3, "{}", found.scale);
        assert!(found.rms_m > 0.01);
    }

    #[test]
    fn degenerate_layouts_are_rejected() {
        let truth = Rigid::new(Vector3::new(0.4, -0.7, 4.0), Vector3::new(3.0, 0.2, 0.1));
        let line: Vec<_> = (0..4).map(|k| Vector3::new(k as f64, 0.5 * k as f64, 0.001)).collect();
        assert!(matches!(
            align(&line, &observe(&truth, &line)),
            Err(ReferenceError::Collinear { .. })
        ));
        let two = &layout()[..2];
        assert_eq!(align(two, &observe(&truth, two)), Err(ReferenceError::TooFew { found: 2 }));
        let mut broken = observe(&truth, &layout());
        broken[2].position_m.x = f64::NAN;
        assert_eq!(align(&layout(), &broken), Err(ReferenceError::NotFinite { index: 2 }));
        assert_eq!(
            align(&layout(), &broken[..3]).unwrap_err().to_string(),
            "expected as many sightings as references, 4, found 3"
        );
    }
}
