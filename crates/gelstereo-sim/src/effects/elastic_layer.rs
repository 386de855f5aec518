//! The gel as an elastic layer.

use crate::lattice::Lattice;
use crate::layer::{Grid, Layer, Places};
use crate::plan::{Bound, Effect, Facts};
use crate::scene::{Gel, SceneError};

/// The gel deforms as an elastic layer bonded to its plate: it sags, rises and moves sideways, and
/// sticks to the part within the friction bound.
///
/// Model: the contact problem of linear elasticity, solved on cells finer than the markers' pitch
/// ([`crate::layer::LayerContact`]). [`super::Shoulder`], [`super::Spread`] and [`super::Drag`] are
/// approximations of it, and a scene cannot have both. Limits: small strain (see
/// [`super::LargeStrain`]); the result depends on the part's pose only, not on its path (slip on the way
/// is not modelled); nothing presses on gel farther out than `border_pitches`.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct ElasticLayer {
    /// Poisson's ratio, 0 to 0.5. Default: `0.48`, a soft silicone.
    pub poisson_ratio: f64,
    /// Young's modulus, kPa. The surface does not depend on it, but the loads do. Default: `100`, a soft
    /// silicone.
    pub young_kpa: f64,
    /// Coulomb's coefficient between part and gel; 0 lets everything slip. Default: `0.8`.
    pub friction: f64,
    /// Cells of the contact problem per marker pitch; in a hexagonal print per distance of rows, and along
    /// rows rounded up to an even number. Default: `2`.
    pub cells_per_pitch: usize,
    /// Margin beyond the outermost markers within which the part may press, in pitches. Default: `2`.
    pub border_pitches: usize,
    /// Gel beyond the outermost markers, up to its free sides, mm; rounded to half a cell. It sinks and moves
    /// farther near them, and nothing presses beyond them. With `relaxation`, the motion by the sides is not
    /// remembered. Default: absent, the gel has no end.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub rim_mm: Option<f64>,
}

/// Largest motion over that of a layer without sides.
const OF_SIDES: f64 = 1.5;

impl Default for ElasticLayer {
    fn default() -> Self {
        let (cells_per_pitch, border_pitches, rim_mm) = (2, 2, None);
        Self { poisson_ratio: 0.48, young_kpa: 100.0, friction: 0.8, cells_per_pitch, border_pitches, rim_mm }
    }
}

impl ElasticLayer {
    /// Distance to the part at which a cell in contact has converged: 0.1 um is 2e-3 px on the default
    /// rig.
    pub(crate) const TOLERANCE_MM: f64 = 1e-4;
    /// Largest rim, in thicknesses. Sides that far away move nothing: motion falls by half in a thickness.
    const MAX_RIM: f64 = 20.0;

    /// The layer, the cells, and the markers' places on them.
    pub(crate) fn cells(&self, gel: &Gel) -> (Layer, Grid, Places) {
        let lattice = Lattice::new(gel);
        let (cells, apart) = (self.cells_per_pitch, lattice.apart);
        let step = [cells, cells.div_ceil(apart)];
        let border = [step[0], apart * step[1]].map(|pitch| self.border_pitches * pitch);
        let places = Places { rows: lattice.rows, cols: lattice.cols, step, border };
        let [rows, cols] = places.cells();
        let layer = Layer { thickness_mm: gel.thickness_mm, poisson_ratio: self.poisson_ratio };
        let [x_mm, y_mm] = lattice.pitch_mm;
        (layer, Grid { rows, cols, cell_mm: [x_mm / step[1] as f64, y_mm / step[0] as f64] }, places)
    }
}

impl Effect for ElasticLayer {
    fn validate(&self, gel: &Gel) -> Result<(), SceneError> {
        let check = SceneError::check;
        let Self {
            poisson_ratio: nu,
            young_kpa,
            friction,
            cells_per_pitch: cells,
            border_pitches: border,
            ..
        } = *self;
        check((0.0..=0.5).contains(&nu), "effects.elastic_layer.poisson_ratio", nu, "0 to 0.5")?;
        let valid = (1e-3..=1e6).contains(&young_kpa);
        check(valid, "effects.elastic_layer.young_kpa", young_kpa, "0.001 to 1000000 kPa")?;
        check((0.0..=1e6).contains(&friction), "effects.elastic_layer.friction", friction, "0 to 1e6")?;
        let name = "effects.elastic_layer.cells_per_pitch";
        check((1..=16).contains(&cells), name, cells as f64, "1 to 16")?;
        let name = "effects.elastic_layer.border_pitches";
        check(border <= 64, name, border as f64, "0 to 64")?;
        if let Some(rim_mm) = self.rim_mm {
            let [x_mm, y_mm] = gel.spacing_mm();
            let valid = (0.5 * x_mm.max(y_mm)..=Self::MAX_RIM * gel.thickness_mm).contains(&rim_mm);
            let name = "effects.elastic_layer.rim_mm";
            check(valid, name, rim_mm, "half of gel.pitch_mm to 20 times gel.thickness_mm")?;
        }
        let (layer, grid, _) = self.cells(gel);
        let (cell_mm, side) = (grid.cell_mm[0].max(grid.cell_mm[1]), grid.rows.max(grid.cols));
        let name = "cell of effects.elastic_layer, gel.pitch_mm / cells_per_pitch,";
        check(
            cell_mm <= layer.thickness_mm,
            name,
            cell_mm,
            "at most gel.thickness_mm: raise cells_per_pitch",
        )?;
        let name = "cells of effects.elastic_layer along a side";
        check(side <= 256, name, side as f64, "at most 256: lower cells_per_pitch or border_pitches")
    }

    fn bound(&self, facts: &Facts<'_>) -> Bound {
        // Heights range from a bulge, lower than the depth, to the depth. Sides add less than half of it.
        let of_sides = if self.rim_mm.is_some() { OF_SIDES } else { 1.0 };
        facts.moved(of_sides * self.sideways_mm(facts), 2.0 * of_sides * facts.touch.depth_mm)
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        let per_pitch = (self.cells_per_pitch * self.cells_per_pitch) as f64;
        let cells = facts.markers() * per_pitch;
        let [x_mm, y_mm] = facts.scene.gel.spacing_mm();
        let pressed = (facts.touch.footprint_mm2 / (x_mm * y_mm) * per_pitch).min(cells);
        let products = if self.friction > 0.0 { 120.0 } else { 12.0 };
        // Heights of cells; transforms over about twice the pressed cells; sums over cells and markers.
        let once = 30.0 * cells + 150.0 * products * (pressed + 64.0) + pressed * facts.markers() * 3.0;
        // Further solves, and sums over four images of every loaded cell.
        let images = if self.rim_mm.is_some() { 1.0 } else { 0.0 };
        once + images * (2.0 * once + 4.0 * 10.0 * pressed * (facts.markers() + 3.0 * pressed))
    }

    /// A wide part displaces depth times half the span of gel, spread over the thickness. The surface
    /// moves 3/2 of that mean (parabolic profile, free at the top). Under a narrow part it moves less
    /// than the depth. Sticking gel also moves with the part.
    fn sideways_mm(&self, facts: &Facts<'_>) -> f64 {
        let touch = &facts.touch;
        let wide = 0.75 * touch.span_mm / facts.scene.gel.thickness_mm;
        let carried = if self.friction > 0.0 { touch.grip_mm() } else { 0.0 };
        touch.depth_mm * (1.0 + wide) + carried
    }
}
