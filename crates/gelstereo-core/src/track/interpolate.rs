//! Positions of unseen markers, interpolated from their neighbours.

use super::near;
use crate::math::DVec2;
use alloc::vec::Vec;

/// A marker is interpolated from places up to this many rows and columns away.
const REACH: usize = 2;

/// Affine map of the plane: least squares over pairs of points.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Affine {
    count: f64,
    from: DVec2,
    to: DVec2,
    /// Second moments of the sources about their mean: xx, xy, yy.
    moments: [f64; 3],
    /// Sums of source x target and of source y target.
    cross: [DVec2; 2],
}

impl Affine {
    /// Fits pairs (source, target). The order of the pairs affects rounding, so it must be fixed.
    pub fn fit(pairs: impl Iterator<Item = (DVec2, DVec2)> + Clone) -> Self {
        let mut fit = Self::default();
        for (from, to) in pairs.clone() {
            fit.count += 1.0;
            fit.from += from;
            fit.to += to;
        }
        fit.from /= fit.count.max(1.0);
        fit.to /= fit.count.max(1.0);
        for (from, to) in pairs {
            let (from, to) = (from - fit.from, to - fit.to);
            fit.moments[0] += from.x * from.x;
            fit.moments[1] += from.x * from.y;
            fit.moments[2] += from.y * from.y;
            fit.cross[0] += to * from.x;
            fit.cross[1] += to * from.y;
        }
        fit
    }

    /// Images of the unit vectors, if the sources span the plane well.
    pub fn columns(&self) -> Option<[DVec2; 2]> {
        let [xx, xy, yy] = self.moments;
        let determinant = xx * yy - xy * xy;
        // Accepts sources at most about five times as long as wide.
        let spans = self.count >= 4.0 && determinant > 0.04 * (0.5 * (xx + yy)) * (0.5 * (xx + yy));
        let [x, y] = self.cross;
        spans.then(|| [(x * yy - y * xy) / determinant, (y * xx - x * xy) / determinant])
    }

    pub fn apply(&self, [x, y]: [DVec2; 2], from: DVec2) -> DVec2 {
        let d = from - self.from;
        self.to + x * d.x + y * d.y
    }
}

/// Interpolates unseen markers.
#[derive(Clone, Debug, Default)]
pub(super) struct Interpolator {
    known: Vec<bool>,
    round: Vec<(u32, DVec2)>,
}

impl Interpolator {
    pub fn reserve(&mut self, markers: usize) {
        self.known.reserve(markers);
        self.round.reserve(markers);
    }

    /// Moves each unseen marker by the affine map from the rest positions of its neighbours to their
    /// present ones, starting next to the seen markers. Starting from rest, errors do not accumulate over
    /// frames. With too few neighbours, the map of the whole lattice is used. Does nothing when no marker
    /// is seen.
    pub fn run(&mut self, rest_px: &[DVec2], cols: usize, seen: impl Fn(usize) -> bool, out: &mut [DVec2]) {
        let Self { known, round } = self;
        known.clear();
        known.extend((0..rest_px.len()).map(&seen));
        if !known.contains(&false) {
            return;
        }
        let whole = Affine::fit(pairs(rest_px, out, (0..rest_px.len()).filter(|&n| known[n])));
        if whole.count == 0.0 {
            return;
        }
        let turn = whole.columns().unwrap_or([DVec2::X, DVec2::Y]);
        loop {
            round.clear();
            for n in (0..rest_px.len()).filter(|&n| !known[n]) {
                if !near(n, cols, rest_px.len(), 1).any(|m| known[m]) {
                    continue;
                }
                let around = near(n, cols, rest_px.len(), REACH).filter(|&m| known[m]);
                let local = Affine::fit(pairs(rest_px, out, around));
                round.push((n as u32, local.apply(local.columns().unwrap_or(turn), rest_px[n])));
            }
            if round.is_empty() {
                return;
            }
            for &(n, position) in round.iter() {
                out[n as usize] = position;
                known[n as usize] = true;
            }
        }
    }
}

pub(super) fn pairs<'a>(
    rest_px: &'a [DVec2],
    now_px: &'a [DVec2],
    markers: impl Iterator<Item = usize> + Clone + 'a,
) -> impl Iterator<Item = (DVec2, DVec2)> + Clone + 'a {
    markers.map(|n| (rest_px[n], now_px[n]))
}
