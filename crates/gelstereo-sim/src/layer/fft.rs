//! Fourier transforms of real fields padded to twice their sides, for convolution.
//!
//! Each one-dimensional transform runs over the slow index of an array. The fast index counts
//! independent signals, so the inner loops are plain and contiguous. Frequencies stay in the order of
//! the decimation in frequency. A product of spectra needs no other order, and the inverse, a decimation
//! in time, starts from it (Gentleman and Sande 1966; Cooley and Tukey 1965).

use alloc::vec::Vec;
use core::f64::consts::PI;
use gelstereo_core::math::{cos, sin};

/// Complex numbers as two lists.
#[derive(Clone, Debug, Default)]
pub(crate) struct Complexes {
    pub(crate) re: Vec<f64>,
    pub(crate) im: Vec<f64>,
}

impl Complexes {
    /// Resets to `count` zeros.
    pub(crate) fn zeros(&mut self, count: usize) {
        for part in [&mut self.re, &mut self.im] {
            part.clear();
            part.resize(count, 0.0);
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.re.len()
    }
}

/// A transform of one length, a power of two.
#[derive(Clone, Debug)]
struct Line {
    length: usize,
    /// e^(-2πi j / length) for j below half the length.
    turns: Vec<[f64; 2]>,
    /// Index of each frequency after [`Self::forward`].
    place: Vec<usize>,
}

impl Line {
    fn new(length: usize) -> Self {
        let turn = |j: usize| 2.0 * PI * j as f64 / length as f64;
        let bits = length.trailing_zeros();
        let place = |k: usize| if bits == 0 { 0 } else { k.reverse_bits() >> (usize::BITS - bits) };
        Self {
            length,
            turns: (0..length / 2).map(|j| [cos(turn(j)), -sin(turn(j))]).collect(),
            place: (0..length).map(place).collect(),
        }
    }

    /// Σ x e^(-2πi j k / length) of `count` signals; sample j of signal s is at `j * count + s`. Radix 4
    /// halves the passes over memory.
    fn forward(&self, x: &mut Complexes, count: usize) {
        let mut span = self.length;
        while span >= 4 {
            let quarter = span / 4;
            let step = self.length / span;
            for block in (0..self.length).step_by(span) {
                for j in 0..quarter {
                    let turns = [1, 2, 3].map(|m| self.turn(m * j * step));
                    let rows = [0, 1, 2, 3].map(|m| (block + m * quarter + j) * count);
                    decimate_frequency(
                        rows_of(&mut x.re, rows, count),
                        rows_of(&mut x.im, rows, count),
                        turns,
                    );
                }
            }
            span = quarter;
        }
        if span == 2 {
            self.pairs(x, count);
        }
    }

    /// Inverse of [`Self::forward`], without the factor 1 / `length`.
    fn backward(&self, x: &mut Complexes, count: usize) {
        let odd = self.length.trailing_zeros() % 2 == 1;
        if odd {
            self.pairs(x, count);
        }
        let mut span = if odd { 8 } else { 4 };
        while span <= self.length {
            let quarter = span / 4;
            let step = self.length / span;
            for block in (0..self.length).step_by(span) {
                for j in 0..quarter {
                    let turns = [1, 2, 3].map(|m| self.turn(m * j * step));
                    let rows = [0, 1, 2, 3].map(|m| (block + m * quarter + j) * count);
                    decimate_time(rows_of(&mut x.re, rows, count), rows_of(&mut x.im, rows, count), turns);
                }
            }
            span *= 4;
        }
    }

    /// e^(-2πi j / length) for j below the length.
    fn turn(&self, j: usize) -> [f64; 2] {
        let half = self.turns.len();
        if j < half { self.turns[j] } else { self.turns[j - half].map(|x| -x) }
    }

