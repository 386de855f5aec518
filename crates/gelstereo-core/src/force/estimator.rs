//! From marker motion to tractions and wrench.

use super::cells::{Cell, Cells, MAX_BLOCKS};
use super::compliance::Compliance;
use super::cone::project;
use super::equations::{Equations, Gel};
use super::error::ForceError;
use super::evidence::{Posterior, Variances};
use super::fit::check_compliance;
use super::gel_error::GelError;
use super::grid::Grid;
use super::moved::MovedMarkers;
use super::resultant::{Place, Stiffness, spread};
use super::strain::Strain;
use super::uneven::UnevenCells;
use super::work::Size;
use super::wrench::Wrench;
use crate::contact::RestSurface;
use crate::lattice::Topology;
use crate::layer::{FreeSides, Influence, Layer, N_PER_KPA_MM2};
use crate::math::DVec3;
use crate::math::linalg::Symmetric;
use crate::params::{ForceMethod, ForceParams, ParamsError};
use crate::track::MarkerState;
use alloc::vec::Vec;

/// Markers are used up to this distance from the contact, in thicknesses of the gel. With 0.25, 0.5, 1 and
/// 1.5, the rms error of the pressing force is 21, 9.2, 6.9 and 8.1 % on the contacts named below: near
/// markers alone do not tell how much gel is displaced, and far ones feel the gel's border.
const REACH: f64 = 1.0;
/// Sides farther away are left out, since they move nothing: motion falls by half in a thickness. This bounds
/// the table of influences.
const MAX_RIM_PITCHES: f64 = 64.0;
/// Standard deviation of a shear force, over the pressing force: the layer's error turns that much of one
/// into the other.
const OF_PRESSING: f64 = 0.006;
/// A pressure of Young's modulus compresses the layer by some tenths; any start serves.
const START: Variances = Variances { pressure: 0.01, shear: 0.001, noise: 1.0 };
/// Variance of shears over that of pressures at which a search does not go on from the last one. Without
/// shear its variance falls to its minimum, and MacKay's fixed point does not leave it: later shear is then
/// taken for noise. In simulated drags and twists of 18 balls the share of the friction limit in use was then
/// wrong by 0.29 rms; it is by 0.013 with 1e-5, 1e-3 and 0.1.
const MIN_SHEAR: f64 = 1e-3;

/// Pressure from which a neighbour of the patch touches the part, over the largest one. With 0.08, 0.12 and
/// 0.2, these and the patch are 99.4, 97.3 and 91.8 % of the markers in contact with 60 simulated balls, and
/// 3.8, 0.6 and 0 % more; the patch alone is 76.5 % (seed 31 of the report on slip).
const PRESSED: f64 = 0.12;

/// Estimates the tractions on a gel and their wrench. It allocates nothing after it was made.
#[derive(Clone, Debug)]
pub struct ForceEstimator {
    params: ForceParams,
    /// Without a layer.
    stiffness: Option<Stiffness>,
    young_kpa: f64,
    influence: Influence,
    sides: Option<FreeSides>,
    /// In place of `influence` and `sides`, which then give its derivatives alone.
    compliance: Option<Compliance>,
    thickness_mm: f64,
    rest: RestSurface,
    rest_covariance_mm2: Vec<Symmetric<3>>,
    /// Into the layer (towards the camera), along rows, along columns.
    axes: [DVec3; 3],
    grid: Grid,
    cells: Cells,
    equations: Equations,
    posterior: Posterior,
    /// Those of the last contact, from which the next search begins.
    variances: Option<Variances>,
    /// Unit loads of the wrench's components, for each unknown.
    unit: Vec<f64>,
    halves: [Vec<f64>; 6],
    gel_errors: Vec<GelError>,
    /// With a layer.
    uneven: Option<UnevenCells>,
}

impl ForceEstimator {
    /// For the markers of this rest surface, row by row, `cols` in each, with the covariances of their
    /// positions.
    ///
    /// # Errors
    /// [`ForceError::Params`] for an invalid setting or `method = none`; [`ForceError::Lattice`] or
    /// [`ForceError::Pitch`] unless the markers are a square lattice; [`ForceError::Lengths`].
    pub fn new(
        params: &ForceParams,
        rest: &RestSurface,
        cols: usize,
        rest_covariance_mm2: &[Symmetric<3>],
    ) -> Result<Self, ForceError> {
        Self::with_compliance(params, rest, cols, rest_covariance_mm2, None)
    }

