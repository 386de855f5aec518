//! Markers near predicted positions, each by a window of its own: the rest of the image is not read.

use super::Detector;
use super::glance::{Eye, Glance, Kind, Spot};
use super::near::{Found, Sight};
use super::pieces::Pieces;
use super::sieve::in_shape;
use super::window::{self, Window};
use super::{centre, covered};
use crate::image::GrayView;
use crate::math::DVec2;
use crate::params::{Centre, Polarity, Threshold};
use alloc::vec::Vec;

/// Windows from which an image's usual contrast is taken, spread evenly over the positions.
const SAMPLES: usize = 64;

/// Of all pixels of a window, this share is not brighter than the gel: where gel is seen at all, half of the
/// rest.
const GEL_SHARE: f64 = 0.75;

/// Share of the contrast at which pieces are outlined; and of the usual contrast, the least contrast they
/// have.
const SHARE: f64 = 0.5;
const LEAST_OF_USUAL: f64 = 0.45;

/// A marker that a window shows.
#[derive(Clone, Copy, Debug)]
struct Seen {
    position: u32,
    centre_px: DVec2,
    area_px2: u32,
    band: u8,
    alive: bool,
}

/// Scratch of the search.
#[derive(Clone, Debug, Default)]
pub(super) struct Glances {
    seen: Vec<Seen>,
    pieces: Pieces,
    mask: Vec<u8>,
    /// The last marker seen with its centre in each cell, plus 1; there are fewer than 65 535.
    cells: Vec<u16>,
}

impl Glances {
    /// Makes room for so many positions in an image of this size.
    pub fn reserve(&mut self, positions: usize, kind: &Kind, (width, height): (usize, usize)) {
        self.seen.clear();
        self.seen.reserve(positions);
        self.pieces.reserve();
        self.mask.clear();
        self.mask.reserve(window::MOST_SIDE_PX);
        let side = |size: usize| (size as f64 / kind.cell_px()) as usize + 3;
        self.cells.clear();
        self.cells.reserve(side(width) * side(height));
    }
}

impl Detector {
    /// Whether markers of a usual area that stand a pitch apart can be searched by [`Self::run_windows`] with
    /// these settings.
    #[must_use]
    pub fn kind_for_windows(&self, usual_area_px2: f64, pitch_px: f64) -> Option<Kind> {
        let suits = self.params.threshold == Threshold::Auto
            && matches!(self.params.centre, Centre::Band | Centre::Matched);
        Kind::of(usual_area_px2).filter(|kind| suits && kind.fits(pitch_px))
    }

    /// Makes room for [`Self::run_windows`] on images of a size.
    pub fn reserve_windows(
        &mut self,
        positions: usize,
        kind: &Kind,
        size_px: (usize, usize),
        out: &mut Found,
    ) {
        self.glances.reserve(positions, kind, size_px);
        self.grey_centre.reserve(size_px.1);
        self.glares.reserve(size_px);
        self.areas_px2.clear();
        self.areas_px2.reserve(positions);
        out.markers.reserve(positions, 0);
        out.sights.reserve(positions);
    }

    /// Looks for one marker within `reach_px` of each expected position, in both axes, reading windows of the
    /// image only. `out` is cleared first.
    ///
    /// Most windows show one marker or nothing at a glance. What they do not is searched again as pieces of
    /// the square within reach, as [`Self::run_near`] does, but by the light in that square. No marker is
    /// given twice. A matched step starts from the band's centre, with weights that the last [`Self::run`]
    /// chose. No allocation after [`Self::reserve_windows`].
    pub fn run_windows(
        &mut self,
        image: GrayView<'_>,
        expected_px: &[DVec2],
        (kind, reach_px): (&Kind, f64),
        out: &mut Found,
    ) {
        out.markers.clear();
        out.sights.clear();
        self.reserve_windows(expected_px.len(), kind, (image.width(), image.height()), out);
        let flip = self.flip();
        if kind.is_small() {
            self.look_at_all(&Eye::<16>::new(*kind, flip), image, expected_px, reach_px, out);
        } else {
            self.look_at_all(&Eye::<32>::new(*kind, flip), image, expected_px, reach_px, out);
        }
        self.share_out(image, expected_px, kind, out);
        out.apart_px = kind.cell_px();
        if self.params.centre == Centre::Matched {
            // A step may go anywhere.
            out.apart_px = 0.0;
            // With the weights for what the last image that was searched whole showed, and the usual radius,
            // which is known better than that of a single window.
            let usual_px2 = crate::math::round(kind.usual_area_px2()) as u32;
            for marker in 0..out.markers.centres_px.len() {
                self.matched.replace(image, (marker, usual_px2), &mut out.markers);
            }
        }
        self.doubt_under_glare(image, &mut out.markers);
    }

    pub(super) const fn flip(&self) -> u8 {
        match self.params.polarity {
            Polarity::Dark => 0,
            Polarity::Bright => u8::MAX,
        }
    }

