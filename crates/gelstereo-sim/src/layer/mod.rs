//! Contact of a rigid part with a layer of gel: linear elasticity, bonded below, unbounded sideways.
//!
//! [`Layer`] has the compliances by wave number. [`LayerContact`] solves for the tractions over a grid
//! of rectangular cells under a part, and for the motion of the surface. [`closed`] has the few contacts with
//! closed-form solutions, for the half-space limit of a thick layer. Tractions are in units of Young's
//! modulus: the surface under a part that is held in place does not depend on the modulus.

pub mod closed;
mod contact;
mod error;
mod fft;
mod friction;
mod memory;
mod nodes;
mod operator;
mod sides;
mod window;

pub use contact::Convergence;
pub use error::LayerError;
pub use gelstereo_core::layer::{Compliance, Layer};
pub(crate) use memory::Memory;
pub use memory::PronyTerm;
pub(crate) use nodes::{Motion, Nodes, Places};
pub(crate) use sides::Sides;

use alloc::sync::Arc;
use alloc::vec::Vec;
use contact::Pressing;
use friction::Holding;
use gelstereo_core::layer::Influence;
use gelstereo_core::stop::{NEVER, Stop};
use operator::{Operator, Scratch};
use window::Window;

/// Initial value of a solve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Start {
    /// The part's heights: the same bits whatever was solved before.
    #[default]
    Afresh,
    /// The last solution, as for the next frame of a sequence: fewer steps.
    Last,
}

/// Grid of rectangular cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Cells along y.
    pub rows: usize,
    /// Cells along x.
    pub cols: usize,
    /// Sides of a cell along x and y, mm.
    pub cell_mm: [f64; 2],
}

/// A part on the layer.
#[derive(Clone, Copy, Debug)]
pub struct Part<'a> {
    /// Heights above the undeformed surface, positive into the layer, row-major over the cells; negative
    /// infinity where there is no part.
    pub heights_mm: &'a [f64],
    /// Motion of every cell along x and along y since touch if it stuck; `None` is zero everywhere.
    pub carried_mm: Option<[&'a [f64]; 2]>,
}

/// A layer with a grid of cells on which a part may press anywhere. Everything that depends on layer and
/// grid is precomputed. Solving allocates nothing after the first time.
#[derive(Clone, Debug)]
pub struct LayerContact {
    layer: Layer,
    grid: Grid,
    friction: f64,
    tables: Arc<Tables>,
    pressure: Vec<f64>,
    traction: [Vec<f64>; 2],
    work: Work,
}

/// Everything that depends on layer and grid alone.
#[derive(Debug)]
struct Tables {
    influence: Influence,
    /// Sorted by the logarithms of their sides.
    operators: Vec<Operator>,
    /// Number of logarithms along each side.
    sizes: [usize; 2],
}

/// Fields over the window of a solve.
#[derive(Clone, Debug, Default)]
struct Work {
    heights: Vec<f64>,
    pressure: Vec<f64>,
    traction: [Vec<f64>; 2],
    asked: [Vec<f64>; 2],
    bound: Vec<f64>,
    lifted: Vec<f64>,
    spread: [Vec<f64>; 2],
    pressing: Pressing,
    holding: Holding,
    scratch: Scratch,
}

/// Side of the smallest operator.
const MIN_SIDE: usize = 8;
/// Largest number of cells along a side.
const MAX_CELLS: usize = 256;
/// Alternations between pressures and tractions after which a solve gives up.
const MAX_TURNS: usize = 40;
/// Cells are included where the part is less than this fraction of its depth away from the undeformed
/// surface. Pressed gel rises beside a contact by less than that.
const RISE: f64 = 0.25;

impl LayerContact {
    /// `friction` is Coulomb's coefficient; 0 for none.
    ///
    /// # Errors
    /// [`LayerError::Invalid`] for an invalid layer, grid or friction.
    pub fn new(layer: Layer, grid: Grid, friction: f64) -> Result<Self, LayerError> {
        check_layer(&layer)?;
        grid.validate(&layer)?;
        check_friction(friction)?;
        Ok(Self::of(Arc::new(Tables::new(&layer, grid)), layer, grid, friction))
    }

    /// As [`Self::new`] with the layer and the grid of this one, whose tables it shares.
    ///
    /// # Errors
    /// [`LayerError::Invalid`] for an invalid friction.
    pub fn with_friction(&self, friction: f64) -> Result<Self, LayerError> {
        check_friction(friction)?;
        Ok(Self::of(self.tables.clone(), self.layer, self.grid, friction))
    }

