//! Which markers' stencils share heights.

use crate::lattice::{Offset, STEPS};

/// Stencils of `T` taps share heights with those of `A` other markers, of which `S - 1` are no mirror images.
/// All offsets are sorted by rows, then columns, of [`Topology::offset_from`](crate::lattice::Topology).
#[derive(Debug)]
pub(super) struct Sharing<const T: usize, const A: usize, const S: usize> {
    /// Marker and neighbours of a stencil.
    pub taps: [Offset; T],
    /// Index of each of them among the weights of a stencil: the marker, then before and after it along each
    /// axis.
    pub kinds: [usize; T],
    /// The other markers.
    pub around: [Offset; A],
    /// Index in `shared` of each of these offsets, or of its mirror image.
    pub own: [usize; A],
    /// Index in `shared` of the offset between two taps, the earlier one first.
    pub cross: [[usize; T]; T],
    /// Index in `shared` of the offset between two of `around`, the later one first; `S` for markers that
    /// share no height.
    pub pairs: [[usize; A]; A],
}

/// Of a square print.
pub(super) static SQUARE: Sharing<5, 12, 7> = Sharing::new(2);
/// Of a hexagonal print.
pub(super) static HEXAGONAL: Sharing<7, 18, 10> = Sharing::new(3);

impl<const T: usize, const A: usize, const S: usize> Sharing<T, A, S> {
    /// Of stencils with the neighbours along so many axes.
    const fn new(axes: usize) -> Self {
        let (taps, kinds) = taps::<T>(axes);
        let (mut around, mut shared) = ([(0, 0); A], [(0, 0); S]);
        let (mut of_around, mut of_shared, mut row) = (0, 0, -2);
        while row <= 2 {
            let mut col = -2;
            while col <= 2 {
                let is_own = row == 0 && col == 0;
                if is_difference(&taps, (row, col)) {
                    if !is_own {
                        around[of_around] = (row, col);
                        of_around += 1;
                    }
                    if row > 0 || row == 0 && col >= 0 {
                        shared[of_shared] = (row, col);
                        of_shared += 1;
                    }
                }
                col += 1;
            }
            row += 1;
        }
        assert!(of_around == A && of_shared == S);
        let own = to_others((0, 0), &around, &shared);
        let (mut cross, mut a) = ([[0; T]; T], 0);
        while a < T {
            cross[a] = to_others(taps[a], &taps, &shared);
            a += 1;
        }
        let (mut pairs, mut a) = ([[S; A]; A], 0);
        while a < A {
            pairs[a] = to_others(around[a], &around, &shared);
            a += 1;
        }
        Self { taps, kinds, around, own, cross, pairs }
    }
}

/// Sorted offsets of a stencil's taps, and the index of each in the order of its weights.
const fn taps<const T: usize>(axes: usize) -> ([Offset; T], [usize; T]) {
    let (mut taps, mut kinds, mut count, mut row) = ([(0, 0); T], [0; T], 0, -1);
    while row <= 1 {
        let mut col = -1;
        while col <= 1 {
            let (mut axis, mut kind) = (0, if row == 0 && col == 0 { Some(0) } else { None });
            while axis < axes {
                let (down, right) = STEPS[axis];
                if row == -down && col == -right {
                    kind = Some(2 * axis + 1);
                } else if row == down && col == right {
                    kind = Some(2 * axis + 2);
                }
                axis += 1;
            }
            if let Some(kind) = kind {
                (taps[count], kinds[count]) = ((row, col), kind);
                count += 1;
            }
            col += 1;
        }
        row += 1;
    }
    assert!(count == T);
    (taps, kinds)
}

/// Whether two taps are this far apart.
const fn is_difference<const T: usize>(taps: &[Offset; T], (row, col): Offset) -> bool {
    let mut a = 0;
    while a < T {
        let mut b = 0;
        while b < T {
            if taps[b].0 - taps[a].0 == row && taps[b].1 - taps[a].1 == col {
                return true;
            }
            b += 1;
        }
        a += 1;
    }
    false
}

/// Index in `shared` of the offset from one to each of the others, or of its mirror image; `S` if there is
/// none.
const fn to_others<const N: usize, const S: usize>(
    from: Offset,
    others: &[Offset; N],
    shared: &[Offset; S],
) -> [usize; N] {
    let (mut found, mut k) = ([S; N], 0);
    while k < N {
        let (row, col) = (others[k].0 - from.0, others[k].1 - from.1);
        let mut s = 0;
        while s < S {
            let (down, right) = shared[s];
            if row == down && col == right || row == -down && col == -right {
                found[k] = s;
            }
            s += 1;
        }
        k += 1;
    }
    found
}
