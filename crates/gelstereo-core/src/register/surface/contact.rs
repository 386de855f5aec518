//! Input of the surface rungs: points relative to the patch's centroid, and the subsets for coarse passes.

use super::gel::model::Gel;
use super::gel::unsupported::Pressures;
use super::point::Sample;
use crate::math::linalg::{Symmetric, eigen};
use crate::math::{DVec3, acos, asin, centroid, sqrt};
use crate::params::{ContactParams, RegisterParams};
use crate::register::RegisterError;
use crate::register::limits::REACH_MM;
use crate::spatial::Grid;
use alloc::vec::Vec;

/// A measured contact, in the sensor's frame.
#[derive(Clone, Copy, Debug)]
pub struct Contact<'a> {
    /// Salient points: those pressed by the part, and the gel's shoulder beside it.
    pub points_mm: &'a [DVec3],
    /// Covariance of each of them. Without it each has `register.point_sigma_mm` along every axis.
    pub covariance_mm2: Option<&'a [Symmetric<3>]>,
    /// Unpressed markers. The part is nowhere between them and the camera; may be empty.
    pub unpressed_mm: &'a [DVec3],
    /// Direction from the part into the gel, a unit vector. Only faces that look this way can be in contact.
    pub press_direction: DVec3,
    /// Length over which the gel's surface returns to rest beside a contact, `contact.decay_mm`. With it
    /// and the unpressed markers, the markers in contact at a pose can be predicted.
    pub decay_mm: f64,
    /// Standard deviation of an error along `press_direction` that all points and markers share, as from the
    /// depth of the print: [`Frame::offset_sigma_mm`](crate::pipeline::Frame). The pose has it, too.
    pub offset_sigma_mm: f64,
}

impl<'a> Contact<'a> {
    /// Salient points alone, pressed toward the camera.
    #[must_use]
    pub const fn new(points_mm: &'a [DVec3]) -> Self {
        let decay_mm = ContactParams::DECAY_MM;
        Self {
            points_mm,
            covariance_mm2: None,
            unpressed_mm: &[],
            press_direction: DVec3::NEG_Z,
            decay_mm,
            offset_sigma_mm: 0.0,
        }
    }

    /// Refuses an invalid input, except for the salient points, which have been checked.
    pub(super) fn check(&self) -> Result<(), RegisterError> {
        if let Some(index) = self.unpressed_mm.iter().position(|p| !is_within(p)) {
            return Err(RegisterError::MarkerNotFinite { index });
        }
        if !((self.press_direction.length_squared() - 1.0).abs() < 1e-6) {
            return Err(RegisterError::PressDirection);
        }
        self.check_facing()?;
        if !(self.decay_mm > 0.0 && self.decay_mm <= REACH_MM) {
            return Err(RegisterError::Decay { found_mm: self.decay_mm });
        }
        let Some(all) = self.covariance_mm2 else { return Ok(()) };
        if all.len() != self.points_mm.len() {
            return Err(RegisterError::Covariances { points: self.points_mm.len(), covariances: all.len() });
        }
        // No more negative than a singular matrix is by rounding.
        let good = |c: &Symmetric<3>| {
            let is_finite = c.iter().flatten().all(|x| x.is_finite());
            is_finite
                && (is_positive(c) || {
                    let values = eigen(c).values;
                    values[2] > 0.0 && values[0] >= -1e-9 * values[2]
                })
        };
        match all.iter().position(|c| !good(c)) {
            Some(index) => Err(RegisterError::BadCovariance { index }),
            None => Ok(()),
        }
    }

    /// Refuses a patch that does not face the press: a thin one by its normal, a long one by its longest
    /// axis.
    fn check_facing(&self) -> Result<(), RegisterError> {
        let centre_mm = centroid(self.points_mm);
        let mut spread = [[0.0; 3]; 3];
        for p in self.points_mm {
            let off = (*p - centre_mm).to_array();
            for (row, x) in spread.iter_mut().zip(off) {
                row.iter_mut().zip(off).for_each(|(entry, y)| *entry += x * y);
            }
        }
        let found = eigen(&spread);
        let along = |k: usize| DVec3::from_array(found.vectors[k]).dot(self.press_direction).abs().min(1.0);
        let max_rad = MAX_ASIDE_DEG.to_radians();
        let is_thin = found.values[1] > TOLD * found.values[0];
        let is_long = found.values[2] > TOLD * found.values[1];
        let angle_rad = if is_thin { acos(along(0)) } else { 0.0 };
        let angle_rad = if is_long { angle_rad.max(asin(along(2))) } else { angle_rad };
        if angle_rad <= max_rad {
            return Ok(());
        }
        Err(RegisterError::PatchAside {
            angle_deg: angle_rad.to_degrees(),
            max_deg: MAX_ASIDE_DEG,
            press_direction: self.press_direction.to_array(),
        })
    }
}

