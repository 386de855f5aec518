//! Rows and columns of the rest frame, alike in both views.

use super::common_rest::Views;
use super::{Pipeline, PipelineError};
use crate::lattice::{LabelError, LatticeFinder, RestLattice};

impl Pipeline {
    /// Labels the rest frame in both views; where a border is not whole in view, by what both show.
    pub(super) fn label_rest(&mut self) -> Result<[RestLattice; 2], PipelineError> {
        self.triangulator.clear_map();
        let mut finder = LatticeFinder::default();
        let whole = self.label_whole(&mut finder);
        let views = Views { params: &self.params, ready: self.triangulator.ready() };
        let is_partial = match &whole {
            Ok(rests) => views.may_be_others([&self.left, &self.right], rests),
            Err(error) => is_of_borders(error) || matches!(error, PipelineError::Lattices { .. }),
        };
        // `lattice.missing` counts from a border.
        if !is_partial || !self.params.lattice.missing.is_empty() {
            return whole;
        }
        match views.label(&mut finder, [&self.left, &self.right]) {
            Ok(common) => Ok(common),
            // Without a rectangle, what the views show by themselves is the clearer error.
            Err(error) if whole.is_ok() || is_of_borders(&error) => whole,
            Err(error) => Err(error),
        }
    }

    fn label_whole(&self, finder: &mut LatticeFinder) -> Result<[RestLattice; 2], PipelineError> {
        let left = self.left.label(&self.params, finder, None)?;
        let right = self.right.label(&self.params, finder, Some(&left))?;
        let side = |rest: &RestLattice| (rest.rows, rest.cols);
        if side(&left) != side(&right) {
            return Err(PipelineError::Lattices { left: side(&left), right: side(&right) });
        }
        Ok([left, right])
    }

    /// Rows and columns beyond the labelled ones that a view shows at rest: above, right, below and left.
    /// They are left out where they are not whole in both views, or beyond `lattice.rows` and
    /// `lattice.cols`.
    #[must_use]
    pub const fn left_out(&self) -> [usize; 4] {
        self.left_out
    }
}

/// Whether a view's rows and columns could not be counted.
const fn is_of_borders(error: &PipelineError) -> bool {
    matches!(error, PipelineError::Label { error: LabelError::Border { .. } | LabelError::Shape { .. }, .. })
}
