//! Starts a pipeline from a recorded rest frame.

use super::epipolar::Epipolar;
use super::{Pipeline, PipelineError, RestRecord, RestRecordError};
use crate::contact::RestSurface;
use crate::lattice::Topology;
use crate::params::{DetectParams, Search};
use alloc::vec::Vec;

impl Pipeline {
    /// Data that [`Self::resume`] needs to start without a rest frame; `None` before the rest frame.
    #[must_use]
    pub fn rest_record(&self) -> Option<RestRecord> {
        let rest = self.rest.as_ref()?;
        Some(RestRecord {
            rows: self.left.rows,
            cols: self.left.cols,
            points_mm: rest.points_mm().to_vec(),
            variance_mm2: self.rest_variance_mm2.clone(),
            noise_scale: self.epipolar.scale,
            epipolar_px: self.epipolar.smooth.map(Vec::from).unwrap_or_default(),
            dot_radius_pitches: self.discs.radius_pitches(),
            left: self.left.rest_view(),
            right: self.right.rest_view(),
            rig: self.rig().clone(),
            lattice: self.params.lattice.clone(),
            detect: self.params.detect.clone(),
            triangulate: self.params.triangulate.clone(),
        })
    }

    /// Starts from a recorded rest frame: the next frame has index 1, with or without contact.
    ///
    /// Rows and columns are found as after a gap in tracking: the record's labels must agree with the
    /// lattice in the image, its border, and the unprinted places of `lattice.missing`. Until that is
    /// certain all markers are held, with the source [`LabelSource::Held`](super::LabelSource::Held).
    ///
    /// # Errors
    /// [`PipelineError::Record`] for a record that is damaged, or was made with another rig, lattice,
    /// detection or triangulation; [`PipelineError::Contact`] for points that span no surface. The
    /// pipeline is then unchanged.
    pub fn resume(&mut self, record: &RestRecord) -> Result<(), PipelineError> {
        self.check_record(record).map_err(PipelineError::Record)?;
        let rest = RestSurface::new(&record.points_mm).map_err(PipelineError::Contact)?;
        let lattice = (record.rows, record.cols);
        self.left.forget();
        self.right.forget();
        self.left.resume(&self.params, lattice, &record.left);
        self.right.resume(&self.params, lattice, &record.right);
        self.triangulator.clear_map();
        self.left_out = [0; 4];
        self.topology = Topology::of(record.lattice.layout, record.cols, &record.points_mm);
        self.discs.resume(self.topology, record.dot_radius_pitches);
        self.points_mm.clone_from(&record.points_mm);
        self.rest_variance_mm2.clone_from(&record.variance_mm2);
        let smooth = record.epipolar_px.as_slice().try_into().ok();
        self.epipolar = Epipolar::resume(self.topology, record.noise_scale, smooth);
        // The variance along the normal, nearly the least certain direction, for all axes.
        self.covariance_mm2.clear();
        self.covariance_mm2.extend(
            record
                .variance_mm2
                .iter()
                .map(|&variance| [[variance, 0.0, 0.0], [0.0, variance, 0.0], [0.0, 0.0, variance]]),
        );
        (self.frames, self.resumes) = (1, true);
        self.rest_on(rest)
    }

    fn check_record(&self, record: &RestRecord) -> Result<(), RestRecordError> {
        record.validate()?;
        if record.rig != *self.rig() {
            return Err(RestRecordError::Rig);
        }
        // The search region does not affect a marker's position.
        let detect = |params: &DetectParams| DetectParams { search: Search::Whole, ..params.clone() };
        for (table, same) in [
            ("lattice", record.lattice == self.params.lattice),
            ("detect", detect(&record.detect) == detect(&self.params.detect)),
            ("triangulate", record.triangulate == self.params.triangulate),
        ] {
            if !same {
                return Err(RestRecordError::Settings { table });
            }
        }
        Ok(())
    }
}