/// Largest angle between the patch and facing the press. Gel follows slopes of at most about 45 degrees,
/// and a patch's normal is a mean.
const MAX_ASIDE_DEG: f64 = 60.0;
/// Ratio of variances from which two axes of a patch are distinct: twice the spread.
const TOLD: f64 = 4.0;

/// Whether a marker is within [`REACH_MM`] along every axis; NaN is not.
pub(super) fn is_within(p_mm: &DVec3) -> bool {
    p_mm.x.abs() <= REACH_MM && p_mm.y.abs() <= REACH_MM && p_mm.z.abs() <= REACH_MM
}

/// Whether a matrix is positive definite beyond doubt, by its pivots, which is cheaper than eigenvalues.
fn is_positive(c: &Symmetric<3>) -> bool {
    let doubt = 1e-6 * (c[0][0] + c[1][1] + c[2][2]);
    let (first, y, z) = (c[0][0], c[0][1] / c[0][0], c[0][2] / c[0][0]);
    let (second, across) = (c[1][1] - c[0][1] * y, c[1][2] - c[0][1] * z);
    let third = c[2][2] - c[0][2] * z - across * across / second;
    doubt > 0.0 && first > doubt && second > doubt && third > doubt
}

/// Largest distance from the patch of the unpressed markers that are used.
const AROUND_MM: f64 = 6.0;
/// Largest distance of those for coarse passes.
const BESIDE_MM: f64 = 3.5;
/// Number of salient points in a coarse pass.
pub(super) const COARSE: usize = 24;
/// Number of other markers in a coarse pass, from those beside the patch.
const COARSE_UNPRESSED: usize = 48;
const MEDIUM_UNPRESSED: usize = 128;
/// Number of salient points in a medium pass.
pub(super) const MEDIUM: usize = 64;

/// The points of one contact. The first [`COARSE`] and [`MEDIUM`] of `pressed` are spread over the patch.
#[derive(Clone, Debug, Default)]
pub(super) struct Samples {
    pub centre_mm: DVec3,
    /// As [`AdvancedRegisterParams::gel_scale`].
    pub gel_scale: f64,
    /// Rms radius of the patch.
    pub radius_mm: f64,
    pub pressed: Vec<Sample>,
    /// How many of them are spread over the patch.
    pub spread_count: usize,
    /// How many of them may be in contact; they come first.
    may_touch: usize,
    /// Unpressed markers, those for coarse passes first.
    pub unpressed: Vec<Sample>,
    /// How many of `unpressed` a coarse and a medium pass use.
    pub coarse_unpressed: usize,
    pub medium_unpressed: usize,
    /// For every salient point, the nearest salient ones; its own index where there are fewer.
    pub neighbours: Vec<[u32; NEIGHBOURS]>,
    /// Position along the press from which markers are salient.
    pub salient_from_mm: f64,
    /// Height from the lowest salient point to the highest, at least that which noise gives level ones.
    pub height_mm: f64,
    /// Decay length of the gel's surface beside the contact.
    pub decay_mm: f64,
    /// All markers, if a search uses the gel model.
    pub gel: Gel,
    pressures: Pressures,
    nearest_squared: Vec<f64>,
    flat: Vec<DVec3>,
    grid: Grid,
}

/// Which markers are used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Extent {
    /// All around the patch: a selection would depend on the frame.
    Near,
    /// Those around it, some of them in coarse passes.
    Around,
    /// The same, and all markers as nodes of the gel.
    Gel,
}

/// Largest number of salient points for a neighbour search, whose cost may grow with their square.
const MAX_ASKED: usize = 2000;

/// With fewer points that may be in contact, all are used in the first passes.
const MIN_TOUCHING: usize = 12;

/// Standard deviations within which points count as level.
const LEVEL: f64 = 8.0;

/// Number of markers around one: the eight of a lattice.
const RING: usize = 8;
/// Standard deviations by which the mean of the markers around is higher where the gel is free.
const HOLLOW: f64 = 3.0;

/// Number of neighbours that determine the prior contact probability of a salient point.
pub(super) const NEIGHBOURS: usize = 6;

