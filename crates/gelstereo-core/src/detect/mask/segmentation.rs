//! Segmentation: pixels that differ from the background, as connected components.

use super::background::Difference;
use super::components::{Components, Limits};
use super::morphology::Closing;
use crate::detect::error::DetectError;
use crate::image::GrayView;
use crate::params::DetectParams;
use alloc::vec::Vec;

/// Smaller components do not mask pixels of a marker beside them.
pub(in crate::detect) const MIN_NEIGHBOUR_PX2: u32 = 3;

/// Background, threshold, closing and components, with their scratch.
#[derive(Clone, Debug)]
pub(in crate::detect) struct Segmentation {
    difference: Difference,
    closing: Closing,
    /// Whether closing changes anything.
    closes: bool,
    pub components: Components,
    /// Whole mask of 0 and 255, or only its last row.
    mask: Vec<u8>,
}

impl Segmentation {
    /// Creates the segmentation from its settings.
    pub fn new(params: &DetectParams) -> Self {
        Self {
            difference: Difference::new(params),
            closing: Closing::new(params.morphology_kernel_px),
            closes: params.morphology_kernel_px > 1,
            components: Components::keeping(params.areas_px2()[0].min(MIN_NEIGHBOUR_PX2)),
            mask: Vec::new(),
        }
    }

    /// Finds the components. The whole mask is stored only if closing is on.
    ///
    /// # Errors
    /// [`DetectError::TooMany`].
    pub fn run(&mut self, image: GrayView<'_>) -> Result<(), DetectError> {
        let (width, height) = (image.width(), image.height());
        if self.closes {
            self.mask_all(image);
        } else {
            self.difference.survey(image);
            self.mask.resize(width, 0);
        }
        let max = Limits::of(width, height);
        self.components.start(width, height);
        for y in 0..height {
            if self.closes {
                self.components.push(&self.mask[y * width..(y + 1) * width]);
            } else {
                self.difference.row(image, y, &mut self.mask);
                self.components.push(&self.mask);
            }
            // Rows below could still join components, but an image of markers never comes near the limit.
            let counts =
                [(self.components.all_runs().len(), max.runs), (self.components.count(), max.components)];
            if let Some((found, max)) = counts.into_iter().find(|(found, max)| found > max) {
                return Err(DetectError::TooMany { found, max });
            }
        }
        self.components.finish();
        let found = self.components.kept();
        if found > max.kept { Err(DetectError::TooMany { found, max: max.kept }) } else { Ok(()) }
    }

    /// [`Thresholds::feels_noise`](super::threshold::Thresholds::feels_noise) of the last image.
    pub const fn feel_noise(&self) -> bool {
        self.difference.thresholds().feels_noise()
    }

    /// Pixels of the last image that were closed around reflections, counted each time.
    pub const fn closed_px(&self) -> usize {
        self.difference.closed_px()
    }

    /// Computes the mask of the whole image, without components.
    fn mask_all(&mut self, image: GrayView<'_>) {
        self.difference.survey(image);
        let width = image.width();
        self.mask.resize(width * image.height(), 0);
        for (y, row) in self.mask.chunks_exact_mut(width).enumerate() {
            self.difference.row(image, y, row);
        }
        self.closing.run(&mut self.mask, width);
    }

    /// Writes the mask of the components for an image of this size, row by row: 255 where a pixel belongs
    /// to one. Each component pixel covers `scale` x `scale` image pixels.
    pub fn draw_scaled(&self, size_px: (usize, usize), scale: usize, out: &mut Vec<u8>) {
        let (width, height) = size_px;
        out.clear();
        out.resize(width * height, 0);
        for run in self.components.all_runs() {
            for y in run.y as usize * scale..(run.y as usize + 1) * scale {
                let first = y * width;
                out[first + run.start as usize * scale..first + run.end as usize * scale].fill(u8::MAX);
            }
        }
    }
}
