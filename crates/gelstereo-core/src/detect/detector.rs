//! The detection stage: selects the search and the centring rung, and crops to the region of interest.

use super::centre::Rung;
use super::centre::covered::Glares;
use super::error::DetectError;
use super::found::Found;
use super::markers::{Markers, max_markers};
use super::mask::segmentation::Segmentation;
use super::mask::threshold::MIN_LEVELS;
use super::outline::Outline;
use super::search::half::{self, HalfSize};
use super::search::whole;
use super::search::windows::WindowSearch;
use super::window::size::MarkerSize;
use super::workload::Workload;
use crate::image::GrayView;
use crate::math::{DVec2, ceil, sqrt};
use crate::params::{Centre, DetectParams, FindAt, Region, Threshold};
use alloc::vec::Vec;

/// The detection stage and its scratch.
#[derive(Clone, Debug)]
pub struct Detector {
    params: DetectParams,
    segmentation: Segmentation,
    half: Option<HalfSize>,
    rung: Rung,
    windows: WindowSearch,
    glares: Glares,
    /// Region of interest: first column and row, width and height; `None` for the whole image.
    roi_px: Option<[usize; 4]>,
    /// In coordinates of the region of interest.
    outline: Outline,
    /// Size of the region searched.
    size_px: (usize, usize),
    whole_px: (usize, usize),
    areas_px2: Vec<u32>,
}

impl Detector {
    /// Creates the stage from its settings (already validated by `Params::validate`).
    #[must_use]
    pub fn new(params: &DetectParams) -> Self {
        Self {
            params: params.clone(),
            segmentation: Segmentation::new(params),
            half: HalfSize::new(params),
            rung: Rung::new(params),
            windows: WindowSearch::new(params),
            glares: Glares::default(),
            roi_px: None,
            outline: Outline::default(),
            size_px: (0, 0),
            whole_px: (0, 0),
            areas_px2: Vec::new(),
        }
    }

    /// Restricts the search to a region of interest. Positions stay in coordinates of the whole image.
    /// Markers cut by the border of its rectangle are listed in [`Markers::cut`]. Components
    /// outside its outline are no markers.
    #[must_use]
    pub fn within(self, Region { rect_px, outline_px }: Region<'_>) -> Self {
        let [x, y, ..] = rect_px.unwrap_or_default();
        let outline = Outline::new(outline_px, DVec2::new(x as f64, y as f64));
        let mut windows = self.windows;
        windows.outline = Outline::new(outline_px, DVec2::ZERO);
        // The search at half size does not check the outline.
        let half = self.half.filter(|_| outline.is_empty());
        Self { roi_px: rect_px, outline, windows, half, ..self }
    }

    /// Discards what was learned from earlier images (the usual marker of [`Centre::Fit`], the noise of
    /// [`Centre::SoftThreshold`]), so that the next result is bit-identical to that of a first image.
    pub fn reset(&mut self) {
        self.rung.get().forget();
    }

    /// Finds the markers; `out` is cleared first. Does not allocate after the first image of a size.
    ///
    /// The covariances are those of gel that does not fold within the dots; [`Folds`](super::Folds) adds what
    /// folds do. Components that reach the outermost pixels of the image are listed in [`Markers::cut`],
    /// since the centre of the visible part is not the marker's. An image with contrast but without markers
    /// gives an empty list.
    ///
    /// # Errors
    /// [`DetectError`]; `out` is then empty.
    pub fn run(&mut self, image: GrayView<'_>, out: &mut Markers) -> Result<(), DetectError> {
        out.clear();
        let (image, origin_px) = self.part(image)?;
        self.check(image)?;
        self.make_room(image);
        let max = max_markers(&self.params, self.size_px);
        // Along the border, at most every second pixel starts a marker.
        out.reserve(max, max.min(image.width() + image.height()));
        self.areas_px2.clear();
        self.areas_px2.reserve(max);
        let Self { params, outline, segmentation, half, rung, areas_px2, .. } = self;
        let is_complete = match (half, &mut *rung) {
            (Some(half), Rung::SoftThreshold(rung)) => half.run(image, rung, areas_px2, max, out),
            _ => false,
        };
        if !is_complete {
            whole::run(params, image, outline, segmentation, areas_px2, rung.get(), out)?;
        }
        self.doubt_under_glare(image, out);
        out.shift(origin_px);
        Ok(())
    }

    /// Marker size for [`Self::run_windows`], from the usual area and the pitch; `None` if these settings
    /// do not allow that search.
    #[must_use]
    pub fn size_for_windows(&self, usual_area_px2: f64, pitch_px: f64) -> Option<MarkerSize> {
        let suits = self.params.threshold == Threshold::Auto
            && matches!(self.params.centre, Centre::SoftThreshold | Centre::Fit);
        MarkerSize::of(usual_area_px2).filter(|size| suits && size.fits(pitch_px))
    }