impl Samples {
    /// Fills in the markers of a contact.
    pub fn fill(&mut self, contact: &Contact<'_>, params: &RegisterParams, extent: Extent) {
        let sigma_mm = params.point_sigma_mm;
        self.gel_scale = params.advanced.gel_scale;
        let square = sigma_mm * sigma_mm;
        let isotropic = [square, square, square, 0.0, 0.0, 0.0];
        self.centre_mm = crate::math::centroid(contact.points_mm);
        self.pressed.clear();
        for (k, &point) in contact.points_mm.iter().enumerate() {
            let covariance = contact.covariance_mm2.map_or(isotropic, |all| {
                let c = &all[k];
                [c[0][0], c[1][1], c[2][2], c[0][1], c[0][2], c[1][2]]
            });
            self.pressed.push(Sample::new(point - self.centre_mm, covariance));
        }
        let sum: f64 = self.pressed.iter().map(|s| s.p_mm.length_squared()).sum();
        self.radius_mm = sqrt(sum / self.pressed.len().max(1) as f64).max(10.0 * sigma_mm);
        self.may_touch = self.pressed.len();
        self.find_saliency(contact.press_direction);
        self.gel.clear();
        self.decay_mm = contact.decay_mm;
        if extent == Extent::Gel {
            self.fill_gel(contact);
        }
        self.find_hanging(contact);
        // The first point's noise scales the step tolerance, so it must be the same one in every frame.
        self.spread(if extent == Extent::Near { 1 } else { MEDIUM });
        if extent == Extent::Near {
            self.take_near(contact.unpressed_mm, isotropic);
        } else {
            self.take_unpressed(contact.unpressed_mm, isotropic);
        }
        self.find_neighbours(contact.press_direction);
    }

    /// Noise standard deviation of the salient points along a direction. The harmonic mean of the
    /// variances favours the more precise points.
    pub fn sigma_mm(&self, direction: DVec3) -> f64 {
        let sum: f64 = self.pressed.iter().map(|s| 1.0 / s.variance(direction)).sum();
        sqrt(self.pressed.len() as f64 / sum)
    }

    /// Other markers have no covariance and get the mean of the salient ones'.
    fn fill_gel(&mut self, contact: &Contact<'_>) {
        if contact.unpressed_mm.is_empty() {
            return;
        }
        let count = self.pressed.len().max(1) as f64;
        let covariance =
            core::array::from_fn(|i| self.pressed.iter().map(|s| s.covariance[i]).sum::<f64>() / count);
        let Self { pressed, gel, centre_mm, gel_scale, .. } = self;
        let others = contact.unpressed_mm.iter();
        let others = others.map(|&p| Sample::new(p - *centre_mm, covariance));
        let markers = pressed.iter().copied().chain(others);
        gel.fill(markers, pressed.len(), contact.press_direction, contact.decay_mm, *gel_scale);
    }