    fn pairs(&self, x: &mut Complexes, count: usize) {
        for part in [&mut x.re, &mut x.im] {
            for pair in part.chunks_exact_mut(2 * count) {
                let (a, b) = pair.split_at_mut(count);
                for (a, b) in a.iter_mut().zip(b) {
                    (*a, *b) = (*a + *b, *a - *b);
                }
            }
        }
    }
}

/// Four rows of a list, `starts` ascending and at least `count` apart.
fn rows_of(list: &mut [f64], starts: [usize; 4], count: usize) -> [&mut [f64]; 4] {
    let (low, high) = list.split_at_mut(starts[2]);
    let (a, b) = low.split_at_mut(starts[1]);
    let (c, d) = high.split_at_mut(starts[3] - starts[2]);
    [&mut a[starts[0]..starts[0] + count], &mut b[..count], &mut c[..count], &mut d[..count]]
}

fn times([a, b]: [f64; 2], [c, d]: [f64; 2]) -> [f64; 2] {
    [a * c - b * d, a * d + b * c]
}

/// Radix-4 step in frequency: the even half first, then the odd one, each halved again.
fn decimate_frequency(re: [&mut [f64]; 4], im: [&mut [f64]; 4], turns: [[f64; 2]; 3]) {
    let ([ar, br, cr, dr], [ai, bi, ci, di]) = (re, im);
    let count = ar.len();
    let (br, cr, dr) = (&mut br[..count], &mut cr[..count], &mut dr[..count]);
    let (ai, bi) = (&mut ai[..count], &mut bi[..count]);
    let (ci, di) = (&mut ci[..count], &mut di[..count]);
    let [one, two, three] = turns;
    for s in 0..count {
        let (even, odd) = ([ar[s] + cr[s], ai[s] + ci[s]], [br[s] + dr[s], bi[s] + di[s]]);
        let (low, high) = ([ar[s] - cr[s], ai[s] - ci[s]], [bi[s] - di[s], dr[s] - br[s]]);
        (ar[s], ai[s]) = (even[0] + odd[0], even[1] + odd[1]);
        [br[s], bi[s]] = times([even[0] - odd[0], even[1] - odd[1]], two);
        [cr[s], ci[s]] = times([low[0] + high[0], low[1] + high[1]], one);
        [dr[s], di[s]] = times([low[0] - high[0], low[1] - high[1]], three);
    }
}

/// Inverse of [`decimate_frequency`], without the factor 1/4.
fn decimate_time(re: [&mut [f64]; 4], im: [&mut [f64]; 4], turns: [[f64; 2]; 3]) {
    let ([ar, br, cr, dr], [ai, bi, ci, di]) = (re, im);
    let count = ar.len();
    let (br, cr, dr) = (&mut br[..count], &mut cr[..count], &mut dr[..count]);
    let (ai, bi) = (&mut ai[..count], &mut bi[..count]);
    let (ci, di) = (&mut ci[..count], &mut di[..count]);
    let [one, two, three] = turns.map(|[c, s]| [c, -s]);
    for s in 0..count {
        let b = times([br[s], bi[s]], two);
        let (c, d) = (times([cr[s], ci[s]], one), times([dr[s], di[s]], three));
        let (even, odd) = ([ar[s] + b[0], ai[s] + b[1]], [ar[s] - b[0], ai[s] - b[1]]);
        let (low, high) = ([c[0] + d[0], c[1] + d[1]], [d[1] - c[1], c[0] - d[0]]);
        (ar[s], ai[s]) = (even[0] + low[0], even[1] + low[1]);
        (cr[s], ci[s]) = (even[0] - low[0], even[1] - low[1]);
        (br[s], bi[s]) = (odd[0] + high[0], odd[1] + high[1]);
        (dr[s], di[s]) = (odd[0] - high[0], odd[1] - high[1]);
    }
}

/// Transforms of real fields of `rows` by `cols`, both powers of two and at least 2, padded with zeros
/// to twice both.
#[derive(Clone, Debug)]
pub(crate) struct Plane {
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    down: Line,
    across: Line,
}

impl Plane {
    pub(crate) fn new(rows: usize, cols: usize) -> Self {
        Self { rows, cols, down: Line::new(2 * rows), across: Line::new(2 * cols) }
    }

    /// Number of frequencies in a spectrum: half of those across, because the field is real.
    pub(crate) fn frequencies(&self) -> usize {
        self.down.length * (self.cols + 1)
    }

    /// Spectrum of a field.
    pub(crate) fn forward(&self, field: &[f64], scratch: &mut Complexes, spectrum: &mut Complexes) {
        self.forward_of(|row, col| field[row * self.cols + col], [self.rows, self.cols], scratch, spectrum);
    }

    /// Spectrum of the padded field `at`, given for rows and columns below `sides`; zero beyond.
    pub(crate) fn forward_of(
        &self,
        at: impl Fn(usize, usize) -> f64,
        [rows, cols]: [usize; 2],
        scratch: &mut Complexes,
        spectrum: &mut Complexes,
    ) {
        // Two rows at a time are the real and the imaginary part of one signal.
        let pairs = rows / 2;
        scratch.zeros(self.across.length * pairs);
        for pair in 0..pairs {
            for col in 0..cols {
                scratch.re[col * pairs + pair] = at(2 * pair, col);
                scratch.im[col * pairs + pair] = at(2 * pair + 1, col);
            }
        }
        self.across.forward(scratch, pairs);
        spectrum.zeros(self.frequencies());
        let width = self.cols + 1;
        for k in 0..width {
            let (one, other) = self.mirrored(k);
            for pair in 0..pairs {
                let (i, j) = (one * pairs + pair, other * pairs + pair);
                let (z, w) = ([scratch.re[i], scratch.im[i]], [scratch.re[j], -scratch.im[j]]);
                let at = 2 * pair * width + k;
                (spectrum.re[at], spectrum.im[at]) = (0.5 * (z[0] + w[0]), 0.5 * (z[1] + w[1]));
                let at = at + width;
                (spectrum.re[at], spectrum.im[at]) = (0.5 * (z[1] - w[1]), 0.5 * (w[0] - z[0]));
            }
        }
        self.down.forward(spectrum, width);
    }

