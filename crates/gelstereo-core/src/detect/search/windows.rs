//! Markers near predicted positions, each from its own window; the rest of the image is not read.

use crate::detect::centre::CentreRung;
use crate::detect::centre::covered;
use crate::detect::centre::weighted::WeightedCentroid;
use crate::detect::found::{Found, WindowObservation};
use crate::detect::mask::blob_filter::in_shape;
use crate::detect::outline::Outline;
use crate::detect::window::classifier::{WindowClass, WindowClassifier, WindowMarker};
use crate::detect::window::components::WindowComponents;
use crate::detect::window::pixels::flip;
use crate::detect::window::roi::{self, Window};
use crate::detect::window::size::MarkerSize;
use crate::image::GrayView;
use crate::math::DVec2;
use crate::params::DetectParams;
use alloc::vec::Vec;

/// Number of windows that give the image's usual contrast, spread evenly over the positions.
const SAMPLES: usize = 64;

/// Quantile of a window's levels that is taken as gel: the gel's median if gel fills half of the window.
const GEL_SHARE: f64 = 0.75;

/// Contrast share at which components are outlined, and their least contrast as a share of the usual one.
const SHARE: f64 = 0.5;
const MIN_OF_USUAL: f64 = 0.45;

/// Marker found in a window.
#[derive(Clone, Copy, Debug)]
struct Seen {
    position: u32,
    centre_px: DVec2,
    area_px2: u32,
    band: u8,
    alive: bool,
}

/// The search and its scratch.
#[derive(Clone, Debug)]
pub(in crate::detect) struct WindowSearch {
    params: DetectParams,
    /// In coordinates of the whole image.
    pub outline: Outline,
    weighted: WeightedCentroid,
    seen: Vec<Seen>,
    components: WindowComponents,
    mask: Vec<u8>,
    /// Index of the last marker with its centre in each cell, plus 1; there are fewer than 65 535.
    cells: Vec<u16>,
}

impl WindowSearch {
    /// Creates the search from its settings.
    pub fn new(params: &DetectParams) -> Self {
        Self {
            params: params.clone(),
            outline: Outline::default(),
            weighted: WeightedCentroid::new(params),
            seen: Vec::new(),
            components: WindowComponents::default(),
            mask: Vec::new(),
            cells: Vec::new(),
        }
    }

    /// Reserves memory for this many positions in an image of this size.
    pub fn reserve(&mut self, positions: usize, size: &MarkerSize, (width, height): (usize, usize)) {
        self.seen.clear();
        self.seen.reserve(positions);
        self.components.reserve();
        self.mask.clear();
        self.mask.reserve(roi::MAX_ROI_PX);
        self.weighted.reserve(height);
        let cells_along = |px: usize| (px as f64 / size.cell_px()) as usize + 3;
        self.cells.clear();
        self.cells.reserve(cells_along(width) * cells_along(height));
    }

    /// Finds the markers within `reach_px` of the positions; `out` is empty, with room for all.
    ///
    /// The window classifier decides most windows: one marker or nothing. The others are segmented:
    /// components of the square within reach, with a threshold from that square.
    pub fn run(
        &mut self,
        image: GrayView<'_>,
        rung: &mut dyn CentreRung,
        expected_px: &[DVec2],
        reach_px: f64,
        size: &MarkerSize,
        out: &mut Found,
    ) {
        let polarity = self.params.polarity;
        if size.is_small() {
            self.look_at_all(
                &WindowClassifier::<16>::new(*size, polarity),
                image,
                expected_px,
                reach_px,
                out,
            );
        } else {
            self.look_at_all(
                &WindowClassifier::<32>::new(*size, polarity),
                image,
                expected_px,
                reach_px,
                out,
            );
        }
        self.share_out(image, rung, expected_px, size, out);
        out.apart_px = size.cell_px();
        if rung.refine_windows(image, size, &mut out.markers) {
            out.apart_px = 0.0;
        }
    }

    fn look_at_all<const L: usize>(
        &mut self,
        classifier: &WindowClassifier<L>,
        image: GrayView<'_>,
        expected_px: &[DVec2],
        reach_px: f64,
        out: &mut Found,
    ) {
        let every = expected_px.len().div_ceil(SAMPLES).max(1);
        let usual = classifier.usual_contrast(image, expected_px.iter().step_by(every));
        let max_off_px = reach_px - classifier.size().radius_px;
        classifier.look_at_all(image, expected_px, usual, |position, glance| {
            let (at_px, position) = (expected_px[position], position as u32);
            let near = |c: DVec2| (c - at_px).abs().max_element() <= max_off_px;
            out.sights.push(match glance {
                _ if !self.outline.contains(at_px) => WindowObservation::Nothing,
                WindowClass::Marker(marker) if near(marker.centre_px) => {
                    let WindowMarker { centre_px, area_px2, band } = marker;
                    self.seen.push(Seen { position, centre_px, area_px2, band, alive: true });
                    WindowObservation::Unclear
                }
                WindowClass::Empty => WindowObservation::Nothing,
                WindowClass::Marker(_) | WindowClass::Unclear => {
                    self.look_closer(classifier, image, position, at_px, reach_px, usual)
                }
            });
        });
    }

