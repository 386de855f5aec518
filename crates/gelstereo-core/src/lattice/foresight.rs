//! Foresight sort, Algorithm 1 of the paper.

use super::{LabelError, check_regular};
use crate::math::DVec2;
use alloc::vec::Vec;
use core::cmp::Ordering;

/// Algorithm 1: writes into `order` the permutation that sorts `positions_px` row by row, left to right.
/// The lattice has N = rows x cols markers; `tolerance_px` is l. Does not allocate once `order` has held
/// N.
///
/// Markers are sorted by ordinate. Then, row by row, the first 2 cols of the remaining markers form the
/// foresight space. A marker of it joins the row when its abscissa is at least l from that of every
/// marker already in the row, until the row is full.
///
/// The printed algorithm contains slips, resolved as follows:
/// - its loops start at 1 over arrays counted from 0 (`S[0]` would be skipped, and with R empty the
///   comparison with `R[0]` too): here they start at 0;
/// - `i < 2r` runs past the end when fewer than 2r markers remain: the foresight space is what remains,
///   at most 2r;
/// - a row leaves the foresight space in the order of its ordinates, although T' is to run from left to
///   right: here each row is sorted by abscissa;
/// - the last row is appended unchanged: here it must meet the same rule of l, and is sorted as well;
/// - a row that does not fill continues with fewer markers, which makes all rows below it wrong: here
///   that is [`LabelError::RowNotFilled`];
/// - ties of coordinates are left to the sorting routine: here they are broken by the other coordinate,
///   then by the index.
///
/// The paper does not check the result; from about 5 degrees of rotation it can be wrong although all
/// rows fill. Here a marker farther than l from the midpoint of its neighbours is
/// [`LabelError::Irregular`].
///
/// # Errors
/// [`LabelError`] when the count is off, a position is not finite, a row does not fill, or the result is
/// not a lattice.
pub fn foresight_sort(
    positions_px: &[DVec2],
    rows: usize,
    cols: usize,
    tolerance_px: f64,
    order: &mut Vec<usize>,
) -> Result<(), LabelError> {
    order.clear();
    let expected = rows.saturating_mul(cols);
    if positions_px.len() != expected {
        return Err(LabelError::Count { found: positions_px.len(), expected, max_missing: 0 });
    }
    if let Some(index) = positions_px.iter().position(|p| !p.is_finite()) {
        return Err(LabelError::NotFinite { index });
    }
    order.extend(0..positions_px.len());
    order.sort_unstable_by(|&a, &b| by_y(positions_px, a, b));
    for row in 0..rows {
        let left = &mut order[row * cols..];
        let space = left.len().min(2 * cols);
        let found = extract_row(positions_px, &mut left[..space], cols, tolerance_px);
        if found < cols {
            return Err(LabelError::RowNotFilled { row, found, expected: cols });
        }
        left[..cols].sort_unstable_by(|&a, &b| by_x(positions_px, a, b));
    }
    check_regular(rows, cols, tolerance_px, |row, col| Some(positions_px[order[row * cols + col]]))
}

/// Moves the markers of one row to the front of the foresight space and keeps the order of the others.
/// Returns the number moved, at most `cols`.
fn extract_row(positions_px: &[DVec2], space: &mut [usize], cols: usize, tolerance_px: f64) -> usize {
    let mut found = 0;
    for i in 0..space.len() {
        if found == cols {
            break;
        }
        let x = positions_px[space[i]].x;
        if space[..found].iter().all(|&joined| (x - positions_px[joined].x).abs() >= tolerance_px) {
            space[found..=i].rotate_right(1);
            found += 1;
        }
    }
    found
}

fn by_y(p: &[DVec2], a: usize, b: usize) -> Ordering {
    p[a].y.total_cmp(&p[b].y).then(p[a].x.total_cmp(&p[b].x)).then(a.cmp(&b))
}

fn by_x(p: &[DVec2], a: usize, b: usize) -> Ordering {
    p[a].x.total_cmp(&p[b].x).then(p[a].y.total_cmp(&p[b].y)).then(a.cmp(&b))
}
