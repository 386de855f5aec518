//! The layer's compliance over a window of cells: a convolution with the influence of one cell.

use super::fft::{Complexes, Plane};
use alloc::vec::Vec;
use gelstereo_core::layer::Influence;

/// Convolutions over a window of `plane.rows` by `plane.cols` cells. The kernels are even or odd along
/// both axes, so their spectra are real or imaginary. They include the scale of the inverse transform.
#[derive(Clone, Debug)]
pub(crate) struct Operator {
    pub(crate) plane: Plane,
    normal: Vec<f64>,
    cross: [Vec<f64>; 2],
    /// Along x, along y, and the coupling between them.
    shear: [Vec<f64>; 3],
    /// Upper bounds of the largest eigenvalue of the normal and of the shear compliance, mm.
    pub(crate) stiffest: [f64; 2],
    /// Approximate inverse of the normal compliance, per mm: the cell, its neighbours across a side, and
    /// those across a corner.
    pub(crate) stencil: [f64; 3],
}

/// Buffers of the transforms.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scratch {
    pairs: Complexes,
    spectra: [Complexes; 3],
}

impl Operator {
    /// Both sides are powers of two, at most `influence.side`.
    pub(crate) fn new(influence: &Influence, [rows, cols]: [usize; 2]) -> Self {
        let plane = Plane::new(rows, cols);
        let kernels = Kernels { influence, plane: &plane, scratch: Scratch::default() };
        kernels.operator()
    }

    /// Motion into the layer under these pressures.
    pub(crate) fn sink(&self, pressure: &[f64], scratch: &mut Scratch, out_mm: &mut Vec<f64>) {
        let Scratch { pairs, spectra: [spectrum, ..] } = scratch;
        self.plane.forward(pressure, pairs, spectrum);
        for ((re, im), k) in spectrum.re.iter_mut().zip(&mut spectrum.im).zip(&self.normal) {
            (*re, *im) = (*re * k, *im * k);
        }
        self.plane.backward(spectrum, pairs, out_mm);
    }

    /// Sideways motion under these pressures.
    pub(crate) fn spread(&self, pressure: &[f64], scratch: &mut Scratch, out_mm: &mut [Vec<f64>; 2]) {
        let Scratch { pairs, spectra: [spectrum, product, _] } = scratch;
        self.plane.forward(pressure, pairs, spectrum);
        for (kernel, out_mm) in self.cross.iter().zip(out_mm) {
            product.zeros(spectrum.len());
            for (i, &k) in kernel.iter().enumerate() {
                (product.re[i], product.im[i]) = (-spectrum.im[i] * k, spectrum.re[i] * k);
            }
            self.plane.backward(product, pairs, out_mm);
        }
    }

    /// Motion into the layer under these tractions: the transpose of [`Self::spread`].
    pub(crate) fn lift(&self, traction: &[Vec<f64>; 2], scratch: &mut Scratch, out_mm: &mut Vec<f64>) {
        let Scratch { pairs, spectra: [x, y, sum] } = scratch;
        self.plane.forward(&traction[0], pairs, x);
        self.plane.forward(&traction[1], pairs, y);
        sum.zeros(x.len());
        for i in 0..sum.len() {
            let (k, l) = (self.cross[0][i], self.cross[1][i]);
            (sum.re[i], sum.im[i]) = (x.im[i] * k + y.im[i] * l, -x.re[i] * k - y.re[i] * l);
        }
        self.plane.backward(sum, pairs, out_mm);
    }

    /// Sideways motion under these tractions.
    pub(crate) fn shear(&self, traction: &[Vec<f64>; 2], scratch: &mut Scratch, out_mm: &mut [Vec<f64>; 2]) {
        let Scratch { pairs, spectra: [x, y, _] } = scratch;
        self.plane.forward(&traction[0], pairs, x);
        self.plane.forward(&traction[1], pairs, y);
        let [along, across, mixed] = &self.shear;
        for i in 0..x.len() {
            let (a, b, m) = (along[i], across[i], mixed[i]);
            (x.re[i], y.re[i]) = (a * x.re[i] + m * y.re[i], m * x.re[i] + b * y.re[i]);
            (x.im[i], y.im[i]) = (a * x.im[i] + m * y.im[i], m * x.im[i] + b * y.im[i]);
        }
        self.plane.backward(x, pairs, &mut out_mm[0]);
        self.plane.backward(y, pairs, &mut out_mm[1]);
    }
}