    fn look_at_all<const L: usize>(
        &mut self,
        eye: &Eye<L>,
        image: GrayView<'_>,
        expected_px: &[DVec2],
        reach_px: f64,
        out: &mut Found,
    ) {
        let every = expected_px.len().div_ceil(SAMPLES).max(1);
        let usual = eye.usual_contrast(image, expected_px.iter().step_by(every));
        let most_off_px = reach_px - eye.kind().radius_px;
        eye.look_at_all(image, expected_px, usual, |position, glance| {
            let (at_px, position) = (expected_px[position], position as u32);
            let near = |c: DVec2| (c - at_px).abs().max_element() <= most_off_px;
            out.sights.push(match glance {
                Glance::Marker(spot) if near(spot.centre_px) => {
                    let Spot { centre_px, area_px2, band } = spot;
                    self.glances.seen.push(Seen { position, centre_px, area_px2, band, alive: true });
                    Sight::Unclear
                }
                Glance::Nothing => Sight::Nothing,
                Glance::Marker(_) | Glance::Unclear => {
                    self.look_closer(eye, image, (position, at_px), reach_px, usual)
                }
            });
        });
    }

    /// Searches the square within reach for pieces.
    fn look_closer<const L: usize>(
        &mut self,
        eye: &Eye<L>,
        image: GrayView<'_>,
        (position, at_px): (u32, DVec2),
        reach_px: f64,
        usual: f64,
    ) -> Sight {
        let Some(window) = Window::around(at_px, reach_px, (image.width(), image.height())) else {
            return Sight::Unclear;
        };
        let (params, flip) = (&self.params, self.flip());
        let rows = || (window.first.1..window.end.1).map(|y| &image.row(y)[window.first.0..window.end.0]);
        let Some(below) = outline_level(rows().flatten().map(|&level| level ^ flip), usual) else {
            return Sight::Nothing;
        };
        let Glances { seen, pieces, mask, .. } = &mut self.glances;
        pieces.start();
        for row in rows() {
            mask.clear();
            mask.extend(row.iter().map(|&level| if (level ^ flip) < below { u8::MAX } else { 0 }));
            pieces.push(mask);
        }
        let (mut sight, mut found) = (Sight::Nothing, None);
        let (least_px2, most_px2) = eye.kind().area_px2;
        while let Some((blob, partial)) = pieces.next(&window) {
            if blob.area_px2 < params.min_area_px2 {
                continue;
            }
            if partial || blob.area_px2 > most_px2 || !in_shape(&blob, params.min_fill) {
                sight = Sight::Unclear;
            } else if blob.area_px2 >= least_px2 {
                if found.is_some() {
                    return Sight::Several;
                }
                let fallback =
                    || (self.grey_centre.run(image, &blob, pieces.runs().iter(), params.polarity), 0);
                let seen = eye.centre(image, centre::binary(&blob)).map(|spot| (spot.centre_px, spot.band));
                let (centre_px, band) = seen.unwrap_or_else(fallback);
                found = Some(Seen { position, centre_px, area_px2: blob.area_px2, band, alive: true });
            }
        }
        seen.extend(found);
        sight
    }

    /// Gives each marker to the nearest of the positions that see it.
    fn share_out(&mut self, image: GrayView<'_>, expected_px: &[DVec2], kind: &Kind, out: &mut Found) {
        let size_px = (image.width(), image.height());
        let Glances { seen, cells, .. } = &mut self.glances;
        let side = |size: usize| (size as f64 / kind.cell_px()) as usize + 3;
        let cols = side(size_px.0);
        cells.clear();
        cells.resize(cols * side(size_px.1), 0);
        let per_px = 1.0 / kind.cell_px();
        let near_px2 = kind.cell_px() * kind.cell_px();
        for n in 0..seen.len() {
            let centre_px = seen[n].centre_px;
            let far = |seen: &Seen| seen.centre_px.distance_squared(expected_px[seen.position as usize]);
            // Cells begin one before the image, so that there is one on every side.
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
                // More positions than that no image has: such a marker may then be given twice.
                cells[middle] = u16::try_from(n + 1).unwrap_or(0);
            }
        }
        let typed = self.params.centre_sigma_px * self.params.centre_sigma_px;
        let noise = self.band_noise.as_ref();
        for marker in seen.iter().filter(|marker| marker.alive) {
            let areas_px2 = (marker.area_px2, kind.usual_area_px2());
            let covered = covered::without_band_px2(marker.band, image, marker.centre_px, areas_px2);
            let stated = noise.map_or(typed, |noise| noise.variance_px2(marker.band, typed));
            let variance = stated + covered;
            out.sights[marker.position as usize] = Sight::Marker(out.markers.centres_px.len() as u32);
            out.markers.push(marker.centre_px, [[variance, 0.0], [0.0, variance]], marker.area_px2);
        }
    }
}

/// Level below which pixels of a square are darker than half way from its gel to its darkest; `None` where
/// nothing is as dark as a marker of an image with this usual contrast.
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
    let (depth, least) = ((gel - darkest) as f64, LEAST_OF_USUAL * usual);
    (depth >= least && least > 0.0).then_some((gel as f64 - SHARE * depth) as u8)
}
