//! Markers near expected positions: what a tracker asks for.

use super::fit::{CLEARANCE_PX, ENOUGH_ROWS};
use super::pieces::Pieces;
use super::sieve::{area_range_px2, in_shape, usual_area_px2};
use super::window::Window;
use super::{DetectError, Detector, Markers, centre, rows_between};
use crate::image::GrayView;
use crate::math::DVec2;
use crate::math::linalg::Symmetric;
use crate::params::Centre;
use alloc::vec::Vec;

/// What the window around one expected position shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sight {
    /// One whole marker: that of this index in [`Found::markers`]. No two positions are given the same one.
    Marker(u32),
    /// Gel, and specks smaller than any marker: there is no marker.
    #[default]
    Nothing,
    /// Several whole markers.
    Several,
    /// Not decided: only parts of markers, something that is no marker, a marker that is nearer to another position, or a
    /// window outside the image.
    Unclear,
}

/// Markers found near expected positions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// Each once, in the order of the positions.
    pub markers: Markers,
    /// What was seen at each position.
    pub sights: Vec<Sight>,
    /// No two of the markers are closer to each other than this, as far as the search tells; 0 where it does not.
    pub apart_px: f64,
}

/// A whole piece in the window of one position.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    position: u32,
    /// Row and column of its first pixel: no two pieces of an image share it.
    key: (u16, u16),
    centre_px: DVec2,
    area_px2: u32,
    spread_px2: Symmetric<2>,
}

/// Whole pieces of one window that are kept; a window with more is not clear anyway.
const MOST_CANDIDATES: usize = 4;

/// Whole pieces of all windows that are kept, for each window: one is the rule.
const MOST_ON_AVERAGE: usize = 2;

/// Scratch of the search.
#[derive(Clone, Debug, Default)]
pub(super) struct Search {
    pieces: Pieces,
    candidates: Vec<Candidate>,
    areas_px2: Vec<u32>,
    /// Expected positions within the part of the image that is searched.
    inside_px: Vec<DVec2>,
    most_candidates: usize,
}

impl Search {
    fn start(&mut self, positions: usize) {
        self.pieces.reserve();
        self.most_candidates = MOST_ON_AVERAGE * positions;
        self.candidates.clear();
        self.candidates.reserve(MOST_ON_AVERAGE * positions);
        self.areas_px2.clear();
        self.areas_px2.reserve(MOST_ON_AVERAGE * positions);
    }
}

impl Detector {
    /// Looks for one marker within `reach_px` of each expected position, in both axes; a marker is found when all of it
    /// lies in that window, `reach_px` being at most 31 px. `out` is cleared first.
    ///
    /// It is one of those that [`Self::run`] finds, with the same bits: background and threshold are taken from the
    /// whole image. (Only the model fit may differ by a fraction of its covariance: it learns the blur from what was found.) A marker farther away than the reach is never taken for the expected one. No allocation after the first image with as many
    /// positions.
    ///
    /// # Errors
    /// [`DetectError`]; `out` is then empty.
    pub fn run_near(
        &mut self,
        image: GrayView<'_>,
        expected_px: &[DVec2],
        reach_px: f64,
        out: &mut Found,
    ) -> Result<(), DetectError> {
        out.markers.clear();
        out.sights.clear();
        out.apart_px = 0.0;
        let (image, origin_px) = self.part(image)?;
        self.areas_px2.clear();
        self.areas_px2.reserve(expected_px.len());
        let mut inside_px = core::mem::take(&mut self.near.inside_px);
        inside_px.clear();
        inside_px.reserve(expected_px.len());
        inside_px.extend(expected_px.iter().map(|&at| at - origin_px));
        let found = self.run_near_part(image, &inside_px, reach_px, out);
        self.near.inside_px = inside_px;
        out.markers.shift(origin_px);
        found
    }

    fn run_near_part(
        &mut self,
        image: GrayView<'_>,
        expected_px: &[DVec2],
        reach_px: f64,
        out: &mut Found,
    ) -> Result<(), DetectError> {
        self.check(image)?;
        self.segments.mask_all(image);
        self.near.start(expected_px.len());
        out.markers.reserve(expected_px.len(), 0);
        out.sights.resize(expected_px.len(), Sight::Nothing);
        let size_px = (image.width(), image.height());
        for (position, &at) in expected_px.iter().enumerate() {
            out.sights[position] = match Window::around(at, reach_px, size_px) {
                Some(window) => self.look(image, position, &window),
                None => Sight::Unclear,
            };
        }
        self.decide(expected_px, out);
        if let Self { near, disc_fit: Some(fit), segments, .. } = self {
            fit.clear(expected_px.len());
            near.candidates.iter().for_each(|c| fit.add(c.centre_px, c.spread_px2));
            let others = near.candidates.iter().map(|c| c.centre_px);
            fit.finish(image, segments.mask(), others, &mut out.markers);
        }
        if self.params.centre == Centre::Matched {
            self.match_near(image, expected_px, reach_px, &mut out.markers);
        }
        self.doubt_under_glare(image, &mut out.markers);
        Ok(())
    }

