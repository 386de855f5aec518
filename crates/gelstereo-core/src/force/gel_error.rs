//! Error of the wrench because a number of the gel is not known exactly.

use super::grid::Grid;
use crate::layer::{Influence, Layer};
use crate::params::ForceParams;
use alloc::vec::Vec;

/// Relative step of the thickness for a derivative. Central differences with 0.005 and 0.02 give forces that
/// differ by less than 0.1 % of their standard deviation.
const THICKNESS_STEP: f64 = 0.01;
/// Step of Poisson's ratio; one side of it is at most 0.5, where the compliance is steepest.
const POISSON_STEP: f64 = 0.005;

/// One number of the gel with its standard deviation.
#[derive(Clone, Debug)]
pub(super) struct GelError {
    pub sigma: f64,
    /// Derivative of the influence by the number.
    pub derivative: Influence,
    /// Derivative of Kᵀ W (u - K x), and half of its solution.
    pub right: Vec<f64>,
    pub half: Vec<f64>,
}

impl GelError {
    /// Thickness and Poisson's ratio.
    pub const MOST: usize = 2;

    /// Those that the settings state.
    pub fn all(params: &ForceParams, layer: &Layer, grid: &Grid, side: usize) -> Vec<Self> {
        let influence = |layer: Layer| grid.influence(&layer, side);
        let made = |sigma: f64, [low, high]: [Layer; 2], step: f64| Self {
            sigma,
            derivative: difference(&influence(low), &influence(high), step),
            right: Vec::new(),
            half: Vec::new(),
        };
        let mut all = Vec::new();
        if params.thickness_sigma_mm > 0.0 {
            let step = THICKNESS_STEP * layer.thickness_mm;
            let at = |thickness_mm| Layer { thickness_mm, ..*layer };
            let ends = [at(layer.thickness_mm - step), at(layer.thickness_mm + step)];
            all.push(made(params.thickness_sigma_mm, ends, 2.0 * step));
        }
        if params.poisson_sigma > 0.0 {
            let at = |poisson_ratio| Layer { poisson_ratio, ..*layer };
            let low = (layer.poisson_ratio - POISSON_STEP).max(0.0);
            let high = (layer.poisson_ratio + POISSON_STEP).min(0.5);
            all.push(made(params.poisson_sigma, [at(low), at(high)], high - low));
        }
        all
    }

    pub fn reserve(&mut self, size: usize) {
        self.right.reserve(size);
        self.half.reserve(size);
    }

    /// Change of the wrench by one standard deviation, from half the solutions of its unit loads.
    pub fn loads(&self, halves: &[Vec<f64>; 6]) -> [f64; 6] {
        let product = |half: &Vec<f64>| half.iter().zip(&self.half).map(|(a, b)| a * b).sum::<f64>();
        core::array::from_fn(|k| self.sigma * product(&halves[k]))
    }
}

fn difference(low: &Influence, high: &Influence, step: f64) -> Influence {
    let list = |low: &[f64], high: &[f64]| -> Vec<f64> {
        low.iter().zip(high).map(|(low, high)| (high - low) / step).collect()
    };
    Influence {
        side: low.side,
        normal: list(&low.normal, &high.normal),
        cross: [0, 1].map(|axis| list(&low.cross[axis], &high.cross[axis])),
        along: [0, 1].map(|axis| list(&low.along[axis], &high.along[axis])),
        across: list(&low.across, &high.across),
    }
}
