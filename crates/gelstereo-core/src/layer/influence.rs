//! Motion of the surface around a cell under a uniform traction.
//!
//! The layer's compliance is that of the half-space plus a remainder. The half-space term has a closed
//! form over a rectangle (pressure: Love 1929; shear: the same integrals, from Cerruti's solution). The
//! remainder decays as e^(-2kh) and is therefore smooth. Its Fourier integral is a Hankel integral,
//! which Gauss quadrature computes to round-off. Nothing is periodic: the layer is unbounded.

use super::kernel::Layer;
use crate::math::{asinh, atan, bessel_j0, bessel_j1, ceil, exp, ln, sqrt};
use alloc::vec::Vec;
use core::f64::consts::PI;

/// Motion at offsets (column, row) in cells, both from 0 to `side - 1`, row-major, for a traction of one
/// Young's modulus on the rectangular cell at 0. Negative offsets follow by symmetry.
#[derive(Clone, Debug)]
pub struct Influence {
    /// Number of offsets along each axis.
    pub side: usize,
    /// Into the layer under a pressure; even along both axes.
    pub normal: Vec<f64>,
    /// Along x and along y under a pressure; each odd along its own axis, even along the other.
    pub cross: [Vec<f64>; 2],
    /// Along x under a traction along x, and along y under one along y; even along both axes.
    pub along: [Vec<f64>; 2],
    /// Along y under a traction along x, and the reverse; odd along both axes.
    pub across: Vec<f64>,
}

impl Influence {
    /// For cells of sides `cell_mm` along x and y and offsets of up to `side` cells.
    pub fn new(layer: &Layer, cell_mm: [f64; 2], side: usize) -> Self {
        Self::overlapping(layer, cell_mm, [1, 1], side)
    }

    /// As [`Self::new`], for offsets in steps of `step_mm` and cells of `steps` of them: of two, cells at
    /// neighbouring offsets overlap by half.
    pub fn overlapping(layer: &Layer, step_mm: [f64; 2], steps: [usize; 2], side: usize) -> Self {
        let cell_mm = [0, 1].map(|axis| step_mm[axis] * steps[axis] as f64);
        Self::of_half_space(layer, step_mm, steps, side).with_rest(layer, step_mm, cell_mm, [0.0; 2])
    }

    /// As [`Self::new`], for cells of any sides, and offsets that are all shifted. Negative offsets do not
    /// follow by symmetry.
    pub(super) fn shifted(
        layer: &Layer,
        step_mm: [f64; 2],
        cell_mm: [f64; 2],
        shift_mm: [f64; 2],
        side: usize,
    ) -> Self {
        let over_cell = |row: usize, col: usize| {
            let at = |right: f64, down: f64| {
                integrals(
                    col as f64 * step_mm[0] + shift_mm[0] + right * cell_mm[0],
                    row as f64 * step_mm[1] + shift_mm[1] + down * cell_mm[1],
                )
            };
            [at(-0.5, -0.5), at(0.5, -0.5), at(-0.5, 0.5), at(0.5, 0.5)]
        };
        Self::of_corners(layer, side, over_cell).with_rest(layer, step_mm, cell_mm, shift_mm)
    }

    /// Adds the remainder.
    fn with_rest(mut self, layer: &Layer, step_mm: [f64; 2], cell_mm: [f64; 2], shift_mm: [f64; 2]) -> Self {
        let side = self.side;
        let rest = Radials::new(layer, cell_mm, side as f64 * step_mm[0].max(step_mm[1]));
        for (i, (row, col)) in (0..side).flat_map(|row| (0..side).map(move |col| (row, col))).enumerate() {
            let x = col as f64 * step_mm[0] + shift_mm[0];
            let y = row as f64 * step_mm[1] + shift_mm[1];
            for [aside, down] in squares(cell_mm) {
                self.add(i, (x + aside, y + down), &rest);
            }
        }
        self
    }

    /// Adds the remainder of one of the squares of a cell.
    fn add(&mut self, i: usize, (x, y): (f64, f64), rest: &Radials) {
        let r = sqrt(x * x + y * y);
        let Radial { normal, cross, mean, split } = rest.at(r);
        let (cosine, sine) = if r > 0.0 { (x / r, y / r) } else { (0.0, 0.0) };
        let (double_cosine, double_sine) = (cosine * cosine - sine * sine, 2.0 * cosine * sine);
        self.normal[i] += normal;
        self.cross[0][i] += cross * cosine;
        self.cross[1][i] += cross * sine;
        self.along[0][i] += mean - split * double_cosine;
        self.along[1][i] += mean + split * double_cosine;
        self.across[i] -= split * double_sine;
    }

