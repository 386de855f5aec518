//! The fast rung: a polynomial in column, row and disparity that is fitted to the exact one.

use super::{Centre, StereoPoint};
use crate::math::{DMat3, DVec3, cos};
use crate::rig::RigView;
use alloc::vec::Vec;

/// Highest degree. Five do without lens distortion; a strong one needs six or seven.
const DEGREE: usize = 7;
/// Degree of the derivatives: 3 % of the covariance is below what is known of that of the centres.
const SLOPE_DEGREE: usize = 3;
/// Chebyshev nodes along each input.
const NODES: usize = 8;
/// Points along each input at which the map is checked; none is a node.
const CHECKS: usize = 7;
/// A degree is taken whose largest error at the checked points is below this.
const TOLERANCE_MM: f64 = 5e-4;
/// Steps of Newton's method to a node.
const MAX_STEPS: usize = 20;

/// A map from (column in the left view, mean row, disparity) of the raw pixels to the point, and to the difference of
/// the rows that belongs to it, in Chebyshev polynomials of bounded total degree over a box of the inputs. Distortion,
/// rectification and refraction are all in it.
#[derive(Clone, Debug)]
pub(super) struct Map {
    centre: DVec3,
    half: DVec3,
    degree: usize,
    /// X, Y, Z, left row less right row; in the order of [`sum`].
    values: Vec<[f64; 4]>,
    /// Columns of d (X, Y, Z) / d inputs, then d row difference / d inputs.
    slopes: Vec<[f64; 12]>,
    error_mm: f64,
}

/// What is exact at one input.
struct Sample {
    value: [f64; 4],
    slope: [f64; 12],
}

