//! Where a marker should stand, from the markers placed around it.

use super::canvas::{Canvas, STEPS};
use super::found::Place;
use crate::math::DVec2;

/// Where a place should be seen.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prediction {
    pub at: DVec2,
    /// Independent estimates it is the mean of.
    pub sources: u32,
    /// Mean squared distance of the estimates from their mean, square pixels.
    pub spread2: f64,
}

/// A running mean and spread.
#[derive(Default)]
struct Mean {
    sum: DVec2,
    sum2: f64,
    count: u32,
}

impl Mean {
    fn add(&mut self, p: Option<DVec2>, origin: DVec2) {
        if let Some(p) = p {
            // About a point nearby, so that the squares lose no digits.
            let p = p - origin;
            self.sum += p;
            self.sum2 += p.length_squared();
            self.count += 1;
        }
    }

    fn prediction(&self, origin: DVec2) -> Option<Prediction> {
        let count = f64::from(self.count);
        let mean = self.sum / count;
        let spread2 = (self.sum2 / count - mean.length_squared()).max(0.0);
        (self.count > 0).then(|| Prediction { at: origin + mean, sources: self.count, spread2 })
    }
}

/// From the four nearest places and the four corners of the cells around: the middle of opposite neighbours where there
/// are any, as it follows curved rows best, otherwise straight on and across cells.
pub(super) fn predict(canvas: &Canvas, points: &[DVec2], place: Place) -> Option<Prediction> {
    let at = |rows: i32, cols: i32| canvas.position(points, place.step((rows, cols)));
    let near = STEPS.map(|(dr, dc)| at(dr, dc));
    let origin = near.iter().flatten().next().copied()?;
    let mut between = Mean::default();
    between.add(near[0].zip(near[2]).map(|(a, b)| (a + b) * 0.5), origin);
    between.add(near[1].zip(near[3]).map(|(a, b)| (a + b) * 0.5), origin);
    if between.count > 0 {
        return between.prediction(origin);
    }
    let mut beyond = Mean::default();
    for (k, (dr, dc)) in STEPS.into_iter().enumerate() {
        let Some(here) = near[k] else { continue };
        beyond.add(at(2 * dr, 2 * dc).map(|before| here * 2.0 - before), origin);
        let (next, (er, ec)) = (near[(k + 1) % 4], STEPS[(k + 1) % 4]);
        if let Some(next) = next {
            beyond.add(at(dr + er, dc + ec).map(|corner| here + next - corner), origin);
        }
    }
    beyond.prediction(origin)
}

/// As [`predict`], and where that has nothing to go by, the plane through the markers up to two places away.
pub(super) fn predict_widely(canvas: &Canvas, points: &[DVec2], place: Place) -> Option<Prediction> {
    predict(canvas, points, place).or_else(|| plane(canvas, points, place))
}

/// Least squares of position against row and column over 5 x 5 places, near ones counting more; its value in the middle.
fn plane(canvas: &Canvas, points: &[DVec2], place: Place) -> Option<Prediction> {
    let origin = window(canvas, place).next().map(|(_, m)| points[m])?;
    let (mut w, mut r, mut c, mut rr, mut rc, mut cc) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    let (mut x, mut xr, mut xc) = (DVec2::ZERO, DVec2::ZERO, DVec2::ZERO);
    let mut sources = 0;
    for ((dr, dc), m) in window(canvas, place) {
        let (row, col, p) = (f64::from(dr), f64::from(dc), points[m] - origin);
        let weight = 1.0 / (row * row + col * col);
        (w, r, c) = (w + weight, r + weight * row, c + weight * col);
        (rr, rc, cc) = (rr + weight * row * row, rc + weight * row * col, cc + weight * col * col);
        (x, xr, xc) = (x + p * weight, xr + p * (weight * row), xc + p * (weight * col));
        sources += 1;
    }
    // Cramer's rule for the constant term; the determinant is 0 when all stand on one line.
    let determinant = w * (rr * cc - rc * rc) - r * (r * cc - rc * c) + c * (r * rc - rr * c);
    if sources < 4 || determinant < 0.05 * w * rr * cc {
        return None;
    }
    let constant = x * (rr * cc - rc * rc) - xr * (r * cc - rc * c) + xc * (r * rc - rr * c);
    Some(Prediction { at: origin + constant / determinant, sources: 1, spread2: 0.0 })
}

/// The up to 24 markers around a place, with their steps from it.
fn window(canvas: &Canvas, place: Place) -> impl Iterator<Item = ((i32, i32), usize)> {
    (-2..=2)
        .flat_map(|dr| (-2..=2).map(move |dc| (dr, dc)))
        .filter(|&step| step != (0, 0))
        .filter_map(move |step| Some((step, canvas.at(place.step(step))?)))
}

/// Steps to the next marker of the row and of the column at a placed marker, from its neighbours.
pub(super) fn steps_at(canvas: &Canvas, points: &[DVec2], place: Place) -> Option<(DVec2, DVec2)> {
    let axis = |(dr, dc): (i32, i32)| {
        let at = |n: i32| canvas.position(points, place.step((n * dr, n * dc)));
        match (at(-1), at(0), at(1)) {
            (Some(before), _, Some(after)) => Some((after - before) * 0.5),
            (Some(before), Some(here), None) => Some(here - before),
            (None, Some(here), Some(after)) => Some(after - here),
            _ => None,
        }
    };
    axis((0, 1)).zip(axis((1, 0)))
}
