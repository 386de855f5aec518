//! Contact of a rigid part with a layer of gel: linear elasticity, bonded below, as wide as it likes.
//!
//! [`Layer`] knows its compliances wave by wave, [`LayerContact`] finds the tractions over a grid of square cells under a
//! part and how the surface moves, and [`closed`] has the few contacts that are solved in closed form, for the
//! half-space that a thick layer is. Tractions are in units of Young's modulus: a part that is held in place leaves the
//! same surface whatever the modulus is.

pub mod closed;
mod contact;
mod error;
mod fft;
mod influence;
mod kernel;
mod operator;
mod window;

pub use contact::Convergence;
pub use error::LayerError;
pub use kernel::{Compliance, Layer};

use alloc::vec::Vec;
use contact::Pressing;
use influence::Influence;
use operator::{Operator, Scratch};
use window::Window;

/// Where a solve starts from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Start {
    /// From the part's heights: the same bits whatever was solved before.
    #[default]
    Afresh,
    /// From the last solution, as for the next frame of a sequence: fewer steps.
    Last,
}

/// What a contact is solved on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Cells along y.
    pub rows: usize,
    /// Cells along x.
    pub cols: usize,
    /// Side of a square cell, mm.
    pub cell_mm: f64,
}

/// A layer over whose surface a part may press anywhere on a grid of cells. All that depends on layer and grid is worked
/// out once; solving allocates nothing after the first time.
#[derive(Clone, Debug)]
pub struct LayerContact {
    layer: Layer,
    grid: Grid,
    influence: Influence,
    /// By the logarithms of their sides.
    operators: Vec<Operator>,
    /// How many logarithms there are along a side.
    sizes: [usize; 2],
    pressure: Vec<f64>,
    window: Window,
    heights: Vec<f64>,
    within: Vec<f64>,
    pressing: Pressing,
    scratch: Scratch,
}

/// Sides of the smallest operator.
const LEAST_SIDE: usize = 8;
/// Largest number of cells along a side.
const MOST_CELLS: usize = 256;
/// How far beside the part's deepest point, in parts of its depth, a cell is still looked at: pressed gel rises beside a
/// contact, by less than that.
const RISE: f64 = 0.25;

impl LayerContact {
    /// # Errors
    /// [`LayerError::Invalid`] for a layer or a grid that is none.
    pub fn new(layer: Layer, grid: Grid) -> Result<Self, LayerError> {
        layer.validate()?;
        grid.validate(&layer)?;
        let logs =
            |cells: usize| (cells.max(LEAST_SIDE).next_power_of_two() / LEAST_SIDE).ilog2() as usize + 1;
        let sizes = [logs(grid.rows), logs(grid.cols)];
        let side = LEAST_SIDE << (sizes[0].max(sizes[1]) - 1);
        let influence = Influence::new(&layer, grid.cell_mm, side);
        let operators = (0..sizes[0] * sizes[1])
            .map(|i| {
                Operator::new(&influence, LEAST_SIDE << (i / sizes[1]), LEAST_SIDE << (i % sizes[1]), false)
            })
            .collect();
        Ok(Self {
            layer,
            grid,
            influence,
            operators,
            sizes,
            pressure: zeros(grid.rows * grid.cols),
            window: Window::default(),
            heights: Vec::new(),
            within: Vec::new(),
            pressing: Pressing::default(),
            scratch: Scratch::default(),
        })
    }