impl Map {
    /// Fitted around `rest_mm`; `None` when no polynomial of [`DEGREE`] comes near enough.
    pub(super) fn fit(views: &[RigView<'_>; 2], rest_mm: &[DVec3], reach_mm: f64) -> Option<Self> {
        let (low, high) = bounds(views, rest_mm, reach_mm)?;
        let (centre, half) = ((low + high) * 0.5, (high - low) * 0.5);
        let start = crate::math::centroid(rest_mm);
        let nodes = chebyshev_nodes::<NODES>();
        let exact = samples(views, start, &nodes, centre, half)?;
        let mut map = Self {
            centre,
            half,
            degree: DEGREE,
            values: Vec::new(),
            slopes: coefficients(SLOPE_DEGREE, exact.iter().map(|sample| sample.slope)),
            error_mm: 0.0,
        };
        let checks: [f64; CHECKS] =
            core::array::from_fn(|i| cos(core::f64::consts::PI * i as f64 / (CHECKS - 1) as f64));
        let checked = samples(views, start, &checks, centre, half)?;
        let values = exact.iter().map(|sample| sample.value);
        for degree in 3..=DEGREE {
            map.degree = degree;
            map.values = coefficients(degree, values.clone());
            map.error_mm = map.largest_error(&checks, &checked);
            if map.error_mm <= TOLERANCE_MM {
                return Some(map);
            }
        }
        None
    }

    pub(super) fn error_mm(&self) -> f64 {
        self.error_mm
    }

    /// The most likely point to first order, or `None` beyond the map's reach.
    pub(super) fn point(&self, left: &Centre, right: &Centre) -> Option<StereoPoint> {
        let (l, r) = (left.at_px, right.at_px);
        let input = (DVec3::new(l.x, 0.5 * (l.y + r.y), l.x - r.x) - self.centre) / self.half;
        if !(input.abs().max_element() <= 1.0) {
            return None;
        }
        let basis = [chebyshev(input.x), chebyshev(input.y), chebyshev(input.z)];
        let [x, y, z, rows_px] = sum(self.degree, &self.values, &basis);
        let slopes = sum(SLOPE_DEGREE, &self.slopes, &basis);
        let (slope, rows_slope) = (DMat3::from_cols_slice(&slopes), DVec3::from_slice(&slopes[9..]));
        let epipolar_px = l.y - r.y - rows_px;
        let (shift, covariance) = Self::correct(left, right, epipolar_px, rows_slope);
        let point_mm = DVec3::new(x, y, z) + slope * shift;
        let covariance_mm2 = (slope * covariance * slope.transpose()).to_cols_array_2d();
        Some(StereoPoint { point_mm, covariance_mm2, epipolar_px })
    }

    /// How far the most likely inputs are from those measured, and their covariance: the four pixel coordinates must
    /// obey v - v' = rows(inputs), whose gradient by them is g; they move by -Σ g (gᵀ Σ g)⁻¹ times what they miss it by.
    fn correct(left: &Centre, right: &Centre, missed_px: f64, rows: DVec3) -> (DVec3, DMat3) {
        let ([[a, b], [_, c]], [[d, e], [_, f]]) = (left.covariance_px2, right.covariance_px2);
        let g = [-rows.x - rows.z, 1.0 - 0.5 * rows.y, rows.z, -1.0 - 0.5 * rows.y];
        let moved = [a * g[0] + b * g[1], b * g[0] + c * g[1], d * g[2] + e * g[3], e * g[2] + f * g[3]];
        let scale = 1.0 / (g[0] * moved[0] + g[1] * moved[1] + g[2] * moved[2] + g[3] * moved[3]);
        let moved = DVec3::new(moved[0], 0.5 * (moved[1] + moved[3]), moved[0] - moved[2]);
        // Of the inputs (u, (v + v') / 2, u - u') as measured.
        let (uv, vd) = (0.5 * b, 0.5 * (b - e));
        let measured = DMat3::from_cols(
            DVec3::new(a, uv, a),
            DVec3::new(uv, 0.25 * (c + f), vd),
            DVec3::new(a, vd, a + d),
        );
        let known = moved * scale;
        let gain = DMat3::from_cols(moved * known.x, moved * known.y, moved * known.z);
        (known * -missed_px, measured - gain)
    }

    fn largest_error(&self, axis: &[f64], exact: &[Sample]) -> f64 {
        let mut worst = 0.0_f64;
        for (at, sample) in grid(axis).zip(exact) {
            let basis = [chebyshev(at.x), chebyshev(at.y), chebyshev(at.z)];
            let found: [f64; 4] = sum(self.degree, &self.values, &basis);
            let off = DVec3::from_slice(&found) - DVec3::from_slice(&sample.value);
            worst = worst.max(off.length());
        }
        worst
    }
}

/// Box of the inputs that show points within reach of the rest surface: sideways, towards the cameras, and a quarter
/// away from them.
fn bounds(views: &[RigView<'_>; 2], rest_mm: &[DVec3], reach_mm: f64) -> Option<(DVec3, DVec3)> {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for &rest in rest_mm {
        for along in [-1.0, 0.25] {
            for (x, y) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
                let input = see(views, rest + DVec3::new(x, y, along) * reach_mm)?.input;
                (low, high) = (low.min(input), high.max(input));
            }
        }
    }
    (high - low).is_finite().then_some((low, high))
}

/// The map's inputs at a point and the row difference, with their derivatives by the point.
struct Seen {
    input: DVec3,
    jacobian: DMat3,
    rows_px: f64,
    rows_gradient: DVec3,
}

