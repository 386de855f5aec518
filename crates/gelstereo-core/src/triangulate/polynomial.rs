//! The fast rung: polynomials in column, row and inverse disparity, fitted to the exact rung.

use super::chebyshev::checks;
use super::point::{StereoPoint, sum_of_squares};
use super::root::Root;
use super::tiles::{Four, Tiles, multiply_add};
use crate::math::linalg::Symmetric;
use crate::math::{DVec2, DVec3, sqrt};
use crate::rig::RigView;

/// Points along each input at which the map is compared with exact rays.
pub(super) const CHECKS: usize = 7;
/// Largest error of the covariance, relative to the variances: the centres' covariances are known no
/// better.
const COVARIANCE_TOLERANCE: f64 = 0.02;

/// A map from (column in the left view, mean row, disparity) of the raw pixels to the point and the
/// expected row difference. It includes distortion, rectification and refraction.
///
/// Depth is proportional to the inverse of disparity minus that of a point at infinity. Without
/// distortion and refraction, the other coordinates are bilinear in this inverse and the pixel, so the
/// inverse is the third input. Distortion and refraction take polynomials of up to the seventh degree,
/// approximated by cubic ones on tiles.
#[derive(Clone, Debug)]
pub(super) struct Map {
    space: Space,
    /// X, Y, Z, left row minus right row, and their derivatives by column, row and inverse disparity.
    tiles: Tiles,
    error_mm: f64,
}

impl Map {
    /// Builds a map from these tiles, or `None` where its covariances differ too much from the exact ones
    /// given at [`checks`]. Rejected tiles are returned unchanged.
    pub fn of(space: &Space, tiles: &mut Tiles, error_mm: f64, checked: &[Sample]) -> Option<Self> {
        let map = Self { space: *space, tiles: core::mem::take(tiles), error_mm };
        if map.covariance_error(checked) <= COVARIANCE_TOLERANCE {
            return Some(map);
        }
        *tiles = map.tiles;
        None
    }

    pub fn error_mm(&self) -> f64 {
        self.error_mm
    }

    /// The most likely point to first order, or `None` outside the map.
    #[inline]
    pub fn point(&self, [left_px, right_px]: [DVec2; 2], roots: &[Root; 2]) -> Option<StereoPoint> {
        let Space { inputs, centre, scale } = &self.space;
        let input = inputs.of(inputs_px(left_px, right_px));
        let ([x, y, z, rows_px], slopes) = self.tiles.at((input - *centre) * *scale)?;
        let epipolar_px = left_px.y - right_px.y - rows_px;
        let spread = Spread::new(&inputs.by_pixels(input.z, &slopes), roots);
        let point_mm = DVec3::new(x, y, z) - spread.shift_mm_per_px * epipolar_px;
        let covariance_mm2 = spread.covariance_mm2();
        Some(StereoPoint { point_mm, covariance_mm2, epipolar_px })
    }

    /// Relative error of the covariance for centres with equal noise along all axes.
    fn covariance_error(&self, checked: &[Sample]) -> f64 {
        let roots = [Root::unit(); 2];
        let mut worst = 0.0_f64;
        for (at, sample) in checks::<CHECKS>().zip(checked) {
            let inverse = self.space.undo(at).z;
            let covariance = |slopes: &[Four; 3]| {
                Spread::new(&self.space.inputs.by_pixels(inverse, slopes), &roots).covariance_mm2()
            };
            let by: [Four; 3] = core::array::from_fn(|k| core::array::from_fn(|i| sample.slope[4 * k + i]));
            let Some((_, found)) = self.tiles.at(at) else { return f64::INFINITY };
            let (found, exact) = (covariance(&found), covariance(&by));
            for (i, j) in [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)] {
                let share = (found[i][j] - exact[i][j]).abs() / sqrt(exact[i][i] * exact[j][j]);
                worst = if share <= worst { worst } else { share };
            }
        }
        worst
    }
}

/// The map's inputs and their box, which is divided into tiles.
#[derive(Clone, Copy, Debug)]
pub(super) struct Space {
    pub inputs: Inputs,
    pub centre: DVec3,
    /// Inverse half size of the box.
    pub scale: DVec3,
}

impl Space {
    /// The inputs at a point of [-1, 1]³.
    pub fn undo(&self, at: DVec3) -> DVec3 {
        self.centre + at / self.scale
    }
}

/// From (column, mean row, disparity) to the map's inputs. Disparity is replaced by the inverse of its
/// distance from that of a point at infinity, which is linear in column and row.
#[derive(Clone, Copy, Debug)]
pub(super) struct Inputs {
    origin_px: DVec2,
    far_px: f64,
    /// Gradient of the disparity at infinity.
    far_slope: DVec2,
}