    /// Takes a matched step from the markers found, or else their grey centroid.
    fn match_near(
        &mut self,
        image: GrayView<'_>,
        expected_px: &[DVec2],
        reach_px: f64,
        markers: &mut Markers,
    ) {
        let size_px = (image.width(), image.height());
        let gel = (self.segments.mask(), markers.centres_px.as_slice());
        let noise = self.meter.run(image, gel, rows_between(size_px.1, ENOUGH_ROWS), CLEARANCE_PX);
        self.matched.prepare(image, noise.unwrap_or_default(), markers);
        self.grey_centre.reserve(image.height());
        for k in 0..markers.centres_px.len() {
            if self.matched.replace(image, (k, markers.area_px2[k]), markers) {
                continue;
            }
            let Candidate { position, key, .. } = self.near.candidates[k];
            let Some(window) = Window::around(expected_px[position as usize], reach_px, size_px) else {
                continue;
            };
            self.load_pieces(image, &window);
            let Self { near: Search { pieces, .. }, grey_centre, params, .. } = self;
            while let Some((blob, _)) = pieces.next(&window) {
                let runs = pieces.runs();
                if (runs[0].y, runs[0].start) == key {
                    markers.centres_px[k] = grey_centre.run(image, &blob, runs.iter(), params.polarity);
                    break;
                }
            }
        }
    }

    fn load_pieces(&mut self, image: GrayView<'_>, window: &Window) {
        self.near.pieces.start();
        for y in window.first.1..window.end.1 {
            self.near.pieces.push(&self.segments.mask()[y * image.width()..][window.first.0..window.end.0]);
        }
    }

    /// Adds the window's whole pieces to the candidates; `Unclear` if there are others that matter.
    fn look(&mut self, image: GrayView<'_>, position: usize, window: &Window) -> Sight {
        self.load_pieces(image, window);
        let (params, Search { pieces, candidates, most_candidates, .. }) = (&self.params, &mut self.near);
        let most = (candidates.len() + MOST_CANDIDATES).min(*most_candidates);
        let mut sight = Sight::Nothing;
        while let Some((blob, partial)) = pieces.next(window) {
            if blob.area_px2 < params.min_area_px2 {
                continue;
            }
            if partial || blob.area_px2 > params.max_area_px2 || !in_shape(&blob, params.min_fill) {
                sight = Sight::Unclear;
                continue;
            }
            if candidates.len() == most {
                return Sight::Several;
            }
            let runs = pieces.runs();
            candidates.push(Candidate {
                position: position as u32,
                key: (runs[0].y, runs[0].start),
                centre_px: match params.centre {
                    Centre::Binary | Centre::Matched => centre::binary(&blob),
                    Centre::Grey | Centre::Band | Centre::Fit => {
                        self.grey_centre.run(image, &blob, runs.iter(), params.polarity)
                    }
                },
                area_px2: blob.area_px2,
                spread_px2: blob.spread_px2(runs.iter()),
            });
        }
        sight
    }

    /// Gives each position its only candidate, and each candidate to the nearest position only.
    fn decide(&mut self, expected_px: &[DVec2], out: &mut Found) {
        let Search { candidates, areas_px2, .. } = &mut self.near;
        areas_px2.clear();
        areas_px2.extend(candidates.iter().map(|c| c.area_px2));
        let (least_px2, most_px2) = area_range_px2(self.params.threshold, usual_area_px2(areas_px2));
        for candidate in candidates.iter().filter(|c| c.area_px2 > most_px2) {
            out.sights[candidate.position as usize] = Sight::Unclear;
        }
        candidates.retain(|c| (least_px2..=most_px2).contains(&c.area_px2));
        // Several in one window: none. They stand in the order of the positions.
        let mut previous = None;
        for c in candidates.iter() {
            if previous.replace(c.position) == Some(c.position) {
                out.sights[c.position as usize] = Sight::Several;
            }
        }
        candidates.retain(|c| out.sights[c.position as usize] != Sight::Several);
        let distance = |c: &Candidate| c.centre_px.distance_squared(expected_px[c.position as usize]);
        candidates.sort_unstable_by(|a, b| {
            a.key.cmp(&b.key).then(distance(a).total_cmp(&distance(b))).then(a.position.cmp(&b.position))
        });
        let mut last = None;
        candidates.retain(|c| {
            let again = last.replace(c.key) == Some(c.key);
            if again {
                out.sights[c.position as usize] = Sight::Unclear;
            }
            !again
        });
        candidates.sort_unstable_by_key(|c| c.position);
        let variance = self.params.centre_sigma_px * self.params.centre_sigma_px;
        for c in candidates.iter() {
            out.sights[c.position as usize] = Sight::Marker(out.markers.centres_px.len() as u32);
            out.markers.push(c.centre_px, [[variance, 0.0], [0.0, variance]], c.area_px2);
        }
        if self.params.centre == Centre::Fit {
            out.markers.unfitted = out.markers.centres_px.len();
        }
    }
}