fn see(views: &[RigView<'_>; 2], point_mm: DVec3) -> Option<Seen> {
    let left = views[0].project_with_jacobian(point_mm, 0.0).ok()?;
    let right = views[1].project_with_jacobian(point_mm, 0.0).ok()?;
    let (l, r) = (left.pixel_px, right.pixel_px);
    let ([u, v], [u_right, v_right]) = (left.jacobian, right.jacobian);
    Some(Seen {
        input: DVec3::new(l.x, 0.5 * (l.y + r.y), l.x - r.x),
        jacobian: DMat3::from_cols(u, (v + v_right) * 0.5, u - u_right).transpose(),
        rows_px: l.y - r.y,
        rows_gradient: v - v_right,
    })
}

/// Exact values at all points of a grid of scaled inputs, by Newton's method on [`see`], each from the one before.
fn samples(
    views: &[RigView<'_>; 2],
    start: DVec3,
    axis: &[f64],
    centre: DVec3,
    half: DVec3,
) -> Option<Vec<Sample>> {
    let mut point = start;
    grid(axis)
        .map(|at| {
            let target = centre + half * at;
            for _ in 0..MAX_STEPS {
                let seen = see(views, point)?;
                let inverse = seen.jacobian.inverse();
                let step = inverse * (target - seen.input);
                point += step;
                // Newton's steps shrink quadratically: the next would be below 1e-12 mm.
                if step.length() <= 1e-7 {
                    let mut slope = [0.0; 12];
                    slope[..9].copy_from_slice(&inverse.to_cols_array());
                    slope[9..].copy_from_slice(&(inverse.transpose() * seen.rows_gradient).to_array());
                    return Some(Sample { value: [point.x, point.y, point.z, seen.rows_px], slope });
                }
            }
            None
        })
        .collect()
}

/// All points with coordinates of `axis`; the first coordinate runs fastest.
fn grid(axis: &[f64]) -> impl Iterator<Item = DVec3> {
    axis.iter()
        .flat_map(move |&z| axis.iter().flat_map(move |&y| axis.iter().map(move |&x| DVec3::new(x, y, z))))
}

fn chebyshev_nodes<const N: usize>() -> [f64; N] {
    core::array::from_fn(|i| cos(core::f64::consts::PI * (i as f64 + 0.5) / N as f64))
}

/// T_0 to T_7.
fn chebyshev(x: f64) -> [f64; DEGREE + 1] {
    let mut t = [1.0; DEGREE + 1];
    t[1] = x;
    for k in 2..=DEGREE {
        t[k] = 2.0 * x * t[k - 1] - t[k - 2];
    }
    t
}

/// Coefficients of the products of Chebyshev polynomials up to a total degree, from the values on the grid of nodes:
/// there the products are orthogonal, so that each coefficient is one sum, and a lower degree a truncation.
fn coefficients<const N: usize>(
    degree: usize,
    exact: impl Iterator<Item = [f64; N]> + Clone,
) -> Vec<[f64; N]> {
    let basis = chebyshev_nodes::<NODES>().map(chebyshev);
    let mut out = Vec::new();
    for c in 0..=degree {
        for b in 0..=degree - c {
            for a in 0..=degree - c - b {
                let mut total = [0.0; N];
                for (n, value) in exact.clone().enumerate() {
                    let at = basis[n % NODES][a] * basis[n / NODES % NODES][b] * basis[n / NODES / NODES][c];
                    for (total, value) in total.iter_mut().zip(value) {
                        *total += at * value;
                    }
                }
                let twos = [a, b, c].into_iter().filter(|&k| k > 0).count();
                let norm = f64::from(1 << twos) / (NODES * NODES * NODES) as f64;
                out.push(total.map(|total| total * norm));
            }
        }
    }
    out
}

/// The sum of products, in the order in which [`coefficients`] makes them.
fn sum<const N: usize>(degree: usize, coefficients: &[[f64; N]], basis: &[[f64; DEGREE + 1]; 3]) -> [f64; N] {
    let mut rest = coefficients;
    let mut total = [0.0; N];
    for c in 0..=degree {
        let mut plane = [0.0; N];
        for b in 0..=degree - c {
            let (line, after) = rest.split_at(degree - c - b + 1);
            rest = after;
            let mut row = [0.0; N];
            for (coefficient, t) in line.iter().zip(&basis[0]) {
                for (row, coefficient) in row.iter_mut().zip(coefficient) {
                    *row += t * coefficient;
                }
            }
            for (plane, row) in plane.iter_mut().zip(row) {
                *plane += basis[1][b] * row;
            }
        }
        for (total, plane) in total.iter_mut().zip(plane) {
            *total += basis[2][c] * plane;
        }
    }
    total
}