    fn of_half_space(layer: &Layer, step_mm: [f64; 2], steps: [usize; 2], side: usize) -> Self {
        let [width, height] = steps.map(|steps| side + steps);
        let corners: Vec<[f64; 5]> = (0..width * height)
            .map(|i| {
                let corner = |n: usize, axis: usize| (n as f64 - 0.5 * steps[axis] as f64) * step_mm[axis];
                integrals(corner(i % width, 0), corner(i / width, 1))
            })
            .collect();
        let over_cell = |row: usize, col: usize| {
            let at = |row: usize, col: usize| corners[row * width + col];
            let (right, below) = (col + steps[0], row + steps[1]);
            [at(row, col), at(row, right), at(below, col), at(below, right)]
        };
        Self::of_corners(layer, side, over_cell)
    }

    /// From the integrals at the corners of the cell that is in a row and column, row by row.
    fn of_corners(layer: &Layer, side: usize, corners: impl Fn(usize, usize) -> [[f64; 5]; 4]) -> Self {
        let nu = layer.poisson_ratio;
        let over_cell = |row: usize, col: usize| {
            let [a, b, c, d] = corners(row, col);
            // Rows and columns round alike.
            let along_x = [0, 1, 2, 3, 4].map(|n| (d[n] - b[n]) - (c[n] - a[n]));
            [along_x, [0, 1, 2, 3, 4].map(|n| (d[n] - c[n]) - (b[n] - a[n]))]
        };
        let pressed = (1.0 - nu * nu) / PI;
        let aside = -(1.0 + nu) * (1.0 - 2.0 * nu) / (2.0 * PI);
        let sheared = (1.0 + nu) / PI;
        let [mut normal, mut across] = [Vec::new(), Vec::new()];
        let [mut cross, mut along] = [(); 2].map(|()| [Vec::new(), Vec::new()]);
        for i in 0..side * side {
            let sums = over_cell(i / side, i % side);
            normal.push(pressed * (sums[0][0] + sums[0][1]));
            across.push(sheared * nu * sums[0][2]);
            for (axis, sums) in sums.into_iter().enumerate() {
                cross[axis].push(aside * sums[3 + axis]);
                // (1 + ν) / (π r) ((1 - ν) + ν cos²), Cerruti.
                along[axis].push(sheared * ((1.0 - nu) * (sums[0] + sums[1]) + nu * sums[axis]));
            }
        }
        Self { side, normal, cross, along, across }
    }
}

/// Integrals over the rectangle from the origin to (x, y) of x²/r³, y²/r³, xy/r³, x/r² and y/r².
fn integrals(x: f64, y: f64) -> [f64; 5] {
    let r2 = x * x + y * y;
    // An edge of a cell may lie above the point, where the quotient is not finite and the product 0.
    let over = |a: f64, b: f64| if a == 0.0 { 0.0 } else { a * asinh(b / a.abs()) };
    let angle = |a: f64, b: f64| if a == 0.0 { 0.0 } else { a * atan(b / a) };
    [
        over(y, x),
        over(x, y),
        // Without terms that cancel over the four corners of a cell.
        -sqrt(r2),
        0.5 * y * ln(r2) + angle(x, y),
        0.5 * x * ln(r2) + angle(y, x),
    ]
}

/// Centres, from that of the cell, of the squares that stand for it in the remainder: itself, or two
/// beside each other with the same variances.
fn squares([width, height]: [f64; 2]) -> impl Iterator<Item = [f64; 2]> {
    let apart = sqrt((width * width - height * height).abs() / 12.0);
    let [aside, down] = if width > height { [apart, 0.0] } else { [0.0, apart] };
    [[aside, down], [-aside, -down]].into_iter().take(if apart > 0.0 { 2 } else { 1 })
}

/// The remainder's integrals at one distance: pressure to depth, pressure to outward motion, and shear
/// to motion along it, split into the mean over directions and the term in twice the angle.
#[derive(Clone, Copy, Debug, Default)]
struct Radial {
    normal: f64,
    cross: f64,
    mean: f64,
    split: f64,
}

impl Radial {
    fn add(&mut self, other: &Self, weight: f64) {
        self.normal += weight * other.normal;
        self.cross += weight * other.cross;
        self.mean += weight * other.mean;
        self.split += weight * other.split;
    }
}

/// The remainder's integrals at equal steps of distance, starting slightly below 0, where they are even
/// or odd.
struct Radials {
    step_mm: f64,
    values: Vec<Radial>,
}

/// Points of the interpolating polynomial, half of them on either side.
const POINTS: usize = 10;

/// In units of the layer's thickness. Waves k contribute k³ h² e^(-2kh). The error of a polynomial
/// through ten points a step d apart is (kd)^10 872 / 10! of that: 1e-13 of the whole.
const STEP: f64 = 0.045;

