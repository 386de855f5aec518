//! The lattice with rings of empty places around it, where markers would appear if it had moved by whole
//! pitches.

use crate::math::{DVec2, median, sqrt};
use alloc::vec::Vec;

/// No detection.
pub(super) const NONE: u32 = u32::MAX;

/// Steps to the eight neighbouring places: rows down, columns to the right.
const AROUND: [[isize; 2]; 8] = [[-1, -1], [-1, 0], [-1, 1], [0, -1], [0, 1], [1, -1], [1, 0], [1, 1]];

/// Radius, in places, of the neighbourhood from which the value of a place is estimated.
pub(super) const SUGGESTED_FROM: usize = 2;

/// Estimates of a place's value from its neighbourhood.
#[derive(Clone, Copy, Debug, Default)]
struct Suggestions {
    x: [f64; 12],
    y: [f64; 12],
    count: usize,
}

/// Value of a place estimated from its neighbourhood.
#[derive(Clone, Copy, Debug)]
pub(super) struct Suggested {
    pub middle_px: DVec2,
    /// Median distance of the estimates from it.
    pub spread_px: f64,
    /// Number of estimates.
    pub count: usize,
}

impl Suggestions {
    fn push(&mut self, value: DVec2) {
        (self.x[self.count], self.y[self.count]) = (value.x, value.y);
        self.count += 1;
    }

    /// Median per axis, which is robust to one wrong neighbour.
    fn middle(mut self) -> Option<Suggested> {
        let mut apart = [0.0; 12];
        let n = self.count;
        let (xs, ys) = (self.x, self.y);
        let middle = DVec2::new(median(&mut self.x[..n])?, median(&mut self.y[..n])?);
        for (apart, (&x, &y)) in apart.iter_mut().zip(xs.iter().zip(&ys)) {
            *apart = middle.distance(DVec2::new(x, y));
        }
        Some(Suggested { middle_px: middle, spread_px: median(&mut apart[..n])?, count: n })
    }
}

/// Places of the lattice and of `rings` rings around it, row by row.
#[derive(Clone, Debug, Default)]
pub(super) struct ExtendedLattice {
    pub rows: usize,
    pub cols: usize,
    pub rings: usize,
    /// Marker of each place, or [`NONE`] around the lattice.
    markers: Vec<u32>,
    /// Predicted marker position of each place; around the lattice its outer steps are continued.
    pub predicted_px: Vec<DVec2>,
    /// Detection minus prediction; without a detection, the estimate from its neighbourhood.
    pub residual_px: Vec<DVec2>,
    /// Detection at each place, or [`NONE`].
    pub found: Vec<u32>,
    /// Whether the position of each place is known, from a match nearby.
    pub located: Vec<bool>,
}

/// Location of a place on its canvas.
#[derive(Clone, Copy)]
struct Near {
    site: usize,
    row: usize,
    col: usize,
    width: usize,
    height: usize,
    /// Places between it and the nearest edge of the canvas.
    room: usize,
}

impl Near {
    /// Place `steps` away in a direction; `None` outside the canvas.
    #[inline]
    fn at(self, steps: usize, [down, right]: [isize; 2]) -> Option<usize> {
        let (down, right) = (steps as isize * down, steps as isize * right);
        let inside = self.room >= steps
            || (self.row.wrapping_add_signed(down) < self.height
                && self.col.wrapping_add_signed(right) < self.width);
        inside.then(|| self.site.wrapping_add_signed(down * self.width as isize + right))
    }
}

/// A place is located if a match lies within this many steps.
const LOCATED_STEPS: usize = 2;

impl ExtendedLattice {
    pub const fn width(&self) -> usize {
        self.cols + 2 * self.rings
    }

    /// Marker of a place, or `None` around the lattice.
    pub fn marker(&self, site: usize) -> Option<usize> {
        Some(self.markers[site]).filter(|&n| n != NONE).map(|n| n as usize)
    }

