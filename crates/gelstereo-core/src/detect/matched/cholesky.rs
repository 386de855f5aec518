//! Systems with the covariance of the pixels of a support.

use crate::math::sqrt;
use alloc::vec::Vec;

/// Products that are summed at a time.
const LANES: usize = 4;

/// C = L Lᵀ with a lower triangle L (Golub and Van Loan, section 4.2).
#[derive(Clone, Debug, Default)]
pub(super) struct Cholesky {
    /// Number, column and row of the pixels that count, in ascending order.
    pixels: Vec<(usize, [usize; 2])>,
    /// Rows of L one after the other; the last of each is one over the diagonal.
    rows: Vec<f64>,
    solved: Vec<f64>,
}

impl Cholesky {
    /// Makes room for so many pixels.
    pub fn reserve(&mut self, pixels: usize) {
        self.pixels.clear();
        self.pixels.reserve(pixels);
        self.rows.clear();
        self.rows.reserve(pixels * (pixels + 1) / 2);
        self.solved.clear();
        self.solved.reserve(pixels);
    }

    /// Of the covariance between any two of the pixels that are inside a square of this side, by columns and rows from one
    /// to the other.
    pub fn factor(
        &mut self,
        side: usize,
        inside: impl Iterator<Item = bool>,
        between: impl Fn(usize, usize) -> f64,
    ) {
        let Self { pixels, rows, .. } = self;
        pixels.clear();
        let inside = (0..).zip(inside).filter(|&(_, inside)| inside);
        pixels.extend(inside.map(|(pixel, _)| (pixel, [pixel % side, pixel / side])));
        rows.clear();
        for (i, &(_, [x, y])) in pixels.iter().enumerate() {
            let (start, mut above) = (rows.len(), 0);
            for (j, &(_, other)) in pixels[..i].iter().enumerate() {
                let left = between(x.abs_diff(other[0]), y - other[1]);
                let entry = (left - dot(&rows[above..above + j], &rows[start..])) * rows[above + j];
                rows.push(entry);
                above += j + 1;
            }
            let own = between(0, 0) - dot(&rows[start..], &rows[start..]);
            rows.push(1.0 / sqrt(own));
        }
    }

    /// C⁻¹ v, for v with a number for every pixel; 0 for those that do not count.
    pub fn solve(&mut self, v: &[f64], out: &mut Vec<f64>) {
        let Self { pixels, rows, solved } = self;
        solved.clear();
        let mut start = 0;
        for (i, &(pixel, _)) in pixels.iter().enumerate() {
            let row = &rows[start..=start + i];
            solved.push((v[pixel] - dot(&row[..i], solved)) * row[i]);
            start += i + 1;
        }
        out.clear();
        out.resize(v.len(), 0.0);
        for (i, &(pixel, _)) in pixels.iter().enumerate().rev() {
            start -= i + 1;
            let row = &rows[start..=start + i];
            let last = solved[i] * row[i];
            out[pixel] = last;
            solved.iter_mut().zip(&row[..i]).for_each(|(sum, entry)| *sum -= last * entry);
        }
    }
}

/// Sum of products, in lanes: the order of the sum is fixed, and is one that processors like.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut sums = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        for k in 0..LANES {
            sums[k] += a[k] * b[k];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f64>() + rest
}