    /// As [`Self::new`], with the gel's compliance matrix in place of the layer.
    ///
    /// # Errors
    /// As [`Self::new`]; [`ForceError::Compliance`] if the matrix is of another lattice or gel, and
    /// [`ForceError::Params`] for `method = resultant`, which does not use it.
    pub fn with_compliance(
        params: &ForceParams,
        rest: &RestSurface,
        cols: usize,
        rest_covariance_mm2: &[Symmetric<3>],
        compliance: Option<Compliance>,
    ) -> Result<Self, ForceError> {
        let rows = rest.points_mm().len().checked_div(cols).unwrap_or(0);
        Self::on(params, rest, Topology::square(rows, cols), rest_covariance_mm2, compliance)
    }

    /// As [`Self::with_compliance`], for a print that may be hexagonal.
    ///
    /// # Errors
    /// As [`Self::with_compliance`]; [`ForceError::Params`] for the matrix of a hexagonal print.
    pub fn on(
        params: &ForceParams,
        rest: &RestSurface,
        topology: Topology,
        rest_covariance_mm2: &[Symmetric<3>],
        compliance: Option<Compliance>,
    ) -> Result<Self, ForceError> {
        params.validate().map_err(ForceError::Params)?;
        let stiffness = Stiffness::of(params);
        // Forces by stiffness do not depend on the modulus.
        let young_kpa = params.young_kpa.or(stiffness.map(|_| 1.0));
        let (Some(thickness_mm), Some(young_kpa), true) =
            (params.thickness_mm, young_kpa, params.method != ForceMethod::None)
        else {
            let (setting, required) = ("a wrench", "force.method other than \"none\"");
            return Err(ForceError::Params(ParamsError::Requires { setting, required }));
        };
        let (axes, grid) = Grid::of(rest.points_mm(), rest.normal(), topology)?;
        check_length(rest.points_mm().len(), rest_covariance_mm2.len())?;
        let (counts, pitch_mm) = (grid.counts(), grid.pitch_mm);
        let layer = Layer { thickness_mm, poisson_ratio: params.poisson_ratio };
        check_compliance(params, compliance.as_ref(), &grid, &layer)?;
        let rim_mm = params.rim_mm.filter(|mm| *mm <= MAX_RIM_PITCHES * pitch_mm);
        let sides = match &compliance {
            Some(compliance) => Some(compliance.sides(MAX_RIM_PITCHES)),
            None => rim_mm.map(|mm| FreeSides::new(counts, grid.step_mm(), [mm; 2])),
        };
        let side = match (&stiffness, &sides) {
            (Some(_), _) => 1,
            (None, Some(sides)) => sides.reach(),
            (None, None) => counts[0].max(counts[1]),
        };
        let mut made = Self {
            params: params.clone(),
            stiffness,
            young_kpa,
            influence: grid.influence(&layer, if compliance.is_some() { 1 } else { side }),
            sides,
            compliance,
            thickness_mm,
            rest: rest.clone(),
            rest_covariance_mm2: rest_covariance_mm2.to_vec(),
            axes,
            grid,
            cells: Cells::default(),
            equations: Equations::default(),
            posterior: Posterior::default(),
            variances: None,
            unit: Vec::new(),
            halves: Default::default(),
            gel_errors: if stiffness.is_some() {
                Vec::new()
            } else {
                GelError::all(params, &layer, &grid, side)
            },
            uneven: stiffness.is_none().then(|| UnevenCells::new(&layer, &grid)),
        };
        made.reserve();
        Ok(made)
    }

    /// Number of markers.
    #[must_use]
    pub fn markers(&self) -> usize {
        self.rest.points_mm().len()
    }

    /// Pitch of the lattice, millimetres.
    #[must_use]
    pub const fn pitch_mm(&self) -> f64 {
        self.grid.pitch_mm
    }

    /// Predicted work of the next frame, in units of 1000 instructions: that of a contact as large as the
    /// last one; 0 after a frame without contact.
    #[must_use]
    pub fn work(&self) -> u64 {
        if self.variances.is_none() {
            return 0;
        }
        let images = if self.sides.is_some() { 5 } else { 1 };
        let of_gel = if self.compliance.is_some() { 1 } else { images };
        // Uneven pressures take two assemblies of a layer without images.
        let uneven = if self.cells.are_merged() { 0 } else { 2 };
        let size = Size {
            markers: self.equations.count as f64 / 3.0,
            cells: self.cells.cells.len(),
            unknowns: self.equations.size,
            assemblies: uneven + of_gel + (of_gel + images) * self.gel_errors.len(),
            rounds: self.posterior.rounds,
        };
        size.work()
    }

