//! Normal matrix of a step as an integral along the outline, at a twentieth of the cost of a sum over pixels.
//!
//! Weights and slopes vanish beyond a blur from the outline. Their integrals across it are constants of
//! the image, so a few points along it suffice: the trapezoidal rule on an ellipse converges
//! exponentially (Trefethen and Weideman, SIAM Review 2014). The effects of curvature and sampling are
//! the same for all markers of an image to first order, and are measured on samples.

use super::disc::{Levels, Matrix, Outline};
use super::edge::Across;
use crate::math::Factor;
use crate::math::sqrt;
use core::f64::consts::{FRAC_1_SQRT_2, PI};

/// cos and sin of 8 points of half an ellipse; the other half has the same products.
const HALF_TURN: [(f64, f64); 8] = {
    const C: f64 = 0.923_879_532_511_286_7;
    const S: f64 = 0.382_683_432_365_089_8;
    const R: f64 = FRAC_1_SQRT_2;
    [(1.0, 0.0), (C, S), (R, R), (S, C), (0.0, 1.0), (-S, C), (-R, R), (-C, S)]
};

/// Normal matrix of the outline's step for a contrast of 1, with the levels eliminated. `None` if the
/// outline is not an ellipse.
pub(super) fn matrix(
    outline: &Outline,
    across: &Across,
    levels: &Levels,
    follow: &Factor<4>,
) -> Option<Matrix> {
    let [[sxx, sxy], [_, syy]] = outline.spread_px2()?;
    let [axx, axy, ayy] = outline.form;
    // A square root of the spread: it maps the unit circle to the ellipse.
    let l11 = sqrt(sxx);
    let l21 = sxy / l11;
    let l22 = sqrt((syy - l21 * l21).max(0.0));
    let mut matrix = [[0.0; 5]; 5];
    // Σ of each parameter's outline shift times 1, x and y, relative to the ellipse's centre.
    let mut moved = [[0.0; 3]; 5];
    for (cos, sin) in HALF_TURN {
        let (x, y) = (l11 * cos, l21 * cos + l22 * sin);
        let (along, up) = (axx * x + axy * y, axy * x + ayy * y);
        // Parameter shifts move the outline outwards by c / |A p|; its line element is |A p| times the
        // area element.
        let c = [along, up, -0.5 * x * x, -x * y, -0.5 * y * y];
        let per = 1.0 / sqrt(along * along + up * up);
        for i in 0..2 {
            moved[i][1] += c[i] * x;
            moved[i][2] += c[i] * y;
            for j in 0..=i {
                matrix[i][j] += c[i] * c[j] * per;
            }
        }
        for i in 2..5 {
            moved[i][0] += c[i];
            for j in 2..=i {
                matrix[i][j] += c[i] * c[j] * per;
            }
        }
    }
    let element = 2.0 * PI / HALF_TURN.len() as f64 * l11 * l22;
    let lit = across.weight + levels.contrast / levels.ground.max(1.0) * across.inside;
    let middle = outline.centre;
    let (mut with_weight, mut followed) = ([[0.0; 4]; 5], [[0.0; 4]; 5]);
    for i in 0..5 {
        let one = moved[i][0] * element;
        let (x, y) = (moved[i][1] * element + middle.x * one, moved[i][2] * element + middle.y * one);
        with_weight[i] = [across.weight * one, lit * x, lit * y, across.inside * one];
        followed[i] = follow.solve(&[one, x, y, 0.5 * one]);
    }
    let dot = |a: &[f64; 4], b: &[f64; 4]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    for i in 0..5 {
        for j in 0..=i {
            let taken = dot(&with_weight[i], &followed[j]) + dot(&with_weight[j], &followed[i]);
            matrix[i][j] = across.slope * element * matrix[i][j] - 0.5 * taken;
        }
    }
    Some(matrix)
}

/// The matrix with rows and columns scaled by these factors.
pub(super) fn scaled(matrix: &Matrix, by: &[f64; 5]) -> Matrix {
    let mut scaled = *matrix;
    for i in 0..5 {
        for j in 0..=i {
            scaled[i][j] *= by[i] * by[j];
        }
    }
    scaled
}