impl Radials {
    /// For offsets of up to this length along both axes.
    fn new(layer: &Layer, cell_mm: [f64; 2], reach_mm: f64) -> Self {
        let hankel = Hankel::new(layer, cell_mm, reach_mm);
        let step_mm = STEP * layer.thickness_mm;
        let count = ceil(core::f64::consts::SQRT_2 * reach_mm / step_mm) as usize + POINTS;
        let at = |i: usize| hankel.at((i as f64 - (POINTS / 2 - 1) as f64) * step_mm);
        Self { step_mm, values: (0..count).map(at).collect() }
    }

    /// Lagrange interpolation around a distance.
    fn at(&self, r_mm: f64) -> Radial {
        let steps = r_mm / self.step_mm;
        let first = (steps as usize).min(self.values.len() - POINTS);
        let t = steps - first as f64 + (POINTS / 2 - 1) as f64;
        let mut sum = Radial::default();
        for (i, value) in self.values[first..][..POINTS].iter().enumerate() {
            let others = (0..POINTS).filter(|&j| j != i);
            let weight = others.map(|j| (t - j as f64) / (i as f64 - j as f64)).product();
            sum.add(value, weight);
        }
        sum
    }
}

/// Nodes of the remainder's Hankel integrals: wave number, and factors of the Bessel functions.
struct Hankel(Vec<(f64, Radial)>);

/// Gauss-Legendre nodes and weights with eight points on -1 to 1, the positive half.
const GAUSS: [[f64; 2]; 4] = [
    [0.1834346424956498, 0.362683783378362],
    [0.525532409916329, 0.31370664587788727],
    [0.7966664774136267, 0.22238103445337448],
    [0.9602898564975363, 0.10122853629037626],
];

/// Upper limit of k h, where (k h)² e^(-2 k h) is 3e-12.
const LAST: f64 = 16.0;

impl Hankel {
    /// Of one of the [`squares`] of a cell, with its share of the traction.
    fn new(layer: &Layer, [width, height]: [f64; 2], reach_mm: f64) -> Self {
        let h = layer.thickness_mm;
        let side = width.min(height);
        let share = 1.0 / squares([width, height]).count() as f64;
        // The panel half-width keeps the argument of the farthest Bessel function within two radians,
        // and the layer's poles (the nearest at 0.74i) 3 half-widths away. Eight points then leave
        // 1e-12.
        let panels = ceil((LAST / 0.5).max(LAST * 1.5 * reach_mm / h / 4.0)) as usize;
        let half = 0.5 * LAST / panels as f64;
        let node = |panel: usize, at: f64, weight: f64| {
            let k = ((2 * panel + 1) as f64 + at) * half / h;
            // Square instead of a point: sin a / a sin b / b = e^(-(a² + b²) / 6) to fourth order,
            // a = k_x side / 2.
            let smooth = exp(-k * k * side * side / 24.0);
            let weight = weight * half / h * k * smooth * width * height * share / (2.0 * PI);
            let (layered, deep) = (layer.compliance(k), layer.half_space(k));
            let in_plane = layered.in_plane_mm - deep.in_plane_mm;
            let anti_plane = layered.anti_plane_mm - deep.anti_plane_mm;
            let radial = Radial {
                normal: weight * (layered.normal_mm - deep.normal_mm),
                cross: weight * (layered.cross_mm - deep.cross_mm),
                mean: 0.5 * weight * (in_plane + anti_plane),
                split: 0.5 * weight * (in_plane - anti_plane),
            };
            (k, radial)
        };
        let points = GAUSS.iter().flat_map(|&[at, weight]| [(-at, weight), (at, weight)]);
        Self((0..panels).flat_map(|panel| points.clone().map(move |(at, w)| node(panel, at, w))).collect())
    }