/// Spectra of the influence of one cell.
struct Kernels<'a> {
    influence: &'a Influence,
    plane: &'a Plane,
    scratch: Scratch,
}

/// An influence by its offset down and across, in cells.
fn by_offset(field: &[f64], side: usize) -> impl Fn(usize, usize) -> f64 + '_ {
    move |row, col| field[row * side + col]
}

/// Non-zero part of a spectrum.
#[derive(Clone, Copy)]
enum Part {
    Real,
    Imaginary,
}

impl Kernels<'_> {
    fn operator(mut self) -> Operator {
        let Influence { side, normal, cross, along, across } = self.influence;
        let even = |_: bool| 1.0;
        let odd = |negative: bool| if negative { -1.0 } else { 1.0 };
        let normal = self.spectrum(by_offset(normal, *side), even, even, Part::Real);
        let cross = [
            self.spectrum(by_offset(&cross[0], *side), even, odd, Part::Imaginary),
            self.spectrum(by_offset(&cross[1], *side), odd, even, Part::Imaginary),
        ];
        let shear = [
            self.spectrum(by_offset(&along[0], *side), even, even, Part::Real),
            self.spectrum(by_offset(&along[1], *side), even, even, Part::Real),
            self.spectrum(by_offset(across, *side), odd, odd, Part::Real),
        ];
        let cells = (4 * self.plane.rows * self.plane.cols) as f64;
        let peak = |spectrum: &[f64]| spectrum.iter().fold(0.0_f64, |peak, &x| peak.max(x.abs())) * cells;
        let stiffest = [peak(&normal), peak(&shear[0]).max(peak(&shear[1])) + peak(&shear[2])];
        let stencil = self.stencil(&normal, stiffest[0]);
        Operator { plane: self.plane.clone(), normal, cross, shear, stiffest, stencil }
    }

    /// Spectrum of a kernel given for non-negative offsets. `down` and `across` return its sign for
    /// negative ones.
    fn spectrum(
        &mut self,
        kernel: impl Fn(usize, usize) -> f64,
        down: impl Fn(bool) -> f64,
        across: impl Fn(bool) -> f64,
        part: Part,
    ) -> Vec<f64> {
        let (rows, cols) = (self.plane.rows, self.plane.cols);
        let Scratch { pairs, spectra: [spectrum, ..] } = &mut self.scratch;
        let wrapped = |row: usize, col: usize| {
            // No two cells of the window are half the padded size apart.
            if row == rows || col == cols {
                return 0.0;
            }
            let (before, left) = (row > rows, col > cols);
            let (r, c) = (if before { 2 * rows - row } else { row }, if left { 2 * cols - col } else { col });
            kernel(r, c) * down(before) * across(left)
        };
        self.plane.forward_of(wrapped, [2 * rows, 2 * cols], pairs, spectrum);
        let scale = 1.0 / (4 * rows * cols) as f64;
        let found = match part {
            Part::Real => &spectrum.re,
            Part::Imaginary => &spectrum.im,
        };
        found.iter().map(|x| x * scale).collect()
    }

    /// Centre of the inverse kernel, which decays with the cube of the distance. If the centre alone is
    /// not positive definite, only a diagonal is used.
    fn stencil(&mut self, normal: &[f64], stiffest: f64) -> [f64; 3] {
        let (rows, cols) = (self.plane.rows, self.plane.cols);
        let cells = (4 * rows * cols) as f64;
        let Scratch { pairs, spectra: [spectrum, ..] } = &mut self.scratch;
        spectrum.zeros(normal.len());
        for (inverse, &k) in spectrum.re.iter_mut().zip(normal) {
            *inverse = 1.0 / (k * cells).max(1e-3 * stiffest);
        }
        let mut field = Vec::new();
        self.plane.backward(spectrum, pairs, &mut field);
        let [cell, side, other, corner] =
            [field[0], field[1], field[cols], field[cols + 1]].map(|x| x / cells);
        let side = 0.5 * (side + other);
        // Extremes of cell + 2 side (cos a + cos b) + 4 corner cos a cos b.
        let ends = [cell + 4.0 * (side + corner), cell - 4.0 * corner, cell - 4.0 * (side - corner)];
        if ends.iter().all(|&end| end > 0.0) { [cell, side, corner] } else { [1.0 / stiffest, 0.0, 0.0] }
    }
}