    fn reserve(&mut self) {
        let size = 3 * MAX_BLOCKS.min(self.markers());
        self.cells.reserve(self.markers());
        self.equations.reserve(size);
        self.posterior.reserve(size);
        self.unit.reserve(size);
        self.halves.iter_mut().for_each(|half| half.reserve(size));
        self.gel_errors.iter_mut().for_each(|error| error.reserve(size));
        let markers = self.markers();
        self.uneven.iter_mut().for_each(|uneven| uneven.reserve(size, markers));
    }

    /// Tractions that the part exerts on the gel around each marker, in kilopascals along the sensor's axes,
    /// and their wrench; zero and `None` without contact, or where no marker of it is seen. `traction_kpa` is
    /// cleared first.
    ///
    /// # Errors
    /// [`ForceError::Lengths`] or [`ForceError::NotFinite`].
    pub fn run(
        &mut self,
        moved: &MovedMarkers<'_>,
        traction_kpa: &mut Vec<DVec3>,
    ) -> Result<Option<Wrench>, ForceError> {
        let markers = self.markers();
        let MovedMarkers { points_mm, covariance_mm2, state, patch } = moved;
        for found in [points_mm.len(), covariance_mm2.len(), state.len(), patch.len()] {
            check_length(markers, found)?;
        }
        let is_bad =
            |(point, &state): (&DVec3, &MarkerState)| state == MarkerState::Seen && !point.is_finite();
        if let Some(index) = points_mm.iter().zip(*state).position(is_bad) {
            return Err(ForceError::NotFinite { index });
        }
        traction_kpa.clear();
        traction_kpa.resize(markers, DVec3::ZERO);
        if !self.cells.choose(patch, &self.grid) {
            self.variances = None;
            return Ok(None);
        }
        if let Some(stiffness) = self.stiffness {
            self.surround();
            let place = Place {
                rest: &self.rest,
                axes: &self.axes,
                sides_mm: self.grid.sides_mm,
                near: &self.cells.near,
                is_cut: self.cells.is_cut,
            };
            let found = stiffness.wrench(&place, moved, &self.rest_covariance_mm2);
            if let Some(wrench) = &found {
                spread(wrench, &place, moved, traction_kpa);
            }
            return Ok(found);
        }
        self.assemble(moved);
        if self.equations.count == 0 || !self.solve() {
            self.variances = None;
            return Ok(None);
        }
        self.differentiate(moved);
        let strain = Strain::of(moved, &self.rest, (self.axes[0], self.thickness_mm));
        let share = strain.share(&self.params, self.sides.is_some());
        let young_kpa = self.young_kpa * (1.0 + self.params.stiffening * strain.largest);
        let scale = young_kpa * N_PER_KPA_MM2 * self.grid.sides_mm[0] * self.grid.sides_mm[1];
        (0..6).for_each(|k| self.load(k, scale));
        let of_cells = self.of_uneven_cells(moved, scale);
        let wrench = self.wrench(scale, share, &of_cells);
        if self.params.method == ForceMethod::Bounded {
            project(&mut self.posterior, self.params.friction);
        }
        for cell in &self.cells.cells {
            traction_kpa[cell.marker] = self.traction(cell.block) * young_kpa;
        }
        Ok(Some(wrench))
    }

    /// The patch of the last frame with its neighbours that the part presses, from these tractions of the
    /// same frame; the patch itself where cells are merged or there are no tractions. `out` is cleared first.
    ///
    /// Patches from heights leave out a fifth of a round contact, which is hardly pressed.
    ///
    /// # Errors
    /// [`ForceError::Lengths`].
    pub fn touching(
        &self,
        traction_kpa: &[DVec3],
        patch: &[bool],
        out: &mut Vec<bool>,
    ) -> Result<(), ForceError> {
        check_length(self.markers(), traction_kpa.len())?;
        check_length(self.markers(), patch.len())?;
        out.clear();
        out.extend_from_slice(patch);
        if self.stiffness.is_some() || self.cells.blocks != self.cells.cells.len() {
            return Ok(());
        }
        let pressure_kpa = |cell: &Cell| traction_kpa[cell.marker].dot(self.axes[0]);
        let largest_kpa = self.cells.cells.iter().map(pressure_kpa).fold(0.0, f64::max);
        for cell in self.cells.cells.iter().filter(|cell| pressure_kpa(cell) > PRESSED * largest_kpa) {
            out[cell.marker] = true;
        }
        Ok(())
    }