    fn at(&self, r_mm: f64) -> Radial {
        let mut sum = Radial::default();
        for (k, weight) in &self.0 {
            let z = k * r_mm;
            let (zeroth, first) = (bessel_j0(z), bessel_j1(z));
            let second = if z != 0.0 { 2.0 * first / z - zeroth } else { 0.0 };
            sum.normal += weight.normal * zeroth;
            sum.cross += weight.cross * first;
            sum.mean += weight.mean * zeroth;
            sum.split += weight.split * second;
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{cos, sin};

    /// At and between the tabulated distances, for thick and thin layers: 1e-12 of the largest, ten
    /// times the estimated error.
    #[test]
    fn polynomials_between_distances_are_the_integrals() {
        for (thickness_mm, cell_mm, side) in [(5.0, 0.45, 64), (1.0, 1.0, 16), (20.0, 0.2, 32)] {
            let layer = Layer { thickness_mm, poisson_ratio: 0.48 };
            let reach_mm = side as f64 * cell_mm;
            let (radials, hankel) =
                (Radials::new(&layer, [cell_mm; 2], reach_mm), Hankel::new(&layer, [cell_mm; 2], reach_mm));
            let all = |Radial { normal, cross, mean, split }: Radial| [normal, cross, mean, split];
            let scale = all(hankel.at(0.0)).into_iter().fold(0.0, |largest: f64, x| largest.max(x.abs()));
            for k in 0..400 {
                let r_mm = core::f64::consts::SQRT_2 * reach_mm * f64::from(k) / 400.0;
                for (found, expected) in all(radials.at(r_mm)).into_iter().zip(all(hankel.at(r_mm))) {
                    assert!((found - expected).abs() < 1e-12 * scale, "{r_mm}: {found} {expected}");
                }
            }
        }
    }

    /// A cell of three steps is three cells of one beside each other, and one of two is that of a table with
    /// half as many offsets. The remainder's Gaussian approximation leaves 2e-5 of it.
    #[test]
    fn overlapping_cells_are_sums_of_cells() {
        let layer = Layer { thickness_mm: 2.0, poisson_ratio: 0.48 };
        let (step_mm, side) = ([0.25, 0.4], 12);
        let single = Influence::new(&layer, step_mm, side + 1);
        let three = Influence::overlapping(&layer, step_mm, [3, 1], side);
        let two = Influence::overlapping(&layer, step_mm, [2, 1], side);
        let wide = Influence::new(&layer, [0.5, 0.4], side);
        let scale = single.normal[0];
        let close = |found: [[f64; 3]; 3], expected: [[f64; 3]; 3]| {
            let pairs = found.iter().flatten().zip(expected.iter().flatten());
            pairs.for_each(|(a, b)| assert!((a - b).abs() < 1e-4 * scale, "{a} {b}"));
        };
        for (row, col) in (0..side as isize).flat_map(|row| (0..side as isize).map(move |col| (row, col))) {
            let beside = [-1, 0, 1].map(|k| single.effect(col + k, row));
            let sum =
                core::array::from_fn(|i| core::array::from_fn(|k| beside.iter().map(|e| e[i][k]).sum()));
            close(three.effect(col, row), sum);
            if col % 2 == 0 {
                close(two.effect(col, row), wide.effect(col / 2, row));
            }
        }
    }

    /// Under a wave of tractions, the sum over the cells equals the layer's compliance. A sampled wave
    /// includes all its aliases, each times the transform of a cell. Both are known. What remains is the
    /// truncation of the sum (e^(-0.74 * 24) = 2e-8 of the nearest pole) and the Gaussian approximation
    /// of a cell: a⁴/180 = 2e-5 of the remainder at a = k cell / 2 = 1/4.
    #[test]
    fn cells_add_up_to_the_compliance_of_a_wave() {
        let ratios = [0.0, 0.3, 0.48, 0.5].into_iter();
        let cells = [[0.5, 0.5], [0.5, 0.4], [0.4, 0.5]];
        for (poisson_ratio, cells) in ratios.flat_map(|nu| cells.map(|cell| (nu, cell))) {
            let layer = Layer { thickness_mm: 2.0, poisson_ratio };
            let (cell, side) = (cells[0], 120);
            let influence = Influence::new(&layer, cells, side);
            for k in [0.0, 0.3, 1.0, 2.0] {
                let wave = |m: i32| k + 2.0 * PI * f64::from(m) / cell;
                let sinc = |q: f64| if q == 0.0 { 1.0 } else { sin(0.5 * q * cell) / (0.5 * q * cell) };
                let aliased =
                    |of: &dyn Fn(f64) -> f64| (-400..=400).map(|m| of(wave(m)) * sinc(wave(m))).sum::<f64>();
                let (mut normal, mut cross, mut along, mut across) = (0.0, 0.0, 0.0, 0.0);
                for i in 0..side * side {
                    let (row, col) = (i / side, i % side);
                    let copies = if row == 0 { 1.0 } else { 2.0 } * if col == 0 { 1.0 } else { 2.0 };
                    let phase = k * col as f64 * cell;
                    normal += copies * influence.normal[i] * cos(phase);
                    along += copies * influence.along[0][i] * cos(phase);
                    across += copies * influence.along[1][i] * cos(phase);
                    // Σ V(x) e^(-ikx) is -i times the cross term.
                    cross += copies * influence.cross[0][i] * sin(phase);
                }
                let at = |q: f64| layer.compliance(q.abs());
                let close = |found: f64, expected: f64| {
                    let scale = at(k).normal_mm.max(0.1);
                    assert!(
                        (found - expected).abs() < 3e-5 * scale,
                        "{poisson_ratio} {k}: {found} {expected}"
                    );
                };
                close(normal, aliased(&|q| at(q).normal_mm));
                close(along, aliased(&|q| at(q).in_plane_mm));
                close(across, aliased(&|q| at(q).anti_plane_mm));
                close(cross, aliased(&|q| at(q).cross_mm * if q < 0.0 { -1.0 } else { 1.0 }));
            }
        }
    }
}
