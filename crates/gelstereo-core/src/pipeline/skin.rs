//! The gel's skin over a print that lies below it.
//!
//! A layer of gel between print and skin keeps its volume, so that it is thinner where the print is
//! stretched: the skin lies `depth / area ratio` from a marker, along the normal of the print's surface. The
//! area ratio is that of the cell around the marker, now and at rest.
//!
//! The table has the rms error within 0.7 of the contact's radius, for this law, for a layer of constant
//! thickness, and for the markers without correction. The gels are neo-Hookean, 2 and 4 mm thick, solved by
//! finite elements, under balls of 2 to 7 mm; the print has a pitch of 0.85 mm. They are the development half
//! of `bench/outside`; the held-out half is in docs/outside.md.
//!
//! | depth of the print | this law | constant thickness | no correction |
//! |---|---|---|---|
//! | 0.2 mm | 5 um | 32 um | 169 um |
//! | 0.4 mm | 9 um | 77 um | 327 um |
//! | 0.8 mm | 22 um | 184 um | 624 um |

use crate::contact::{ContactError, RestSurface, variance_along};
use crate::lattice::Topology;
use crate::math::linalg::{Symmetric, add_outer};
use crate::math::{DVec3, abs};
use crate::params::LatticeParams;
use alloc::vec::Vec;

/// Standard deviation of the skin's distance over the change of that distance since rest. The rms errors
/// above are 0.11 to 0.15 of it, and 0.22 to 0.30 between 0.7 and 0.95 of the contact's radius.
const SIGMA_OF_CHANGE: f64 = 0.2;

/// Depth of a print below the skin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SkinDepth {
    /// The depth.
    pub mm: f64,
    /// Its standard deviation.
    pub sigma_mm: f64,
}

impl SkinDepth {
    /// By the settings; `None` for a print that is the skin.
    #[must_use]
    pub fn of(params: &LatticeParams) -> Option<Self> {
        let (mm, sigma_mm) = (params.depth_mm, params.depth_sigma_mm);
        (mm > 0.0 || sigma_mm > 0.0).then_some(Self { mm, sigma_mm })
    }
}

/// Skin over a lattice of markers.
#[derive(Clone, Debug)]
pub struct Skin {
    depth_mm: f64,
    depth_sigma_mm: f64,
    topology: Topology,
    /// Cell of each marker at rest, relative to its neighbours: |along rows x along columns|, mm².
    area_mm2: Vec<f64>,
    rest: RestSurface,
    markers_mm: Vec<DVec3>,
    marker_mm2: Vec<Symmetric<3>>,
}

/// Neighbours of a marker along an axis, and the vector between them.
struct Span {
    before: usize,
    after: usize,
    vector_mm: DVec3,
}

impl Skin {
    /// Over the markers of a print at rest, which lies so deep below the skin.
    ///
    /// # Errors
    /// [`ContactError`] if the skin at rest spans no plane.
    pub fn new(rest: &RestSurface, topology: Topology, depth: SkinDepth) -> Result<Self, ContactError> {
        let SkinDepth { mm: depth_mm, sigma_mm: depth_sigma_mm } = depth;
        let markers_mm = rest.points_mm().to_vec();
        let below = -depth_mm * rest.normal();
        let skin_mm: Vec<DVec3> = markers_mm.iter().map(|&marker| marker + below).collect();
        let spans = (0..markers_mm.len()).map(|i| spans(&markers_mm, topology, i));
        let area_mm2 = spans.map(|[row, col]| row.vector_mm.cross(col.vector_mm).length()).collect();
        let marker_mm2 = Vec::with_capacity(markers_mm.len());
        let rest = RestSurface::new(&skin_mm)?;
        Ok(Self { depth_mm, depth_sigma_mm, topology, area_mm2, rest, markers_mm, marker_mm2 })
    }

    /// The skin at rest.
    #[must_use]
    pub const fn rest(&self) -> &RestSurface {
        &self.rest
    }

    /// Replaces markers and their covariances by the skin over them. Markers beyond those at rest are left as
    /// they are. An error of the depth moves all points by as much along the normal at rest. The covariances
    /// leave that out, and have what it moves each point beyond.
    pub fn lift(&mut self, points_mm: &mut [DVec3], covariance_mm2: &mut [Symmetric<3>]) {
        self.markers_mm.clear();
        self.markers_mm.extend_from_slice(points_mm);
        self.marker_mm2.clear();
        self.marker_mm2.extend_from_slice(covariance_mm2);
        let skins = points_mm.iter_mut().zip(covariance_mm2).zip(&self.area_mm2).enumerate();
        for (i, ((point_mm, covariance_mm2), &rest_mm2)) in skins {
            let spans = spans(&self.markers_mm, self.topology, i);
            let cross = spans[0].vector_mm.cross(spans[1].vector_mm);
            let area_mm2 = cross.length();
            if !(area_mm2 > 0.0 && rest_mm2 > 0.0) {
                // Neighbours in one place have no surface: the skin as at rest.
                *point_mm -= self.depth_mm * self.rest.normal();
                continue;
            }
            let toward = if cross.dot(self.rest.normal()) < 0.0 { -1.0 } else { 1.0 };
            let normal = toward / area_mm2 * cross;
            let distance_mm = self.depth_mm * rest_mm2 / area_mm2;
            *point_mm -= distance_mm * normal;
            let change_mm = SIGMA_OF_CHANGE * abs(distance_mm - self.depth_mm);
            let mut along_mm2 = change_mm * change_mm;
            for span in &spans {
                let length_mm2 = span.vector_mm.length_squared();
                let direction = span.vector_mm.normalize_or_zero();
                let ends = |direction| {
                    let end =
                        |i: usize| self.marker_mm2.get(i).map_or(0.0, |mm2| variance_along(mm2, direction));
                    distance_mm * distance_mm * (end(span.before) + end(span.after)) / length_mm2
                };
                // Noise of the neighbours stretches the cell, and tilts the normal.
                along_mm2 += ends(direction);
                add_outer(covariance_mm2, ends(normal), direction.to_array());
            }
            add_outer(covariance_mm2, along_mm2, normal.to_array());
            let beyond = rest_mm2 / area_mm2 * normal - self.rest.normal();
            add_outer(covariance_mm2, self.depth_sigma_mm * self.depth_sigma_mm, beyond.to_array());
        }
    }
}

/// Spans about marker `i` along two axes; at the border they end at the marker itself.
fn spans(points_mm: &[DVec3], topology: Topology, i: usize) -> [Span; 2] {
    let place = (i / topology.cols().max(1), i % topology.cols().max(1));
    [0, 1].map(|axis| {
        let before = topology.step_from(place, axis, -1).unwrap_or(i);
        let after = topology.step_from(place, axis, 1).unwrap_or(i);
        Span { before, after, vector_mm: points_mm[after] - points_mm[before] }
    })
}