    fn surround(&mut self) {
        self.cells.surround(&self.grid, REACH * self.thickness_mm / self.grid.pitch_mm);
    }

    /// Collects the equations of the seen markers around the contact.
    fn assemble(&mut self, moved: &MovedMarkers<'_>) {
        self.surround();
        self.equations.clear(3 * self.cells.blocks);
        for &n in self.cells.near.iter().filter(|&&n| moved.state[n] == MarkerState::Seen) {
            let (motion_mm, covariance_mm2) = self.motion(moved, n);
            let place = self.grid.place(n);
            let gel = Gel::new(&self.influence, self.sides.as_ref(), self.compliance.as_ref());
            self.equations.add(gel, &self.cells, place, motion_mm, &covariance_mm2);
        }
        self.equations.mirror();
    }

    /// Motion of a marker since rest, into the layer, along rows and along columns, and its covariance.
    fn motion(&self, moved: &MovedMarkers<'_>, n: usize) -> ([f64; 3], Symmetric<3>) {
        let motion_mm = moved.points_mm[n] - self.rest.points_mm()[n];
        let both = (&moved.covariance_mm2[n], &self.rest_covariance_mm2[n]);
        let covariance_mm2 = core::array::from_fn(|i| {
            core::array::from_fn(|k| {
                (0..9)
                    .map(|jl| (jl / 3, jl % 3))
                    .map(|(j, l)| self.axes[i][j] * (both.0[j][l] + both.1[j][l]) * self.axes[k][l])
                    .sum()
            })
        });
        (self.axes.map(|axis| motion_mm.dot(axis)), covariance_mm2)
    }

    /// Derivatives of the tractions by the numbers of the gel that are not known exactly.
    fn differentiate(&mut self, moved: &MovedMarkers<'_>) {
        let mut errors = core::mem::take(&mut self.gel_errors);
        let noise = self.variances.map_or(1.0, |variances| variances.noise);
        for error in &mut errors {
            error.right.clear();
            error.right.resize(self.equations.size, 0.0);
            for k in 0..self.cells.near.len() {
                let n = self.cells.near[k];
                if moved.state[n] != MarkerState::Seen {
                    continue;
                }
                let (motion_mm, covariance_mm2) = self.motion(moved, n);
                self.equations.differentiate(
                    (
                        Gel::new(&self.influence, self.sides.as_ref(), self.compliance.as_ref()),
                        Gel::new(&error.derivative, self.sides.as_ref(), None),
                    ),
                    &self.cells,
                    self.grid.place(n),
                    (motion_mm, &covariance_mm2),
                    &self.posterior.x,
                    &mut error.right,
                );
            }
            error.right.iter_mut().for_each(|entry| *entry /= noise);
            self.posterior.factor.half(&error.right, &mut error.half);
        }
        self.gel_errors = errors;
    }

    /// Covariance of what the estimate misses of pressures that are not uniform on their cells.
    fn of_uneven_cells(&mut self, moved: &MovedMarkers<'_>, scale: f64) -> Symmetric<6> {
        // Merged cells have larger errors of another kind.
        let is_merged = self.cells.are_merged();
        let Some(mut uneven) = self.uneven.take_if(|_| !is_merged) else { return Default::default() };
        let noise = self.variances.map_or(1.0, |variances| variances.noise);
        uneven.begin((&self.posterior.factor, &self.halves), &self.axes, (scale, self.cells.cells.len()));
        for k in 0..self.cells.near.len() {
            let n = self.cells.near[k];
            let (covariance_mm2, place) = (self.motion(moved, n).1, self.grid.place(n));
            let gel = Gel::new(&self.influence, self.sides.as_ref(), self.compliance.as_ref());
            let (cells, solved, is_seen) =
                (&self.cells, uneven.solved(), moved.state[n] == MarkerState::Seen);
            let by = is_seen.then(|| self.equations.by_motion(gel, cells, place, &covariance_mm2, solved));
            if let Some(by) = by.flatten() {
                uneven.subtract(cells, place, &by.map(|by| by.map(|entry| entry / noise)));
            }
        }
        let covariance = uneven.covariance(&self.cells.cells, |block| self.posterior.x[3 * block]);
        self.uneven = Some(uneven);
        covariance
    }