    fn of(tables: Arc<Tables>, layer: Layer, grid: Grid, friction: f64) -> Self {
        let none = || zeros(grid.rows * grid.cols);
        let (pressure, traction) = (none(), [none(), none()]);
        let work = Work::default();
        let mut contact = Self { layer, grid, friction, tables, pressure, traction, work };
        contact.warm_up();
        contact
    }
    /// Solves once over the largest window, so that no later solve allocates.
    fn warm_up(&mut self) {
        let Self { tables, work, .. } = self;
        let Some(operator) = tables.operators.last() else { return };
        let cells = operator.plane.rows * operator.plane.cols;
        let Work {
            heights,
            pressure,
            traction: [qx, qy],
            asked: [ax, ay],
            bound,
            lifted,
            spread: [sx, sy],
            ..
        } = work;
        for field in [heights, pressure, qx, qy, ax, ay, bound, lifted, sx, sy] {
            field.clear();
            field.resize(cells, 0.0);
        }
        work.heights[0] = 1e-3 * self.layer.thickness_mm;
        let Work { heights, pressure, pressing, scratch, traction, asked, bound, spread, holding, .. } = work;
        let tolerance_mm = 1e-3 * heights[0];
        pressing.solve(operator, heights, (tolerance_mm, NEVER), pressure);
        bound[0] = pressure[0];
        asked[0][0] = heights[0];
        holding.solve(operator, bound, asked, (tolerance_mm, NEVER), traction);
        operator.spread(pressure, scratch, spread);
        operator.lift(traction, scratch, &mut work.lifted);
    }

    /// Presses a part into the layer and carries it aside. A cell in contact ends within `tolerance_mm`
    /// of the part.
    ///
    /// With friction, pressures and tractions are solved alternately until the lift by the tractions no
    /// longer moves the surface (Panagiotopoulos 1975). The motion is applied in one step: slip along
    /// the path is not modelled.
    ///
    /// # Errors
    /// [`LayerError`] if a number is missing, NaN, or deeper than the layer is thick, or the tolerance
    /// is not positive.
    pub fn press(
        &mut self,
        part: Part<'_>,
        tolerance_mm: f64,
        start: Start,
    ) -> Result<Convergence, LayerError> {
        self.press_unless(part, tolerance_mm, start, NEVER)
    }

    /// As [`Self::press`], but can be stopped: the last solution then stays.
    ///
    /// # Errors
    /// As [`Self::press`], and [`LayerError::Stopped`].
    pub fn press_unless(
        &mut self,
        part: Part<'_>,
        tolerance_mm: f64,
        start: Start,
        stop: Stop<'_>,
    ) -> Result<Convergence, LayerError> {
        self.check(&part, tolerance_mm)?;
        let window = Window::around(part.heights_mm, self.grid, RISE);
        let Self { friction, tables, pressure, traction, work, .. } = self;
        let operator = tables.operator(&window);
        work.begin(operator, &window, &part, start, pressure, traction);
        let found = if *friction > 0.0 {
            work.grip(operator, &window, &part, *friction, (tolerance_mm, stop))
        } else {
            work.pressing.solve(operator, &work.heights, (tolerance_mm, stop), &mut work.pressure)
        };
        if stop() {
            return Err(LayerError::Stopped);
        }
        let [along, across] = traction;
        for (field, cut) in
            [(pressure, &work.pressure), (along, &work.traction[0]), (across, &work.traction[1])]
        {
            field.fill(0.0);
            window.paste(cut, &operator.plane, field);
        }
        Ok(found)
    }

    /// Removes the part.
    pub(crate) fn release(&mut self) {
        let Self { pressure, traction: [x, y], .. } = self;
        [pressure, x, y].into_iter().for_each(|field| field.fill(0.0));
    }

    /// Sets pressures, and tractions along x and y, on the surface instead of solving a contact; in
    /// units of Young's modulus.
    ///
    /// # Errors
    /// [`LayerError`] if a number is missing or not finite.
    pub fn load(&mut self, pressure: &[f64], traction: [&[f64]; 2]) -> Result<(), LayerError> {
        let fields = [pressure, traction[0], traction[1]];
        self.check_cells(fields.into_iter())?;
        if let Some(&found) = fields.into_iter().flatten().find(|load| !load.is_finite()) {
            return LayerError::check(false, "a load", found, "finite");
        }
        self.pressure.copy_from_slice(pressure);
        self.traction.iter_mut().zip(traction).for_each(|(own, given)| own.copy_from_slice(given));
        Ok(())
    }