    /// [`Self::site`] of every marker.
    pub fn sites(&self, shift: [isize; 2]) -> impl Iterator<Item = Option<usize>> + '_ {
        let along =
            move |from: usize, by: isize, end: usize| from.checked_add_signed(by).filter(|&i| i < end);
        let rows = self.rings..self.rings + self.rows;
        rows.flat_map(move |row| {
            let start = along(row, shift[0], self.height()).map(|row| row * self.width());
            let cols = self.rings..self.rings + self.cols;
            cols.map(move |col| Some(start? + along(col, shift[1], self.width())?))
        })
    }

    /// Place of a marker of a lattice shifted by `shift` rows and columns; `None` outside the canvas.
    pub fn site(&self, marker: usize, shift: [isize; 2]) -> Option<usize> {
        let along =
            |at: usize, by: isize, end: usize| (at + self.rings).checked_add_signed(by).filter(|&i| i < end);
        let row = along(marker / self.cols, shift[0], self.rows + 2 * self.rings)?;
        let col = along(marker % self.cols, shift[1], self.width())?;
        Some(row * self.width() + col)
    }

    /// Sets the predicted positions of the `rows * cols` markers and clears all detections.
    pub fn lay(&mut self, lattice_px: &[DVec2], rows: usize, cols: usize, rings: usize) {
        (self.rows, self.cols, self.rings) = (rows, cols, rings);
        let (width, height) = (self.width(), rows + 2 * rings);
        self.predicted_px.clear();
        self.predicted_px.resize(width * height, DVec2::ZERO);
        self.residual_px.clear();
        self.residual_px.resize(width * height, DVec2::ZERO);
        self.found.clear();
        self.found.resize(width * height, NONE);
        self.located.clear();
        self.located.resize(width * height, true);
        self.markers.clear();
        self.markers.resize(width * height, NONE);
        for (row, line) in lattice_px.chunks_exact(cols).enumerate() {
            let start = (row + rings) * width;
            for (marker, n) in self.markers[start + rings..][..cols].iter_mut().zip(row * cols..) {
                *marker = n as u32;
            }
            self.predicted_px[start + rings..][..cols].copy_from_slice(line);
            self.continue_line(start, 1, cols);
        }
        for col in 0..width {
            self.continue_line(col, width, rows);
        }
    }

    /// Extrapolates the `len` known places of a line on both sides by the mean of their outer two steps.
    fn continue_line(&mut self, start: usize, stride: usize, len: usize) {
        let (first, last, steps) = (self.rings, self.rings + len - 1, len.min(3) - 1);
        for (end, inner, outwards) in [(first, first + steps, -1), (last, last - steps, 1)] {
            let outer = self.predicted_px[start + end * stride];
            let step = (outer - self.predicted_px[start + inner * stride]) / steps.max(1) as f64;
            for ring in 1..=self.rings as isize {
                let place = end.wrapping_add_signed(outwards * ring);
                self.predicted_px[start + place * stride] = outer + step * ring as f64;
            }
        }
    }

    /// Rows of the canvas, rings included.
    pub const fn height(&self) -> usize {
        self.rows + 2 * self.rings
    }

    /// The up to eight neighbouring places, row by row.
    pub fn around(&self, site: usize) -> impl Iterator<Item = usize> + use<> {
        let near = self.near(site);
        AROUND.into_iter().filter_map(move |direction| near.at(1, direction))
    }

    fn near(&self, site: usize) -> Near {
        let (width, height) = (self.width(), self.height());
        let (row, col) = (site / width, site % width);
        let room = row.min(height - 1 - row).min(col).min(width - 1 - col);
        Near { site, row, col, width, height, room }
    }

    /// Smallest predicted distance between neighbours in a row or a column.
    pub fn least_step_px(&self) -> f64 {
        let apart2 = |(a, b): (&DVec2, &DVec2)| a.distance_squared(*b);
        let (mut least2, places) = (f64::INFINITY, &self.predicted_px);
        for row in places.chunks_exact(self.width()) {
            least2 = row.iter().zip(&row[1..]).map(apart2).fold(least2, f64::min);
        }
        sqrt(places.iter().zip(&places[self.width()..]).map(apart2).fold(least2, f64::min))
    }

    /// Predicted distance of a place to the nearest of its four neighbours.
    pub fn step_px(&self, site: usize) -> f64 {
        let (width, col) = (self.width(), site % self.width());
        let beside = [
            (col > 0).then(|| site - 1),
            (col + 1 < width).then_some(site + 1),
            site.checked_sub(width),
            Some(site + width).filter(|&s| s < self.found.len()),
        ];
        let apart2 = |s: usize| self.predicted_px[s].distance_squared(self.predicted_px[site]);
        sqrt(beside.into_iter().flatten().map(apart2).fold(f64::INFINITY, f64::min))
    }

    /// Measured or estimated position of the marker of a place.
    pub fn position_px(&self, site: usize) -> DVec2 {
        self.predicted_px[site] + self.residual_px[site]
    }

    /// Sets the residual of every place without a detection to the mean of its neighbours, outwards from
    /// the detections.
    pub fn spread(&mut self, known: &mut Vec<bool>, round: &mut Vec<(u32, DVec2)>) {
        known.clear();
        known.extend(self.found.iter().map(|&m| m != NONE));
        for steps in 0.. {
            if steps == LOCATED_STEPS {
                self.located.copy_from_slice(known);
            }
            round.clear();
            for site in (0..known.len()).filter(|&s| !known[s]) {
                if let Some(mean) = self.mean_residual(site, |s| known[s]) {
                    round.push((site as u32, mean));
                }
            }
            if round.is_empty() {
                return;
            }
            for &(site, residual) in round.iter() {
                self.residual_px[site as usize] = residual;
                known[site as usize] = true;
            }
        }
    }

    /// Estimates of a place's value from matched neighbours: interpolated between opposite pairs and
    /// extrapolated along lines. All are exact where values vary linearly, as positions do, and residuals
    /// under rotation.
    fn suggest(&self, site: usize, value: impl Fn(usize) -> DVec2, mut see: impl FnMut(DVec2)) {
        let near = self.near(site);
        let found = |steps, direction| {
            let value = |other: usize| (self.found[other] != NONE).then(|| value(other));
            near.at(steps, direction).and_then(value)
        };
        let firsts = AROUND.map(|direction| found(1, direction));
        for k in 0..8 {
            let Some(first) = firsts[k] else { continue };
            if let (true, Some(opposite)) = (k < 4, firsts[7 - k]) {
                see((first + opposite) * 0.5);
            }
            if let Some(second) = found(2, AROUND[k]) {
                see(first * 2.0 - second);
            }
        }
    }

    /// Whether there are estimates of a place's residual and all lie closer to it than `most_px`. Then so
    /// does their median.
    pub fn is_as_suggested(&self, site: usize, most_px: f64) -> bool {
        let (mut off, mut any, here) = (DVec2::ZERO, false, self.residual_px[site]);
        self.suggest(
            site,
            |s| self.residual_px[s],
            |suggested| {
                off = off.max((suggested - here).abs());
                any = true;
            },
        );
        any && off.length_squared() <= most_px * most_px
    }

    /// As [`Self::is_as_suggested`], and every place used for the estimates has a detection.
    pub fn is_amid(&self, site: usize, most_px: f64) -> bool {
        if self.near(site).room < SUGGESTED_FROM {
            return false;
        }
        let (here, mut off, mut whole) = (self.residual_px[site], DVec2::ZERO, true);
        for [down, right] in &AROUND[..4] {
            let step = down * self.width() as isize + right;
            let [before, first, opposite, after] = [2, 1, -1, -2].map(|steps| {
                let other = site.wrapping_add_signed(steps * step);
                whole &= self.found[other] != NONE;
                self.residual_px[other] - here
            });
            let suggested = [(first + opposite) * 0.5, first * 2.0 - before, opposite * 2.0 - after];
            off = suggested.iter().fold(off, |off, suggested| off.max(suggested.abs()));
        }
        whole && off.length_squared() <= most_px * most_px
    }

    fn suggestions(&self, site: usize, value: impl Fn(usize) -> DVec2) -> Suggestions {
        let mut out = Suggestions::default();
        self.suggest(site, value, |suggested| out.push(suggested));
        out
    }

    /// Residual estimated from the matched neighbours.
    pub fn suggested(&self, site: usize) -> Option<Suggested> {
        let lines = self.suggestions(site, |s| self.residual_px[s]).middle();
        lines.or_else(|| {
            let mean = self.mean_residual(site, |s| self.found[s] != NONE)?;
            Some(Suggested { middle_px: mean, spread_px: 0.0, count: 1 })
        })
    }

    /// Position in this frame estimated from matched neighbours, independently of the prediction.
    pub fn between_px(&self, site: usize) -> Option<DVec2> {
        Some(self.suggestions(site, |s| self.position_px(s)).middle()?.middle_px)
    }

    /// Mean residual of the neighbours that `accept` selects.
    pub fn mean_residual(&self, site: usize, accept: impl Fn(usize) -> bool) -> Option<DVec2> {
        let (mut sum, mut count) = (DVec2::ZERO, 0.0);
        for other in self.around(site).filter(|&s| accept(s)) {
            sum += self.residual_px[other];
            count += 1.0;
        }
        (count > 0.0).then(|| sum / count)
    }
}