    /// Salient markers and those beside them, in this order, relative to the centroid with the press along z.
    fn lay_flat(&mut self, contact: &Contact<'_>) {
        let (a, b) = contact.press_direction.any_orthonormal_pair();
        let (centre_mm, beside_mm) = (self.centre_mm, BESIDE_MM * self.gel_scale);
        let flat = |p: &DVec3| {
            let p = *p - centre_mm;
            DVec3::new(p.dot(a), p.dot(b), p.dot(contact.press_direction))
        };
        self.flat.clear();
        self.flat.extend(contact.points_mm.iter().map(flat));
        let (low, high) = self
            .flat
            .iter()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)));
        let beside = |p: &DVec3| {
            let (p, margin) = (p.truncate(), beside_mm);
            p.cmpge(low.truncate() - margin).all() && p.cmple(high.truncate() + margin).all()
        };
        self.flat.extend(contact.unpressed_mm.iter().map(flat).filter(beside));
    }

    /// The lowest salient point defines where saliency begins, unless the points are level.
    fn find_saliency(&mut self, press: DVec3) {
        let along = |s: &Sample| s.p_mm.dot(press);
        let heights = || self.pressed.iter().map(along);
        let (low, high) =
            heights().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
        let sigma_mm = sqrt(self.pressed.iter().map(|s| s.variance(press)).fold(0.0, f64::max));
        self.height_mm = (high - low).max(LEVEL * sigma_mm);
        self.salient_from_mm = if high - low > LEVEL * sigma_mm { low } else { f64::NEG_INFINITY };
    }

    /// Finds the salient points that are not in contact: by the gel's pressure where the gel is known,
    /// else by its curvature.
    fn find_hanging(&mut self, contact: &Contact<'_>) {
        let count = contact.points_mm.len();
        if contact.unpressed_mm.is_empty() || count > MAX_ASKED {
            return;
        }
        if self.gel.is_known() {
            let Self { gel, pressed, pressures, radius_mm, .. } = self;
            pressures.each_free(gel, *radius_mm, |k| {
                if let Some(sample) = pressed.get_mut(k) {
                    sample.hangs = true;
                }
            });
        } else {
            self.find_hollow(contact);
        }
        // Those that may be in contact first.
        let mut touching = 0;
        for k in 0..count {
            if !self.pressed[k].hangs {
                self.pressed.swap(touching, k);
                touching += 1;
            }
        }
        self.may_touch = touching;
    }

    /// Free gel of height h obeys h - l² Δh = 0 (Pasternak 1954). It is concave, Δh > 0, where gel on a
    /// flat or round part is not. The test is the height over the mean of the markers around.
    fn find_hollow(&mut self, contact: &Contact<'_>) {
        let press = contact.press_direction;
        self.lay_flat(contact);
        self.grid.build_evenly(self.flat.iter().map(|p| p.truncate()), 0.0);
        for k in 0..contact.points_mm.len() {
            let (flat, at) = (&self.flat, self.flat[k]);
            let squared = |j: usize| {
                let (x, y) = (flat[j].x - at.x, flat[j].y - at.y);
                x * x + y * y
            };
            let ring = self.grid.nearest_others::<RING>(k, at.truncate(), squared);
            let mean = ring.iter().map(|(_, j)| flat[*j as usize] - at).sum::<DVec3>() / RING as f64;
            // The markers must be near and on all sides: next to missing markers or the gel's border
            // nothing is known.
            let is_around =
                mean.truncate().length_squared() < 0.04 * ring[0].0 && ring[RING - 1].0 < 6.25 * ring[0].0;
            let sigma_mm = sqrt(self.pressed[k].variance(press) * (1.0 + 1.0 / RING as f64));
            self.pressed[k].hangs = is_around && mean.z > HOLLOW * sigma_mm;
        }
    }

    fn find_neighbours(&mut self, press: DVec3) {
        let Self { neighbours, pressed, flat, grid, .. } = self;
        neighbours.clear();
        if pressed.len() > MAX_ASKED {
            return neighbours.resize_with(pressed.len(), || [0; NEIGHBOURS]);
        }
        let (a, b) = press.any_orthonormal_pair();
        flat.clear();
        flat.extend(pressed.iter().map(|s| DVec3::new(s.p_mm.dot(a), s.p_mm.dot(b), s.p_mm.dot(press))));
        grid.build_evenly(flat.iter().map(|p| p.truncate()), 0.0);
        for (k, s) in pressed.iter().enumerate() {
            let squared = |j: usize| s.p_mm.distance_squared(pressed[j].p_mm);
            let best = grid.nearest_others::<NEIGHBOURS>(k, flat[k].truncate(), squared);
            // Points behind a gap are no neighbours.
            let limit = 4.0 * best[0].0;
            neighbours.push(best.map(|(squared, j)| if squared <= limit { j } else { k as u32 }));
        }
    }

    /// Number of leading points that are used in the first passes.
    pub fn may_touch(&self) -> usize {
        if self.may_touch >= MIN_TOUCHING { self.may_touch } else { self.pressed.len() }
    }

    /// Moves points that are far from each other to the front (farthest-point sampling, Gonzalez 1985),
    /// beginning with the one nearest to the centroid.
    fn spread(&mut self, max_count: usize) {
        let among = self.may_touch();
        let count = max_count.min(among);
        self.spread_count = count;
        self.nearest_squared.clear();
        self.nearest_squared.extend(self.pressed.iter().map(|s| 1.0 / (1e-30 + s.p_mm.length_squared())));
        for k in 0..count {
            let rest = &self.nearest_squared[k..among];
            let best = (1..rest.len()).fold(0, |best, i| if rest[i] > rest[best] { i } else { best }) + k;
            self.pressed.swap(k, best);
            self.nearest_squared.swap(k, best);
            if k == 0 {
                self.nearest_squared.fill(f64::INFINITY);
            }
            let from = self.pressed[k].p_mm;
            for (near, s) in self.nearest_squared.iter_mut().zip(&self.pressed).skip(k + 1) {
                *near = near.min(s.p_mm.distance_squared(from));
            }
        }
    }

    /// Takes the unpressed markers within the radius of the patch's outermost point plus [`BESIDE_MM`].
    fn take_near(&mut self, unpressed_mm: &[DVec3], covariance: [f64; 6]) {
        let widest = self.pressed.iter().map(|s| s.p_mm.length_squared()).fold(0.0, f64::max);
        let reach_mm = sqrt(widest) + BESIDE_MM * self.gel_scale;
        let centre_mm = self.centre_mm;
        let near = |&p: &DVec3| {
            let p_mm = p - centre_mm;
            let is_near = p_mm.length_squared() <= reach_mm * reach_mm;
            is_near.then_some(Sample::new(p_mm, covariance))
        };
        self.unpressed.clear();
        self.unpressed.extend(unpressed_mm.iter().filter_map(near));
        (self.coarse_unpressed, self.medium_unpressed) = (self.unpressed.len(), self.unpressed.len());
    }

    /// Takes those around the patch: a sample of those beside it first, then the others beside it, then
    /// the rest.
    fn take_unpressed(&mut self, unpressed_mm: &[DVec3], covariance: [f64; 6]) {
        self.unpressed.clear();
        let spread = &self.pressed[..COARSE.min(self.pressed.len())];
        let [around_mm, beside_mm] = [AROUND_MM, BESIDE_MM].map(|mm| mm * self.gel_scale);
        let mut beside = 0;
        for &point in unpressed_mm {
            let p_mm = point - self.centre_mm;
            let near = spread.iter().map(|s| s.p_mm.distance_squared(p_mm)).fold(f64::INFINITY, f64::min);
            if near > around_mm * around_mm {
                continue;
            }
            self.unpressed.push(Sample::new(p_mm, covariance));
            if near <= beside_mm * beside_mm {
                let last = self.unpressed.len() - 1;
                self.unpressed.swap(beside, last);
                beside += 1;
            }
        }
        // Samples those beside in equal steps; they come in the order of the lattice.
        self.coarse_unpressed = COARSE_UNPRESSED.min(beside);
        self.medium_unpressed = MEDIUM_UNPRESSED.min(beside);
        for k in 1..self.medium_unpressed {
            self.unpressed.swap(k, k * beside / self.medium_unpressed);
        }
        let second = self.medium_unpressed;
        for k in 1..self.coarse_unpressed {
            self.unpressed.swap(k, k * second / self.coarse_unpressed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::random::Stream;

    /// The evidence divides by variances and by the patch's height, and takes logarithms of them. Both must
    /// stay positive for level points whose variance along the press is zero, or negative by rounding.
    #[test]
    fn row_32_a_direction_known_exactly_leaves_positive_variances() {
        for along_press in [0.0, -1e-9] {
            let covariance = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, along_press]];
            let points: Vec<DVec3> =
                (0..16).map(|k| DVec3::new(f64::from(k % 4), f64::from(k / 4), 28.0)).collect();
            let covariances = [covariance; 16];
            let contact = Contact { covariance_mm2: Some(&covariances), ..Contact::new(&points) };
            assert_eq!(contact.check(), Ok(()));
            let mut samples = Samples::default();
            samples.fill(&contact, &RegisterParams::default(), Extent::Around);
            assert!(samples.height_mm > 0.0, "{}", samples.height_mm);
            for sample in &samples.pressed {
                let variance = sample.variance(DVec3::NEG_Z);
                assert!(variance > 0.0 && variance < 1e-5 && sample.max_sigma_mm.is_finite(), "{variance}");
            }
        }
    }

    #[test]
    fn what_is_positive_by_its_pivots_has_positive_eigenvalues_only() {
        let mut random = Stream::new(1, "pivots");
        let mut seen = [0; 2];
        for _ in 0..2000 {
            let scale = crate::math::exp(20.0 * random.uniform() - 10.0);
            let mut c = [[0.0; 3]; 3];
            for i in 0..3 {
                c[i][i] = scale * (random.uniform() - 0.1);
                for k in 0..i {
                    c[i][k] = scale * (random.uniform() - 0.5);
                    c[k][i] = c[i][k];
                }
            }
            let values = eigen(&c).values;
            seen[usize::from(is_positive(&c))] += 1;
            // Every pivot is at least the least eigenvalue, so a pivot that fails bounds it relative to
            // the trace.
            assert!(!is_positive(&c) || values[0] > 0.0, "{c:?} {values:?}");
            assert!(is_positive(&c) || values[0] < 2e-6 * (c[0][0] + c[1][1] + c[2][2]).abs(), "{c:?}");
        }
        assert!(seen[0] > 200 && seen[1] > 200, "{seen:?}");
    }
}