    /// Reserves memory for [`Self::run_windows`] on images of this size.
    pub fn reserve_windows(
        &mut self,
        positions: usize,
        size: &MarkerSize,
        size_px: (usize, usize),
        out: &mut Found,
    ) {
        self.windows.reserve(positions, size, size_px);
        self.rung.get().reserve_windows(positions, size_px);
        self.glares.reserve(size_px);
        self.areas_px2.clear();
        self.areas_px2.reserve(positions);
        out.markers.reserve(positions, 0);
        out.sights.reserve(positions);
    }

    /// Searches for one marker within `reach_px` of each expected position, in both axes, reading only
    /// windows of the image. `out` is cleared first.
    ///
    /// Each window has its own gel level and threshold. No marker is assigned twice. A model fit starts from
    /// the soft-threshold centroid, with what was learned in the last [`Self::run`].
    /// Does not allocate after [`Self::reserve_windows`].
    pub fn run_windows(
        &mut self,
        image: GrayView<'_>,
        expected_px: &[DVec2],
        reach_px: f64,
        size: &MarkerSize,
        out: &mut Found,
    ) {
        out.clear();
        self.reserve_windows(expected_px.len(), size, (image.width(), image.height()), out);
        self.windows.run(image, self.rung.get(), expected_px, reach_px, size, out);
        self.doubt_under_glare(image, &mut out.markers);
    }

    /// Image scale at which the markers of the last image were found.
    #[must_use]
    pub fn found_at(&self) -> FindAt {
        match self.searched() {
            (_, half::SCALE) => FindAt::HalfSize,
            _ => FindAt::FullSize,
        }
    }

    /// What the last whole image showed of the work of later ones.
    #[must_use]
    pub fn workload(&self) -> Workload {
        let (segmentation, _) = self.searched();
        let (found_at, closed_px) = (self.found_at(), segmentation.closed_px());
        let mut workload = Workload { found_at, closed_px, ..Workload::default() };
        self.rung.add_workload(&mut workload);
        workload
    }

    /// Writes the mask of the last image, row by row: 255 where a pixel belongs to a component.
    pub fn mask(&self, out: &mut Vec<u8>) {
        let (segmentation, scale) = self.searched();
        segmentation.draw_scaled(self.size_px, scale, out);
        let Some([x, y, columns, _]) = self.roi_px.filter(|_| self.size_px != (0, 0)) else { return };
        let part = core::mem::take(out);
        out.resize(self.whole_px.0 * self.whole_px.1, 0);
        let rows = out.chunks_exact_mut(self.whole_px.0).skip(y);
        rows.zip(part.chunks_exact(columns))
            .for_each(|(row, part)| row[x..x + columns].copy_from_slice(part));
    }

    /// Segmentation used for the last image, and its scale: image columns and rows per pixel.
    fn searched(&self) -> (&Segmentation, usize) {
        let half = self.half.as_ref().and_then(HalfSize::complete);
        half.map_or((&self.segmentation, 1), |segmentation| (segmentation, half::SCALE))
    }

    /// The region searched and its origin.
    fn part<'a>(&mut self, image: GrayView<'a>) -> Result<(GrayView<'a>, DVec2), DetectError> {
        self.whole_px = (image.width(), image.height());
        let Some(roi_px) = self.roi_px else { return Ok((image, DVec2::ZERO)) };
        let [x, y, columns, rows] = roi_px;
        let part = match DetectError::beyond(roi_px, self.whole_px) {
            None => image.crop(x, y, columns, rows).ok(),
            Some(_) => None,
        };
        let (width, height) = self.whole_px;
        let part = part.ok_or(DetectError::Region { roi_px, width, height })?;
        Ok((part, DVec2::new(x as f64, y as f64)))
    }

    fn check(&self, image: GrayView<'_>) -> Result<(), DetectError> {
        let (width, height) = (image.width(), image.height());
        let min_side_px = ceil(sqrt(f64::from(self.params.areas_px2()[0]))) as usize + 2;
        if width.min(height) < min_side_px {
            return Err(DetectError::TooSmall { width, height, min_side_px });
        }
        let threshold_levels = match self.params.threshold {
            Threshold::Fixed => self.params.threshold_levels,
            Threshold::Auto => MIN_LEVELS,
        };
        if !image.spans(threshold_levels) {
            let (low, high) = image.range();
            return Err(DetectError::Flat { low, high, threshold_levels });
        }
        Ok(())
    }

    /// The first image of a size is segmented at both scales, so that later ones need no more memory.
    fn make_room(&mut self, image: GrayView<'_>) {
        let size_px = (image.width(), image.height());
        if let (Some(half), true) = (&mut self.half, self.size_px != size_px) {
            half.reserve(image, &mut self.areas_px2);
            // Too many components is reported by the search itself.
            let _ = self.segmentation.run(image);
        }
        self.size_px = size_px;
    }

    fn doubt_under_glare(&mut self, image: GrayView<'_>, out: &mut Markers) {
        let by_area = self.rung.get().area_shows_glare();
        self.glares.doubt(image, by_area, &mut self.areas_px2, out);
    }
}
