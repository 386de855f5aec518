//! What is known of how the markers of a print are laid out, with the row and column of every one.

use super::LatticeFinder;
use super::cells::CellShape;
use super::found::{FoundLattice, Place, Sites};
use super::hexagonal::{HexagonalSites, offset, without_strays};
use super::layout::{Layout, MIN_MARKERS, MIN_RECTANGULAR, usual_distance};
use super::view_lattice::at_right_angles;
use crate::math::{DVec2, abs, acos};
use alloc::vec::Vec;

/// Of the markers, this share must be on the lattice; of random dots, less than a third is.
const MIN_ON_LATTICE: f64 = 0.6;

/// How the markers of a print are laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LayoutKind {
    /// Rows and columns at right angles, of one spacing.
    Square,
    /// Rows and columns at right angles, of two spacings.
    Rectangular,
    /// Six neighbours at one distance.
    Hexagonal,
    /// None of these.
    Irregular,
}

/// The layout of the markers in an image.
#[derive(Clone, Debug, PartialEq)]
pub struct PrintDescription {
    /// Layout.
    pub kind: LayoutKind,
    /// Mean steps along a row, and to the next row: along a column or, in a hexagonal print, down to the
    /// right. Both are the usual distance of neighbours, along x and y, where the layout is irregular.
    pub steps_px: [DVec2; 2],
    /// Share of the markers that are on the lattice.
    pub on_lattice: f64,
    /// Rows that are seen; 0 if the layout is irregular. Those of a few stray markers do not count.
    pub rows: usize,
    /// Columns that are seen.
    pub cols: usize,
    /// Share of the places of these rows and columns that show a marker.
    pub filled: f64,
    /// The same of the upper row, the lower row, the left column and the right column.
    pub borders: [f64; 4],
    /// Row and column of every marker; `None` off the lattice.
    pub places: Vec<Option<Place>>,
}

impl PrintDescription {
    /// Describes markers in an image. Perspective, a bent gel and a turned camera do not matter, as steps are
    /// compared with those beside them.
    #[must_use]
    pub fn of(points: &[DVec2]) -> Self {
        let (mut finder, mut found) = (LatticeFinder::default(), FoundLattice::default());
        if points.len() < MIN_MARKERS {
            return Self::irregular(points);
        }
        if finder.run_slanted(points, &mut found).is_err() {
            return Self::irregular(points);
        }
        let sites = found.sites();
        let is_hexagonal = CellShape::usual(&sites, points).is_some_and(|shape| shape.is_hexagonal(false));
        let is_most = |found: &FoundLattice| found.placed as f64 >= MIN_ON_LATTICE * points.len() as f64;
        if !is_hexagonal && !is_most(&found) {
            return Self::irregular(points);
        }
        if !is_hexagonal {
            let steps_px = [found.row_step_px, found.col_step_px];
            let (one, other) = (steps_px[0].length(), steps_px[1].length());
            let is_square = one.max(other) < MIN_RECTANGULAR * one.min(other);
            let kind = if is_square { LayoutKind::Square } else { LayoutKind::Rectangular };
            return Self::on(kind, steps_px, &sites, points.len());
        }
        let result = finder.run_with_specks(&at_right_angles(&found, points), &mut found);
        let named =
            if result.is_ok() && is_most(&found) { HexagonalSites::of(&found, points, None) } else { None };
        let Some(named) = named else { return Self::irregular(points) };
        let steps_px = [named.row_step_px, named.next_row_px];
        let shown = offset(&named.sites, named.odd_rows_forward);
        Self::on(LayoutKind::Hexagonal, steps_px, &shown, points.len())
    }

    fn on(kind: LayoutKind, steps_px: [DVec2; 2], sites: &Sites, markers: usize) -> Self {
        let (rows, cols) = without_strays(sites);
        let (top, left) = (rows.start, cols.start);
        let mut places = alloc::vec![None; markers];
        let (mut placed, mut kept) = (0, Vec::new());
        for place in sites.places() {
            let Some(m) = sites.at(place) else { continue };
            placed += 1;
            if rows.contains(&place.row) && cols.contains(&place.col) {
                let place = place.step((-top, -left));
                places[m] = Some(place);
                kept.push(place);
            }
        }
        let (rows, cols) = (rows.len(), cols.len());
        let share = |on: &dyn Fn(&Place) -> bool, of: usize| {
            kept.iter().filter(|place| on(place)).count() as f64 / of.max(1) as f64
        };
        let (last_row, last_col) = (rows as i32 - 1, cols as i32 - 1);
        Self {
            kind,
            steps_px,
            on_lattice: f64::from(placed) / markers as f64,
            rows,
            cols,
            filled: share(&|_| true, rows * cols),
            borders: [
                share(&|place| place.row == 0, cols),
                share(&|place| place.row == last_row, cols),
                share(&|place| place.col == 0, rows),
                share(&|place| place.col == last_col, rows),
            ],
            places,
        }
    }

    /// Without rows and columns. A print whose neighbours tell its layout has that, nevertheless.
    fn irregular(points: &[DVec2]) -> Self {
        let (kind, across_px, down_px) = match Layout::of(points) {
            Some(Layout::Rectangular { short_px, long_px }) => (LayoutKind::Rectangular, short_px, long_px),
            _ => {
                let usual_px = usual_distance(points).unwrap_or(f64::NAN);
                (LayoutKind::Irregular, usual_px, usual_px)
            }
        };
        Self {
            kind,
            steps_px: [DVec2::X * across_px, DVec2::Y * down_px],
            on_lattice: 0.0,
            rows: 0,
            cols: 0,
            filled: 0.0,
            borders: [0.0; 4],
            places: alloc::vec![None; points.len()],
        }
    }

    /// Angle between both steps, from 0 to 90 degrees.
    #[must_use]
    pub fn angle_deg(&self) -> f64 {
        let [row, next] = self.steps_px;
        acos((abs(row.dot(next)) / (row.length() * next.length())).min(1.0)).to_degrees()
    }
}
