//! Evidence about clocks from several cameras' views of one object. The equations are on the page of `comparison`.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use roundel_vision::id::CameraId;

/// One camera's view at the middle of the window.
#[derive(Clone, Copy, Debug)]
pub(super) struct FittedView {
    pub(super) camera: CameraId,
    pub(super) position_m: Vector3<f64>,
    pub(super) covariance: Matrix3<f64>,
}

/// Several cameras' views of one object.
#[derive(Clone, Debug)]
pub(crate) struct Comparison {
    pub(super) velocity_m_s: Vector3<f64>,
    pub(super) views: Vec<FittedView>,
}

/// Evidence of a comparison about its cameras' clocks.
#[derive(Clone, Debug)]
pub(crate) struct Evidence {
    /// Information about the ε, 1/s².
    pub(crate) information: DMatrix<f64>,
    /// Information times ε, 1/s.
    pub(crate) score: DVector<f64>,
    /// Squared Mahalanobis length of the views' differences over their number.
    pub(crate) distance_squared: f64,
}

impl Comparison {
    /// Cameras of the views.
    pub(crate) fn cameras(&self) -> impl Iterator<Item = CameraId> {
        self.views.iter().map(|view| view.camera)
    }

    /// `None` if a covariance is not positive definite.
    pub(crate) fn evidence(&self) -> Option<Evidence> {
        let inverses: Option<Vec<Matrix3<f64>>> =
            self.views.iter().map(|view| Some(view.covariance.cholesky()?.inverse())).collect();
        let inverses = inverses?;
        let all = inverses.iter().sum::<Matrix3<f64>>().cholesky()?;
        let mut pulled = Vector3::zeros();
        for (view, inverse) in self.views.iter().zip(&inverses) {
            pulled += inverse * view.position_m;
        }
        let place_m = all.solve(&pulled);
        let weighted: Vec<Vector3<f64>> =
            inverses.iter().map(|inverse| inverse * self.velocity_m_s).collect();
        let count = self.views.len();
        let mut information = DMatrix::zeros(count, count);
        let mut score = DVector::zeros(count);
        let mut distance_squared = 0.0;
        for one in 0..count {
            let apart_m = self.views[one].position_m - place_m;
            score[one] = -weighted[one].dot(&apart_m);
            distance_squared += apart_m.dot(&(inverses[one] * apart_m));
            let spread = all.solve(&weighted[one]);
            for other in 0..count {
                information[(one, other)] = -weighted[other].dot(&spread);
            }
            information[(one, one)] += weighted[one].dot(&self.velocity_m_s);
        }
        Some(Evidence { information, score, distance_squared: distance_squared / count as f64 })
    }
}