impl Inputs {
    /// For the observed pixels; `None` when some of them are not nearer than infinity.
    pub fn fit(views: &[RigView<'_>; 2], seen: &[DVec3]) -> Option<Self> {
        let (low, high) = extent(seen.iter().copied());
        let (origin_px, half) = (((low + high) * 0.5).truncate(), ((high - low) * 0.5).truncate());
        let far = |dx: f64, dy: f64| {
            let at = origin_px + half * DVec2::new(dx, dy);
            let ahead = views[0].ray_in_air(views[0].camera().undistort(at).ok()?).direction;
            Some(at.x - views[1].camera().project(views[1].turned(ahead))?.x)
        };
        let far_slope =
            DVec2::new(far(1.0, 0.0)? - far(-1.0, 0.0)?, far(0.0, 1.0)? - far(0.0, -1.0)?) / (half * 2.0);
        let inputs = Self { origin_px, far_px: far(0.0, 0.0)?, far_slope };
        seen.iter().all(|&at| inputs.of(at).z > 0.0).then_some(inputs)
    }

    fn far(&self, column_px: f64, row_px: f64) -> f64 {
        self.far_px + self.far_slope.dot(DVec2::new(column_px, row_px) - self.origin_px)
    }

    #[inline]
    pub fn of(&self, seen: DVec3) -> DVec3 {
        DVec3::new(seen.x, seen.y, 1.0 / (seen.z - self.far(seen.x, seen.y)))
    }

    /// (column, mean row, disparity) of inputs.
    pub fn undo(&self, input: DVec3) -> DVec3 {
        DVec3::new(input.x, input.y, self.far(input.x, input.y) + 1.0 / input.z)
    }

    /// Derivatives of X, Y, Z and the row difference by the inputs, from those by (column, mean row,
    /// disparity).
    pub fn by_inputs(&self, inverse: f64, [u, v, d]: [[f64; 4]; 3]) -> [f64; 12] {
        let (by_inverse, far) = (-1.0 / (inverse * inverse), self.far_slope);
        let mut slope = [0.0; 12];
        for i in 0..4 {
            (slope[i], slope[4 + i]) = (u[i] + d[i] * far.x, v[i] + d[i] * far.y);
            slope[8 + i] = d[i] * by_inverse;
        }
        slope
    }

    /// Derivatives by left column, either row and right column.
    #[inline]
    fn by_pixels(&self, inverse: f64, [u, v, w]: &[Four; 3]) -> [Four; 3] {
        let (square, far) = (inverse * inverse, self.far_slope);
        let left = multiply_add(w, -square * (1.0 - far.x), u);
        let row = multiply_add(w, square * far.y, v).map(|x| 0.5 * x);
        [left, row, w.map(|x| x * square)]
    }
}

/// Propagation of the noise of four pixel coordinates x = L e, with independent e of variance 1, to the
/// point.
///
/// They must satisfy v - v' = rows(inputs): h · e = 0 to first order, with h the gradient. So one
/// combination of the point's four columns by e, along h, is known. A reflection that maps h to an axis
/// leaves the other three as a square root of the covariance.
struct Spread {
    columns: [DVec3; 3],
    /// Shift of the point per pixel of epipolar residual.
    shift_mm_per_px: DVec3,
}

impl Spread {
    #[inline]
    fn new([left, row, right]: &[Four; 3], [l, r]: &[Root; 2]) -> Self {
        let times = |x: &Four, factor: f64| x.map(|x| x * factor);
        let a = multiply_add(left, l.xx, &times(row, l.yx));
        let b = times(row, l.yy);
        let c = multiply_add(right, r.xx, &times(row, r.yx));
        let d = times(row, r.yy);
        let h = [l.yx - a[3], l.yy - b[3], -r.yx - c[3], -r.yy - d[3]];
        let square = h[0] * h[0] + h[1] * h[1] + h[2] * h[2] + h[3] * h[3];
        let ab = multiply_add(&a, h[0], &times(&b, h[1]));
        let moved = multiply_add(&d, h[3], &multiply_add(&c, h[2], &ab));
        // Householder reflection to the second axis: along h + |h| e with the sign that avoids
        // cancellation.
        let length = sqrt(square).copysign(h[1]);
        let inverse = 1.0 / (square + length * h[1]);
        let along = times(&multiply_add(&b, length, &moved), inverse);
        let less = |x: &Four, by: f64| DVec3::from_slice(&multiply_add(&along, -by, x));
        Self {
            columns: [less(&a, h[0]), less(&c, h[2]), less(&d, h[3])],
            shift_mm_per_px: DVec3::from_slice(&moved) * (1.0 / square),
        }
    }

    #[inline]
    fn covariance_mm2(&self) -> Symmetric<3> {
        sum_of_squares(&self.columns)
    }
}

/// Column, mean row and disparity.
pub(super) fn inputs_px(left_px: DVec2, right_px: DVec2) -> DVec3 {
    DVec3::new(left_px.x, 0.5 * (left_px.y + right_px.y), left_px.x - right_px.x)
}

/// Smallest and largest coordinates.
pub(super) fn extent(points: impl Iterator<Item = DVec3>) -> (DVec3, DVec3) {
    points.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), at| (low.min(at), high.max(at)))
}

/// Exact values at one input.
#[derive(Clone, Debug)]
pub(super) struct Sample {
    pub value: [f64; 4],
    pub slope: [f64; 12],
}