    /// Pressures of the last contact, in units of Young's modulus, row after row.
    #[must_use]
    pub fn pressure(&self) -> &[f64] {
        &self.pressure
    }

    /// Tractions of the last contact along x and y, in units of Young's modulus, row after row.
    #[must_use]
    pub fn traction(&self) -> [&[f64]; 2] {
        [&self.traction[0], &self.traction[1]]
    }

    /// Motion of the surface over the grid after the last solve, mm: into the layer, and along x and y.
    pub fn surface_mm(&mut self, into: &mut Vec<f64>, aside: &mut [Vec<f64>; 2]) {
        let whole = Window::whole(self.grid);
        let Self { tables, pressure, traction, work, .. } = self;
        let operator = tables.operator(&whole);
        let plane = &operator.plane;
        let Work { pressure: pressed, traction: pulled, lifted, spread, scratch, .. } = work;
        whole.cut(pressure, 0.0, plane, pressed);
        operator.sink(pressed, scratch, lifted);
        whole.put(lifted, plane, into);
        operator.spread(pressed, scratch, spread);
        aside.iter_mut().zip(&*spread).for_each(|(aside, field)| whole.put(field, plane, aside));
        if traction.iter().flatten().any(|&q| q != 0.0) {
            for (field, cut) in traction.iter().zip(&mut *pulled) {
                whole.cut(field, 0.0, plane, cut);
            }
            operator.lift(pulled, scratch, lifted);
            whole.add(lifted, plane, into);
            operator.shear(pulled, scratch, spread);
            aside.iter_mut().zip(spread).for_each(|(aside, field)| whole.add(field, plane, aside));
        }
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
        &self.tables.influence
    }

    fn check(&self, part: &Part<'_>, tolerance_mm: f64) -> Result<(), LayerError> {
        let carried = part.carried_mm.into_iter().flatten();
        self.check_cells(carried.clone().chain([part.heights_mm]))?;
        let ok = tolerance_mm > 0.0 && tolerance_mm.is_finite();
        LayerError::check(ok, "tolerance_mm", tolerance_mm, "above 0")?;
        let deepest = self.layer.thickness_mm;
        if let Some(&found) = part.heights_mm.iter().find(|&&height| !(height <= deepest)) {
            return LayerError::check(false, "heights_mm", found, "at most the layer's thickness");
        }
        match carried.flatten().find(|motion| !motion.is_finite()) {
            Some(&found) => LayerError::check(false, "carried_mm", found, "finite"),
            None => Ok(()),
        }
    }

    fn check_cells<'a>(&self, mut fields: impl Iterator<Item = &'a [f64]>) -> Result<(), LayerError> {
        let cells = self.pressure.len();
        match fields.find(|field| field.len() != cells) {
            Some(field) => Err(LayerError::Cells { found: field.len(), cells }),
            None => Ok(()),
        }
    }
}

impl Tables {
    fn new(layer: &Layer, grid: Grid) -> Self {
        let logs = |cells: usize| (cells.max(MIN_SIDE).next_power_of_two() / MIN_SIDE).ilog2() as usize + 1;
        let sizes = [logs(grid.rows), logs(grid.cols)];
        let side = MIN_SIDE << (sizes[0].max(sizes[1]) - 1);
        let influence = Influence::new(layer, grid.cell_mm, side);
        let operator = |i: usize| {
            let sides = [MIN_SIDE << (i / sizes[1]), MIN_SIDE << (i % sizes[1])];
            Operator::new(&influence, sides)
        };
        let operators = (0..sizes[0] * sizes[1]).map(operator).collect();
        Self { influence, operators, sizes }
    }

    fn operator(&self, window: &Window) -> &Operator {
        &self.operators[window.operator(self.sizes)]
    }
}

