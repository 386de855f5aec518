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
    let cell = canvas.cell(place)?;
    let at = |rows: i32, cols: i32| canvas.seen_from(points, cell, rows, cols);
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
