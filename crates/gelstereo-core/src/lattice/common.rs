//! Rows and columns that both views of a print show.
//!
//! Where the border of a print is not whole in view, each view alone would choose its own rectangle. Here the
//! places of one view are shifted until they are those of the other, and one rectangle is chosen for both.

use super::found::{Place, Sites};
use super::hexagonal::{offset, without_strays};
use super::view_lattice::{Places, ViewLattice};
use super::window::{PartialBorders, Window};
use super::{LabelError, RestLattice};
use crate::params::LatticeParams;
use alloc::vec::Vec;

/// Smallest share of a view's markers that the other view shows too.
const MIN_SHARED: f64 = 0.3;

/// Detections of a place and of the next ones of its row and column, each in the left and in the right view.
pub(crate) type SharedCell = [[usize; 2]; 3];

/// Two views of a print, without rows and columns that both agree on.
pub(crate) struct TwoViews<'a> {
    left: &'a ViewLattice,
    right: ViewLattice,
}

/// Rows and columns by which the places of the right view are behind those of the left one.
pub(crate) type Shift = (i32, i32);

impl<'a> TwoViews<'a> {
    /// The right view's rows are turned like the left one's.
    pub fn new(left: &'a ViewLattice, right: ViewLattice) -> Self {
        let right = right.turned_like(left);
        Self { left, right }
    }

    /// Shifts at which the views share enough markers.
    pub fn shifts(&self) -> Vec<Shift> {
        let (left, right) = (self.left.axial(), self.right.axial());
        let range = |left: usize, right: usize| -(right as i32)..=left as i32;
        let all = range(left.rows, right.rows)
            .flat_map(|down| range(left.cols, right.cols).map(move |aside| (down, aside)));
        let count = |sites: &Sites| sites.places().filter(|&place| sites.at(place).is_some()).count();
        let least = MIN_SHARED * count(left).min(count(right)) as f64;
        all.filter(|&shift| {
            let both = |place: &Place| left.at(*place).is_some() && right.at(back(*place, shift)).is_some();
            left.places().filter(both).count() as f64 >= least
        })
        .collect()
    }

    /// Up to `most` cells that both views show at this shift, spread over the print.
    pub fn cells(&self, shift: Shift, most: usize) -> Vec<SharedCell> {
        let (left, right) = (self.left.axial(), self.right.axial());
        let pair = |place: Place| Some([left.at(place)?, right.at(back(place, shift))?]);
        let cells: Vec<SharedCell> = left
            .places()
            .filter_map(|place| Some([pair(place)?, pair(place.step((0, 1)))?, pair(place.step((1, 0)))?]))
            .collect();
        let step = cells.len().div_ceil(most.max(1)).max(1);
        cells.into_iter().step_by(step).collect()
    }

    /// One rectangle of rows and columns in both views.
    pub fn label(
        &self,
        shift: Shift,
        lattice: &LatticeParams,
        max_off_pitches: f64,
    ) -> Result<[RestLattice; 2], LabelError> {
        self.left.check_shape(lattice, false)?;
        let (left, right) = (self.left.axial(), self.right.axial());
        let mut pairs: Vec<[Option<usize>; 2]> = Vec::new();
        // Places that at least one view shows, from the first row and column of either.
        let (top, aside) = (shift.0.min(0), shift.1.min(0));
        let extent = |left: usize, right: usize, shift: i32, first: i32| {
            ((left as i32).max(right as i32 + shift) - first) as usize
        };
        let rows = extent(left.rows, right.rows, shift.0, top);
        let mut all = Sites::empty(rows, extent(left.cols, right.cols, shift.1, aside));
        for place in all.places() {
            let at = place.step((top, aside));
            let pair = [left.at(at), right.at(back(at, shift))];
            if pair != [None; 2] {
                all.set(place, Some(pairs.len()));
                pairs.push(pair);
            }
        }
        // The first row is an odd one of the left view.
        let odd_rows_forward = self.left.odd_rows_forward().map(|forward| forward != (top % 2 != 0));
        if let Some(forward) = odd_rows_forward {
            all = offset(&all, forward);
        }
        let both = all.map(|k| if pairs[k].contains(&None) { None } else { Some(k) });
        let mut chosen = Window::choose(&both, usize::MAX, lattice, PartialBorders::LeaveOut)?;
        let (rows, cols) = without_strays(&all);
        chosen.left_out = chosen.window.beside_in(&rows, &cols);
        let complete = |view: &ViewLattice, side: usize| {
            view.complete(&all.map(|k| pairs[k][side]), &chosen, odd_rows_forward, max_off_pitches)
        };
        Ok([complete(self.left, 0)?, complete(&self.right, 1)?])
    }
}

/// Place in the right view of a place of the left one.
const fn back(place: Place, (down, aside): Shift) -> Place {
    place.step((-down, -aside))
}

impl ViewLattice {
    /// Places along two steps of the lattice.
    const fn axial(&self) -> &Sites {
        match &self.places {
            Places::Square(sites) => sites,
            Places::Hexagonal(named) => &named.sites,
        }
    }
}
