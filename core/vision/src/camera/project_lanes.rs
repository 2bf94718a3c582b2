//! Projection of one ray per lane, identical to the last bit to [`Camera::project`].

use super::Camera;
use crate::simd::{Lane, Vec2, Vec3};

impl Camera {
    /// The pixels of rays, and the lanes that have one; `None` for lenses whose rays are not points
    /// of a plane.
    #[inline(always)]
    pub(crate) fn project_each<T: Lane>(&self, ray: Vec3<T>) -> Option<(Vec2<T>, T::Mask)> {
        let planar = self.intrinsics.lens.planar()?;
        let per_z = ray.z.under(1.0);
        let point = Vec2::new(ray.x * per_z, ray.y * per_z);
        let (image, slope, is_known) = planar.distort(point);
        let area = slope.m11 * slope.m22 - slope.m21 * slope.m12;
        let within = point.square().at_most(point.x.splat(self.reach * self.reach));
        let visible = is_known & area.is_positive() & within & ray.z.is_positive();
        let of = &self.intrinsics;
        let pixel = Vec2::new(image.x * of.fx_px + of.cx_px, image.y * of.fy_px + of.cy_px);
        Some((pixel, visible))
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, Simd, SimdFrom, dispatch, f64x8};
    use fearless_simd_macros::simd;
    use nalgebra::Vector3;

    use super::*;
    use crate::{
        camera::{Intrinsics, Lens},
        simd::Mask,
    };

    #[simd]
    fn side_by_side<S: Simd>(
        simd: S,
        camera: &Camera,
        rays: &[Vector3<f64>; 8],
    ) -> Option<[Option<[f64; 2]>; 8]> {
        let of = |k: usize| [rays[k].x, rays[k].y, rays[k].z];
        let [x, y, z] = f64x8::simd_from(simd, 0.0).each(of);
        let (pixel, visible) = camera.project_each(Vec3::new(x, y, z))?;
        Some(std::array::from_fn(|k| visible.is_set(k).then(|| [pixel.x.lane(k), pixel.y.lane(k)])))
    }

    #[test]
    fn lanes_equal_single_projections() {
        let rays: [Vector3<f64>; 8] = std::array::from_fn(|k| {
            let (sin, cos) = (0.8 * k as f64).sin_cos();
            Vector3::new(
                0.3 * k as f64 * cos,
                0.3 * k as f64 * sin,
                if k == 6 { -1.0 } else { 1.1 },
            )
        });
        for lens in [
            Lens::PlumbBob([-0.28, 0.09, 0.0012, -0.0008, -0.012]),
            Lens::Rational([8.1, 5.2, 0.0004, -0.0002, 0.21, 8.4, 8.0, 1.3]),
        ] {
            let camera = Camera::new(Intrinsics {
                width: 1400,
                height: 1000,
                fx_px: 700.0,
                fy_px: 710.0,
                cx_px: 699.5,
                cy_px: 499.5,
                lens,
            })
            .unwrap();
            let alone = rays.map(|ray| camera.project(&ray).ok().map(|pixel| [pixel.u, pixel.v]));
            assert!(alone.iter().flatten().count() >= 3 && alone.iter().any(Option::is_none));
            for level in [Level::new(), Level::baseline()] {
                let found = dispatch!(level, simd => side_by_side(simd, &camera, &rays));
                assert_eq!(found, Some(alone), "{level:?}");
            }
        }
    }
}