impl Work {
    /// Cuts the window out of the fields and sets the initial values of the solve.
    fn begin(
        &mut self,
        operator: &Operator,
        window: &Window,
        part: &Part<'_>,
        start: Start,
        pressure: &[f64],
        traction: &[Vec<f64>; 2],
    ) {
        let plane = &operator.plane;
        window.cut(part.heights_mm, f64::NEG_INFINITY, plane, &mut self.heights);
        match start {
            Start::Afresh => {
                // Independent springs with the stiffness of the shortest waves: close enough to start
                // from.
                self.pressure.clear();
                let spring = operator.stencil[0];
                self.pressure.extend(self.heights.iter().map(|height| height.max(0.0) * spring));
                self.traction.iter_mut().for_each(|cut| window.cut(&[], 0.0, plane, cut));
            }
            Start::Last => {
                window.cut(pressure, 0.0, plane, &mut self.pressure);
                let exists = |height: &f64| height.is_finite();
                for (p, height) in self.pressure.iter_mut().zip(&self.heights) {
                    *p = if exists(height) { *p } else { 0.0 };
                }
                traction.iter().zip(&mut self.traction).for_each(|(q, cut)| window.cut(q, 0.0, plane, cut));
            }
        }
    }

    /// Solves pressures and tractions alternately.
    fn grip(
        &mut self,
        operator: &Operator,
        window: &Window,
        part: &Part<'_>,
        friction: f64,
        (tolerance_mm, stop): (f64, Stop<'_>),
    ) -> Convergence {
        let plane = &operator.plane;
        let mut found = Convergence::default();
        operator.lift(&self.traction, &mut self.scratch, &mut self.lifted);
        for _turn in 0..MAX_TURNS {
            self.heights.iter_mut().zip(&self.lifted).for_each(|(height, lift)| *height -= lift);
            let pressed =
                self.pressing.solve(operator, &self.heights, (tolerance_mm, stop), &mut self.pressure);
            self.heights.iter_mut().zip(&self.lifted).for_each(|(height, lift)| *height += lift);
            self.bound.clear();
            self.bound.extend(self.pressure.iter().map(|p| friction * p));
            operator.spread(&self.pressure, &mut self.scratch, &mut self.spread);
            for axis in 0..2 {
                let carried = part.carried_mm.map_or(&[][..], |carried| carried[axis]);
                window.cut(carried, 0.0, plane, &mut self.asked[axis]);
                self.asked[axis].iter_mut().zip(&self.spread[axis]).for_each(|(asked, u)| *asked -= u);
            }
            let Self { holding, bound, asked, traction, .. } = self;
            let held = holding.solve(operator, bound, asked, (tolerance_mm, stop), traction);
            let last = &mut self.spread[0];
            core::mem::swap(last, &mut self.lifted);
            operator.lift(&self.traction, &mut self.scratch, &mut self.lifted);
            let moved = last.iter().zip(&self.lifted).zip(&self.pressure);
            let moved =
                moved.map(|((a, b), &p)| if p > 0.0 { (a - b).abs() } else { 0.0 }).fold(0.0, f64::max);
            found.products += pressed.products + held.products;
            found.residual_mm = pressed.residual_mm.max(held.residual_mm).max(moved);
            found.converged = pressed.converged && held.converged && moved <= tolerance_mm;
            if found.converged || stop() {
                break;
            }
        }
        found
    }
}

fn check_layer(layer: &Layer) -> Result<(), LayerError> {
    let (h, nu) = (layer.thickness_mm, layer.poisson_ratio);
    LayerError::check(h > 0.0 && h <= 1e6, "thickness_mm", h, "above 0, at most 1e6 mm")?;
    LayerError::check((0.0..=0.5).contains(&nu), "poisson_ratio", nu, "0 to 0.5")
}

fn check_friction(friction: f64) -> Result<(), LayerError> {
    LayerError::check((0.0..=1e6).contains(&friction), "friction", friction, "0 to 1e6")
}

impl Grid {
    fn validate(&self, layer: &Layer) -> Result<(), LayerError> {
        for (name, side) in [("rows", self.rows), ("cols", self.cols)] {
            LayerError::check((1..=MAX_CELLS).contains(&side), name, side as f64, "1 to 256 cells")?;
        }
        self.cell_mm.into_iter().try_for_each(|side| {
            let ok = side > 0.0 && side <= layer.thickness_mm;
            LayerError::check(ok, "cell_mm", side, "above 0, at most the layer's thickness")
        })
    }
}

fn zeros(count: usize) -> Vec<f64> {
    let mut list = Vec::new();
    list.resize(count, 0.0);
    list
}