    /// Returns whether the tractions are determined.
    fn solve(&mut self) -> bool {
        let mut variances = match self.variances {
            Some(last) if last.shear > MIN_SHEAR * last.pressure => last,
            _ => START,
        };
        if !self.posterior.fit(&self.equations, &mut variances) {
            return false;
        }
        self.variances = Some(variances);
        true
    }

    /// From the point of reference to a cell.
    fn arm_mm(&self, cell: &Cell) -> DVec3 {
        self.rest.points_mm()[cell.marker] - self.rest.centre_mm()
    }

    /// Traction of a block in the sensor frame, in units of Young's modulus.
    fn traction(&self, block: usize) -> DVec3 {
        let x = &self.posterior.x[3 * block..][..3];
        self.axes[0] * x[0] + self.axes[1] * x[1] + self.axes[2] * x[2]
    }

    /// `model_share` is added to the uncertainty of pressures and, apart from these, of shears.
    fn wrench(&self, scale: f64, model_share: f64, of_cells: &Symmetric<6>) -> Wrench {
        // Wrenches of the pressures and of the shears.
        let mut parts = [[0.0; 6]; 2];
        let (mut pressing_n, mut moment_nmm) = (0.0, DVec3::ZERO);
        for cell in &self.cells.cells {
            let force = self.traction(cell.block) * scale;
            let of_cell_n = force.dot(self.axes[0]);
            let pressing = self.axes[0] * of_cell_n;
            let arm_mm = self.arm_mm(cell);
            pressing_n += of_cell_n;
            moment_nmm += arm_mm * of_cell_n;
            for (part, force) in parts.iter_mut().zip([pressing, force - pressing]) {
                let loads = force.to_array().into_iter().chain(arm_mm.cross(force).to_array());
                part.iter_mut().zip(loads).for_each(|(sum, load)| *sum += load);
            }
        }
        let loads: [f64; 6] = core::array::from_fn(|k| parts[0][k] + parts[1][k]);
        // All loads share the modulus.
        let modulus_share = self.params.young_sigma_kpa / self.young_kpa;
        // Shear forces at the middle of the pressures.
        let crosstalk = [1, 2].map(|axis| {
            let (force, torque) = (self.axes[axis] * pressing_n, moment_nmm.cross(self.axes[axis]));
            let [[a, b, c], [d, e, f]] = [force, torque].map(|v| (v * OF_PRESSING).to_array());
            [a, b, c, d, e, f]
        });
        let halves = &self.halves;
        let mut of_gel = [[0.0; 6]; GelError::MOST];
        of_gel.iter_mut().zip(&self.gel_errors).for_each(|(loads, error)| *loads = error.loads(halves));
        let covariance = core::array::from_fn(|i| {
            core::array::from_fn(|k| {
                let own: f64 = halves[i].iter().zip(&halves[k]).map(|(a, b)| a * b).sum();
                let product = |part: &[f64; 6]| part[i] * part[k];
                let of_model = model_share * model_share * parts.iter().map(product).sum::<f64>();
                let of_modulus = modulus_share * modulus_share * product(&loads);
                own + of_model
                    + of_modulus
                    + crosstalk.iter().map(product).sum::<f64>()
                    + of_gel.iter().map(product).sum::<f64>()
                    + of_cells[i][k]
            })
        });
        let [fx, fy, fz, tx, ty, tz] = loads;
        Wrench {
            force_n: DVec3::new(fx, fy, fz),
            torque_nmm: DVec3::new(tx, ty, tz),
            about_mm: self.rest.centre_mm(),
            covariance,
            misfit: self.variances.map_or(1.0, |variances| variances.noise),
            cells: self.cells.cells.len(),
            markers: self.equations.count / 3,
            is_cut: self.cells.is_cut,
        }
    }

    /// Fills `halves` for one component of the wrench.
    fn load(&mut self, component: usize, scale: f64) {
        self.unit.clear();
        self.unit.resize(self.equations.size, 0.0);
        for cell in &self.cells.cells {
            let arm_mm = self.arm_mm(cell);
            for (axis, unit) in self.axes.iter().zip(&mut self.unit[3 * cell.block..]) {
                *unit +=
                    scale * if component < 3 { axis[component] } else { arm_mm.cross(*axis)[component - 3] };
            }
        }
        self.posterior.factor.half(&self.unit, &mut self.halves[component]);
    }
}

fn check_length(rest: usize, found: usize) -> Result<(), ForceError> {
    if rest == found { Ok(()) } else { Err(ForceError::Lengths { rest, found }) }
}