    /// Presses a part into the layer.
    ///
    /// `heights_mm` are the part's above the undeformed surface, positive into the layer, cell by cell and row after
    /// row; negative infinity where there is no part. A cell that touches ends within `tolerance_mm` of the part.
    ///
    /// # Errors
    /// [`LayerError`] if a number is missing, NaN, or deeper than the layer is thick, or the tolerance is not
    /// positive.
    pub fn press(
        &mut self,
        heights_mm: &[f64],
        tolerance_mm: f64,
        start: Start,
    ) -> Result<Convergence, LayerError> {
        self.check(heights_mm, tolerance_mm)?;
        let window = Window::around(heights_mm, self.grid, RISE);
        let Self { pressure, within, .. } = self;
        let operator = &self.operators[window.operator(self.sizes)];
        window.cut(heights_mm, f64::NEG_INFINITY, &operator.plane, &mut self.heights);
        match start {
            Start::Afresh => {
                // A bed of springs as stiff as the shortest waves: near enough for what the contact is to be found from.
                within.clear();
                within.extend(self.heights.iter().map(|height| height.max(0.0) * operator.stencil[0]));
            }
            Start::Last => {
                window.cut(pressure, 0.0, &operator.plane, within);
                within
                    .iter_mut()
                    .zip(&self.heights)
                    .for_each(|(p, h)| *p = if h.is_finite() { *p } else { 0.0 });
            }
        }
        let found = self.pressing.solve(operator, &self.heights, tolerance_mm, within);
        pressure.fill(0.0);
        window.paste(within, &operator.plane, pressure);
        self.window = window;
        Ok(found)
    }

    /// Pressures of the last contact, in units of Young's modulus, row after row.
    #[must_use]
    pub fn pressure(&self) -> &[f64] {
        &self.pressure
    }

    /// Motion of the surface over the grid after the last solve, mm: into the layer, and along x and y.
    pub fn surface_mm(&mut self, into: &mut Vec<f64>, aside: &mut [Vec<f64>; 2]) {
        let whole = Window::whole(self.grid);
        let operator = &self.operators[whole.operator(self.sizes)];
        whole.cut(&self.pressure, 0.0, &operator.plane, &mut self.within);
        let mut field = core::mem::take(&mut self.heights);
        operator.sink(&self.within, &mut self.scratch, &mut field);
        into.clear();
        into.resize(self.pressure.len(), 0.0);
        whole.paste(&field, &operator.plane, into);
        let mut spread = [field, Vec::new()];
        operator.spread(&self.within, &mut self.scratch, &mut spread);
        for (aside, field) in aside.iter_mut().zip(&spread) {
            aside.clear();
            aside.resize(self.pressure.len(), 0.0);
            whole.paste(field, &operator.plane, aside);
        }
        let [field, _] = spread;
        self.heights = field;
    }

    /// The layer.
    #[must_use]
    pub fn layer(&self) -> Layer {
        self.layer
    }

    /// The grid.
    #[must_use]
    pub fn grid(&self) -> Grid {
        self.grid
    }

    pub(crate) fn influence(&self) -> &Influence {
        &self.influence
    }

    fn check(&self, heights_mm: &[f64], tolerance_mm: f64) -> Result<(), LayerError> {
        let (found, cells) = (heights_mm.len(), self.pressure.len());
        if found != cells {
            return Err(LayerError::Cells { found, cells });
        }
        let ok = tolerance_mm > 0.0 && tolerance_mm.is_finite();
        LayerError::check(ok, "tolerance_mm", tolerance_mm, "above 0")?;
        let deepest = self.layer.thickness_mm;
        match heights_mm.iter().find(|&&height| !(height <= deepest)) {
            Some(&found) => LayerError::check(false, "heights_mm", found, "at most the layer's thickness"),
            None => Ok(()),
        }
    }
}

impl Layer {
    fn validate(&self) -> Result<(), LayerError> {
        let (h, nu) = (self.thickness_mm, self.poisson_ratio);
        LayerError::check(h > 0.0 && h <= 1e6, "thickness_mm", h, "above 0, at most 1e6 mm")?;
        LayerError::check((0.0..=0.5).contains(&nu), "poisson_ratio", nu, "0 to 0.5")
    }
}

impl Grid {
    fn validate(&self, layer: &Layer) -> Result<(), LayerError> {
        for (name, side) in [("rows", self.rows), ("cols", self.cols)] {
            LayerError::check((1..=MOST_CELLS).contains(&side), name, side as f64, "1 to 256 cells")?;
        }
        let ok = self.cell_mm > 0.0 && self.cell_mm <= layer.thickness_mm;
        LayerError::check(ok, "cell_mm", self.cell_mm, "above 0, at most the layer's thickness")
    }
}

fn zeros(count: usize) -> Vec<f64> {
    let mut list = Vec::new();
    list.resize(count, 0.0);
    list
}
