//! Markers near expected positions, from windows of the whole image's mask.

use crate::detect::centre::{CentreRung, MaskedMarker, MaskedMarkers};
use crate::detect::found::{Found, WindowObservation};
use crate::detect::mask::blob_filter::{area_range_px2, in_shape, usual_area_px2};
use crate::detect::window::components::WindowComponents;
use crate::detect::window::roi::Window;
use crate::image::GrayView;
use crate::math::DVec2;
use crate::params::DetectParams;
use alloc::vec::Vec;

/// Whole components kept per window; a window with more is ambiguous anyway.
const MAX_CANDIDATES: usize = 4;

/// Whole components kept, on average per window; usually there is one.
const MAX_ON_AVERAGE: usize = 2;

/// An image and its mask: 255 at components, row by row.
#[derive(Clone, Copy)]
pub(in crate::detect) struct Masked<'a> {
    pub image: GrayView<'a>,
    pub mask: &'a [u8],
}

/// The search and its scratch.
#[derive(Clone, Debug)]
pub(in crate::detect) struct MaskedSearch {
    params: DetectParams,
    components: WindowComponents,
    /// Whole components in the windows of the positions.
    candidates: Vec<MaskedMarker>,
    areas_px2: Vec<u32>,
    max_candidates: usize,
}

impl MaskedSearch {
    /// Creates the search from its settings.
    pub fn new(params: &DetectParams) -> Self {
        Self {
            params: params.clone(),
            components: WindowComponents::default(),
            candidates: Vec::new(),
            areas_px2: Vec::new(),
            max_candidates: 0,
        }
    }

    fn start(&mut self, positions: usize) {
        self.components.reserve();
        self.max_candidates = MAX_ON_AVERAGE * positions;
        self.candidates.clear();
        self.candidates.reserve(self.max_candidates);
        self.areas_px2.clear();
        self.areas_px2.reserve(self.max_candidates);
    }

    /// Finds the markers within `reach_px` of the positions in an image with this mask; `out` is empty.
    pub fn run(
        &mut self,
        masked: Masked<'_>,
        rung: &mut dyn CentreRung,
        expected_px: &[DVec2],
        reach_px: f64,
        out: &mut Found,
    ) {
        let Masked { image, mask } = masked;
        self.start(expected_px.len());
        out.markers.reserve(expected_px.len(), 0);
        out.sights.resize(expected_px.len(), WindowObservation::Nothing);
        let size_px = (image.width(), image.height());
        for (position, &at) in expected_px.iter().enumerate() {
            out.sights[position] = match Window::around(at, reach_px, size_px) {
                Some(window) => self.look(masked, rung, position, &window),
                None => WindowObservation::Unclear,
            };
        }
        self.decide(expected_px, out);
        let found = MaskedMarkers { image, mask, markers: &self.candidates, max_markers: expected_px.len() };
        rung.refine_masked(&found, &mut out.markers);
    }

    /// Adds the window's whole components to the candidates; `Unclear` if there are other significant ones.
    fn look(
        &mut self,
        masked: Masked<'_>,
        rung: &mut dyn CentreRung,
        position: usize,
        window: &Window,
    ) -> WindowObservation {
        let Masked { image, mask } = masked;
        load(&mut self.components, mask, image.width(), window);
        let Self { params, components, candidates, max_candidates, .. } = self;
        let max = (candidates.len() + MAX_CANDIDATES).min(*max_candidates);
        let mut sight = WindowObservation::Nothing;
        while let Some((blob, partial)) = components.next(window) {
            if blob.area_px2 < params.min_area_px2 {
                continue;
            }
            if partial || blob.area_px2 > params.max_area_px2 || !in_shape(&blob, params.min_fill) {
                sight = WindowObservation::Unclear;
                continue;
            }
            if candidates.len() == max {
                return WindowObservation::Several;
            }
            let runs = components.runs();
            candidates.push(MaskedMarker {
                position: position as u32,
                key: (runs[0].y, runs[0].start),
                centre_px: rung.centre_component(image, &blob, runs),
                area_px2: blob.area_px2,
                spread_px2: blob.spread_px2(runs.iter()),
            });
        }
        sight
    }

    /// Assigns each position its only candidate, and each candidate only to the nearest position.
    fn decide(&mut self, expected_px: &[DVec2], out: &mut Found) {
        let Self { candidates, areas_px2, .. } = self;
        areas_px2.clear();
        areas_px2.extend(candidates.iter().map(|c| c.area_px2));
        let (min_px2, max_px2) = area_range_px2(self.params.threshold, usual_area_px2(areas_px2));
        for candidate in candidates.iter().filter(|c| c.area_px2 > max_px2) {
            out.sights[candidate.position as usize] = WindowObservation::Unclear;
        }
        candidates.retain(|c| (min_px2..=max_px2).contains(&c.area_px2));
        // Positions with several candidates get none. Candidates are in the order of the positions.
        let mut previous = None;
        for c in candidates.iter() {
            if previous.replace(c.position) == Some(c.position) {
                out.sights[c.position as usize] = WindowObservation::Several;
            }
        }
        candidates.retain(|c| out.sights[c.position as usize] != WindowObservation::Several);
        let distance = |c: &MaskedMarker| c.centre_px.distance_squared(expected_px[c.position as usize]);
        candidates.sort_unstable_by(|a, b| {
            a.key.cmp(&b.key).then(distance(a).total_cmp(&distance(b))).then(a.position.cmp(&b.position))
        });
        let mut last = None;
        candidates.retain(|c| {
            let again = last.replace(c.key) == Some(c.key);
            if again {
                out.sights[c.position as usize] = WindowObservation::Unclear;
            }
            !again
        });
        candidates.sort_unstable_by_key(|c| c.position);
        let variance = self.params.centre_sigma_px * self.params.centre_sigma_px;
        for c in candidates.iter() {
            out.sights[c.position as usize] = WindowObservation::Marker(out.markers.centres_px.len() as u32);
            out.markers.push(c.centre_px, variance, c.area_px2);
        }
    }
}

/// Loads a window of a mask of this width.
fn load(components: &mut WindowComponents, mask: &[u8], width: usize, window: &Window) {
    components.start();
    for y in window.first.1..window.end.1 {
        components.push(&mask[y * width..][window.first.0..window.end.0]);
    }
}