    /// Searches the square within reach for components.
    fn look_closer<const L: usize>(
        &mut self,
        classifier: &WindowClassifier<L>,
        image: GrayView<'_>,
        position: u32,
        at_px: DVec2,
        reach_px: f64,
        usual: f64,
    ) -> WindowObservation {
        let Some(window) = Window::around(at_px, reach_px, (image.width(), image.height())) else {
            return WindowObservation::Unclear;
        };
        let Self { params, weighted, seen, components, mask, .. } = self;
        let flip = flip(params.polarity);
        let rows = || (window.first.1..window.end.1).map(|y| &image.row(y)[window.first.0..window.end.0]);
        let Some(below) = outline_level(rows().flatten().map(|&level| level ^ flip), usual) else {
            return WindowObservation::Nothing;
        };
        components.start();
        for row in rows() {
            mask.clear();
            mask.extend(row.iter().map(|&level| if (level ^ flip) < below { u8::MAX } else { 0 }));
            components.push(mask);
        }
        let (mut sight, mut found) = (WindowObservation::Nothing, None);
        let (min_px2, max_px2) = classifier.size().area_px2;
        let [least_px2, _] = params.areas_px2();
        while let Some((blob, partial)) = components.next(&window) {
            if blob.area_px2 < least_px2 {
                continue;
            }
            if partial || blob.area_px2 > max_px2 || !in_shape(&blob, params.min_fill) {
                sight = WindowObservation::Unclear;
            } else if blob.area_px2 >= min_px2 {
                if found.is_some() {
                    return WindowObservation::Several;
                }
                let shown =
                    classifier.centre(image, blob.mean_px()).map(|marker| (marker.centre_px, marker.band));
                let (centre_px, band) =
                    shown.unwrap_or_else(|| (weighted.run(image, &blob, components.runs().iter()), 0));
                found = Some(Seen { position, centre_px, area_px2: blob.area_px2, band, alive: true });
            }
        }
        seen.extend(found);
        sight
    }

    /// Assigns each marker to the nearest of the positions whose windows show it.
    fn share_out(
        &mut self,
        image: GrayView<'_>,
        rung: &dyn CentreRung,
        expected_px: &[DVec2],
        size: &MarkerSize,
        out: &mut Found,
    ) {
        let size_px = (image.width(), image.height());
        let Self { seen, cells, .. } = self;
        let cells_along = |px: usize| (px as f64 / size.cell_px()) as usize + 3;
        let cols = cells_along(size_px.0);
        cells.clear();
        cells.resize(cols * cells_along(size_px.1), 0);
        let per_px = 1.0 / size.cell_px();
        let near_px2 = size.cell_px() * size.cell_px();
        for n in 0..seen.len() {
            let centre_px = seen[n].centre_px;
            let far = |seen: &Seen| seen.centre_px.distance_squared(expected_px[seen.position as usize]);
            // Cells begin one before the image, so that each has neighbours on every side.
            let first = (centre_px.y * per_px) as usize * cols + (centre_px.x * per_px) as usize;
            let middle = first + cols + 1;
            'around: for row in [first, first + cols, first + 2 * cols] {
                if cells[row..row + 3].iter().all(|&other| other == 0) {
                    continue;
                }
                for cell in row..row + 3 {
                    let Some(other) = (cells[cell] as usize).checked_sub(1) else { continue };
                    if cell != middle && seen[other].centre_px.distance_squared(centre_px) >= near_px2 {
                        continue;
                    }
                    if far(&seen[other]) <= far(&seen[n]) {
                        seen[n].alive = false;
                        break 'around;
                    }
                    seen[other].alive = false;
                    cells[cell] = 0;
                }
            }
            if seen[n].alive {
                // No image has more positions than that; a marker beyond could be assigned twice.
                cells[middle] = u16::try_from(n + 1).unwrap_or(0);
            }
        }
        for marker in seen.iter().filter(|marker| marker.alive) {
            let Seen { centre_px, area_px2, band, .. } = *marker;
            let covered = covered::without_band_px2(band, image, centre_px, area_px2, size.usual_area_px2());
            let variance_px2 = rung.window_variance_px2(marker.band) + covered;
            out.sights[marker.position as usize] =
                WindowObservation::Marker(out.markers.centres_px.len() as u32);
            out.markers.push(marker.centre_px, variance_px2, marker.area_px2);
        }
    }
}

/// Threshold half way from a square's gel to its darkest pixel. `None` if nothing is as dark as a marker
/// of an image with this usual contrast.
fn outline_level(levels: impl Iterator<Item = u8> + Clone, usual: f64) -> Option<u8> {
    let mut histogram = [0_u32; 256];
    levels.for_each(|level| histogram[usize::from(level)] += 1);
    let all: u32 = histogram.iter().sum();
    let below_gel = GEL_SHARE * f64::from(all);
    let mut below = 0;
    let gel = histogram.iter().position(|&count| {
        below += count;
        f64::from(below) >= below_gel
    })?;
    let darkest = histogram.iter().position(|&count| count > 0)?;
    let (depth, min) = ((gel - darkest) as f64, MIN_OF_USUAL * usual);
    (depth >= min && min > 0.0).then_some((gel as f64 - SHARE * depth) as u8)
}
