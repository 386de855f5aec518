//! The shape of a lattice's cells: at right angles, or hexagonal.
//!
//! Two steps a and b of a lattice are the complex number z = b / a, up to the choice of the steps (the
//! modular group) and the lattice's size and turn. An affine map whose larger stretch is e^d times the
//! smaller one moves z by d in the hyperbolic plane. So the distance of z from a layout is the logarithm of
//! the stretch that a view must have for a print of that layout. Tilted by 40 degrees, a square print may
//! look like a hexagonal one that is tilted as much: there both are 0.27 away.

use super::found::{Place, Sites};
use crate::math::{DVec2, cosh, median, round, sqrt};
use alloc::vec::Vec;

/// Distance from right angles beyond which even a print with whole rows and columns is taken for a hexagonal
/// one, if that is nearer: the logarithm of a stretch by 1.5, as of a print tilted by 48 degrees. Rows of a
/// hexagonal print are 0.55 away.
const MAX_SLANTED: f64 = 0.405;

/// Most rounds of the reduction; each shortens the longer step.
const ROUNDS: usize = 32;

/// Hyperbolic cosines of the distances of a cell from the layouts.
#[derive(Clone, Copy, Debug)]
pub(super) struct CellShape {
    pub right_angled: f64,
    pub hexagonal: f64,
}

impl CellShape {
    /// Of a lattice with these steps; `None` if they span no plane.
    pub fn of(one: DVec2, other: DVec2) -> Option<Self> {
        let (a, b) = reduced(one, other);
        let area = a.perp_dot(b).abs();
        if !(area > 1e-9 * a.length_squared()) {
            return None;
        }
        // z = x + i y with 0 <= x <= 1/2 and |z| >= 1.
        let (x, y) = (a.dot(b).abs() / a.length_squared(), area / a.length_squared());
        let (to_x, to_y) = (0.5, 0.5 * sqrt(3.0));
        let off2 = (x - to_x) * (x - to_x) + (y - to_y) * (y - to_y);
        let slant = x / y;
        Some(Self { right_angled: sqrt(1.0 + slant * slant), hexagonal: 1.0 + off2 / (2.0 * y * to_y) })
    }

    /// The median shape of the cells of a lattice.
    pub fn usual(sites: &Sites, points: &[DVec2]) -> Option<Self> {
        let (mut right_angled, mut hexagonal) = (Vec::new(), Vec::new());
        for place in sites.places() {
            let at = |step: (i32, i32)| sites.at(place.step(step)).map(|m| points[m]);
            let (Some(here), Some(right), Some(below)) = (at((0, 0)), at((0, 1)), at((1, 0))) else {
                continue;
            };
            if let Some(shape) = Self::of(right - here, below - here) {
                right_angled.push(shape.right_angled);
                hexagonal.push(shape.hexagonal);
            }
        }
        Some(Self { right_angled: median(&mut right_angled)?, hexagonal: median(&mut hexagonal)? })
    }

    /// Whether the print is hexagonal. Where its rows and columns fill a rectangle (`is_whole`), a slanted
    /// view is more likely.
    pub fn is_hexagonal(&self, is_whole: bool) -> bool {
        let is_nearer = self.hexagonal < self.right_angled;
        is_nearer && (!is_whole || self.right_angled > cosh(MAX_SLANTED))
    }
}

/// The two shortest steps of the lattice of two steps (Lagrange's reduction), the shorter one first.
pub(super) fn reduced(mut a: DVec2, mut b: DVec2) -> (DVec2, DVec2) {
    for _ in 0..ROUNDS {
        if b.length_squared() < a.length_squared() {
            (a, b) = (b, a);
        }
        let times = round(a.dot(b) / a.length_squared());
        if times == 0.0 || !times.is_finite() {
            break;
        }
        b -= a * times;
    }
    (a, b)
}

impl Sites {
    /// All places, row by row.
    pub(super) fn places(&self) -> impl Iterator<Item = Place> + use<> {
        let (rows, cols) = (self.rows as i32, self.cols as i32);
        (0..rows).flat_map(move |row| (0..cols).map(move |col| Place::new(row, col)))
    }
}