    /// Inverse transform within `rows` and `cols`, times the number of padded cells; overwrites the
    /// spectrum.
    pub(crate) fn backward(&self, spectrum: &mut Complexes, scratch: &mut Complexes, field: &mut Vec<f64>) {
        let (width, pairs) = (self.cols + 1, self.rows / 2);
        self.down.backward(spectrum, width);
        scratch.zeros(self.across.length * pairs);
        for k in 0..width {
            let (one, other) = self.mirrored(k);
            for pair in 0..pairs {
                let even = 2 * pair * width + k;
                let odd = even + width;
                let (a, b) = ([spectrum.re[even], spectrum.im[even]], [spectrum.re[odd], spectrum.im[odd]]);
                let (i, j) = (one * pairs + pair, other * pairs + pair);
                (scratch.re[j], scratch.im[j]) = (a[0] + b[1], b[0] - a[1]);
                (scratch.re[i], scratch.im[i]) = (a[0] - b[1], b[0] + a[1]);
            }
        }
        self.across.backward(scratch, pairs);
        field.clear();
        field.resize(self.rows * self.cols, 0.0);
        for pair in 0..pairs {
            for col in 0..self.cols {
                field[2 * pair * self.cols + col] = scratch.re[col * pairs + pair];
                field[(2 * pair + 1) * self.cols + col] = scratch.im[col * pairs + pair];
            }
        }
    }

    /// Indices of the frequencies k and -k.
    fn mirrored(&self, k: usize) -> (usize, usize) {
        let place = &self.across.place;
        (place[k], place[(self.across.length - k) % self.across.length])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gelstereo_core::math::random::Stream;

    fn noise(name: &str, count: usize) -> Vec<f64> {
        let mut stream = Stream::new(1, name);
        (0..count).map(|_| stream.uniform() - 0.5).collect()
    }

    /// Against the definition of the transform.
    #[test]
    fn a_line_is_the_discrete_fourier_transform() {
        for length in [1, 2, 4, 8, 16, 32] {
            let line = Line::new(length);
            let (re, im) = (noise("re", 3 * length), noise("im", 3 * length));
            let mut x = Complexes { re: re.clone(), im: im.clone() };
            line.forward(&mut x, 3);
            for signal in 0..3 {
                for k in 0..length {
                    let mut sum = [0.0; 2];
                    for j in 0..length {
                        let angle = -2.0 * PI * (j * k) as f64 / length as f64;
                        let at = j * 3 + signal;
                        let term = times([re[at], im[at]], [cos(angle), sin(angle)]);
                        sum = [sum[0] + term[0], sum[1] + term[1]];
                    }
                    let at = line.place[k] * 3 + signal;
                    assert!((x.re[at] - sum[0]).abs() + (x.im[at] - sum[1]).abs() < 1e-13, "{length} {k}");
                }
            }
            line.backward(&mut x, 3);
            let back = x.re.iter().zip(&re).chain(x.im.iter().zip(&im));
            assert!(back.map(|(a, b)| (a / length as f64 - b).abs()).fold(0.0, f64::max) < 1e-14);
        }
    }

    /// A product of spectra is the sum over shifts, without wrap-around.
    #[test]
    fn row_28_a_padded_product_is_the_open_convolution() {
        for (rows, cols) in [(2, 2), (4, 16), (16, 4), (8, 8)] {
            let plane = Plane::new(rows, cols);
            let (field, kernel) = (noise("field", rows * cols), noise("kernel", 4 * rows * cols));
            let (mut scratch, mut of_field, mut of_kernel) = Default::default();
            plane.forward(&field, &mut scratch, &mut of_field);
            let wrapped = |row: usize, col: usize| kernel[row * 2 * cols + col];
            plane.forward_of(wrapped, [2 * rows, 2 * cols], &mut scratch, &mut of_kernel);
            for i in 0..plane.frequencies() {
                let product = times([of_field.re[i], of_field.im[i]], [of_kernel.re[i], of_kernel.im[i]]);
                [of_field.re[i], of_field.im[i]] = product;
            }
            let mut found = Vec::new();
            plane.backward(&mut of_field, &mut scratch, &mut found);
            for at in 0..rows * cols {
                let (row, col) = (at / cols, at % cols);
                let sum: f64 = (0..rows * cols)
                    .map(|from| {
                        let (down, across) = (row + 2 * rows - from / cols, col + 2 * cols - from % cols);
                        field[from] * wrapped(down % (2 * rows), across % (2 * cols))
                    })
                    .sum();
                assert!((found[at] / (4 * rows * cols) as f64 - sum).abs() < 1e-13, "{rows} x {cols}: {at}");
            }
        }
    }
}
