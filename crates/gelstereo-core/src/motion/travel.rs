//! How far a contact moves over the part and over the gel.

use super::cloud::Cloud;
use crate::math::linalg::Symmetric;
use crate::math::{DMat3, DVec3, sqrt};
use crate::slip::RigidMotion;
use alloc::vec::Vec;

/// How a part moves along the gel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[repr(u8)]
pub enum MotionKind {
    /// The contact is new, or it is not known whether the gel holds the part.
    #[default]
    Unknown = 0,
    /// The part is held, and the contact stays on the same part of its surface.
    Rests = 1,
    /// The contact moves over the part and over the gel in the same direction.
    Rolls = 2,
    /// The gel does not hold the part, which moves along it.
    Slides = 3,
    /// Both.
    RollsAndSlides = 4,
}

impl MotionKind {
    /// All values with their names.
    pub const ALL: [(&'static str, Self); 5] = [
        ("UNKNOWN", Self::Unknown),
        ("RESTS", Self::Rests),
        ("ROLLS", Self::Rolls),
        ("SLIDES", Self::Slides),
        ("ROLLS_AND_SLIDES", Self::RollsAndSlides),
    ];
}

/// Travel of a contact within some frames. Lengths are along the gel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Travel {
    /// Number of frames: `motion.window_frames` to twice as many, less in new contacts.
    pub frames: u32,
    /// How far the contact's centroid has moved over the part's surface.
    pub over_part_mm: DVec3,
    /// Its standard deviation in that direction.
    pub over_part_sigma_mm: f64,
    /// How far the contact's centroid has moved over the gel.
    pub over_gel_mm: DVec3,
    /// Its standard deviation in that direction.
    pub over_gel_sigma_mm: f64,
    /// How far the part has moved along the markers, in the mean over the contact.
    pub slid_mm: DVec3,
    /// Its standard deviation in that direction.
    pub slid_sigma_mm: f64,
}

/// Whether the gel holds the part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Hold {
    Unknown,
    Sticks,
    Slides,
}

/// Sums over the frames of a contact. Errors of the centroid cancel between two steps.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    frame: u32,
    over_part_mm: DVec3,
    slid_mm: DVec3,
    /// Covariance of the part's shift. It is an upper bound: steps are counted as independent, but the noise
    /// of a frame between two steps cancels.
    drift_mm2: DMat3,
    /// Covariance of the markers' mean shift, also a bound.
    noise_mm2: DMat3,
    centroid: Centroid,
}

/// Centroid of the contact, on the part and on the gel.
#[derive(Clone, Copy, Debug, Default)]
struct Centroid {
    part_mm: DVec3,
    gel_mm: DVec3,
    covariance_mm2: DMat3,
}

/// Compares each frame with one `window` to twice as many frames ago.
#[derive(Clone, Debug)]
pub(super) struct TravelMeter {
    window: u32,
    rest_mm: Vec<DVec3>,
    up: DVec3,
    now: Sums,
    /// Frames that later ones are compared with: the older one first.
    references: [Sums; 2],
}

impl TravelMeter {
    pub fn new(window: u32, rest_mm: &[DVec3], up: DVec3) -> Self {
        let sums = Sums::default();
        Self { window, rest_mm: rest_mm.to_vec(), up, now: sums, references: [sums; 2] }
    }

    /// Begins with the first frame of a contact.
    pub fn start(&mut self, cloud: &Cloud) {
        self.now = Sums { centroid: self.centroid(cloud), ..Sums::default() };
        self.references = [self.now; 2];
    }

    /// Travel up to a frame, from the part's motion since the last one.
    pub fn travel(&mut self, step: &RigidMotion, last: &Cloud, cloud: &Cloud) -> Travel {
        self.add(step, last, cloud);
        let travel = self.since(&self.references[0]);
        if self.now.frame >= self.references[1].frame.saturating_add(self.window) {
            self.references = [self.references[1], self.now];
        }
        travel
    }

    fn add(&mut self, step: &RigidMotion, last: &Cloud, cloud: &Cloud) {
        let (mut slid, mut noise, mut count) = (DVec3::ZERO, DMat3::ZERO, 0.0);
        for (then, now) in last.elements.iter().zip(&cloud.elements).filter(|(a, b)| a.is_used && b.is_used) {
            slid += step.pose.transform_point(then.point_mm) - now.point_mm;
            noise += then.covariance_mm2 + now.covariance_mm2;
            count += 1.0;
        }
        let count = f64::max(count, 1.0);
        let centroid = self.centroid(cloud);
        let over_part = centroid.part_mm - step.pose.transform_point(self.now.centroid.part_mm);
        let sums = &mut self.now;
        sums.frame = sums.frame.saturating_add(1);
        sums.over_part_mm += over_part - self.up * over_part.dot(self.up);
        sums.slid_mm += (slid - self.up * slid.dot(self.up)) / count;
        sums.drift_mm2 += translations(&step.covariance);
        sums.noise_mm2 += noise * (1.0 / (count * count));
        sums.centroid = centroid;
    }

    fn since(&self, from: &Sums) -> Travel {
        let now = &self.now;
        let gel_mm = now.centroid.gel_mm - from.centroid.gel_mm;
        let over_gel_mm = gel_mm - self.up * gel_mm.dot(self.up);
        let [over_part_mm, slid_mm] = [now.over_part_mm - from.over_part_mm, now.slid_mm - from.slid_mm];
        let centroids = now.centroid.covariance_mm2 + from.centroid.covariance_mm2;
        let (drift, noise) = (now.drift_mm2 - from.drift_mm2, now.noise_mm2 - from.noise_mm2);
        Travel {
            frames: now.frame - from.frame,
            over_part_mm,
            over_part_sigma_mm: self.sigma_mm(&(centroids + drift), over_part_mm),
            over_gel_mm,
            over_gel_sigma_mm: self.sigma_mm(&centroids, over_gel_mm),
            slid_mm,
            slid_sigma_mm: self.sigma_mm(&(noise + drift), slid_mm),
        }
    }

    /// Standard deviation in the direction of `v`.
    fn sigma_mm(&self, covariance_mm2: &DMat3, v: DVec3) -> f64 {
        let along = v.try_normalize().unwrap_or_else(|| self.up.any_orthonormal_vector());
        sqrt(along.dot(*covariance_mm2 * along).max(0.0))
    }

    fn centroid(&self, cloud: &Cloud) -> Centroid {
        let (mut sum, mut gel, mut count) = (DVec3::ZERO, DVec3::ZERO, 0.0);
        for (element, rest) in cloud.elements.iter().zip(&self.rest_mm).filter(|(e, _)| e.is_used) {
            sum += element.point_mm;
            gel += *rest;
            count += 1.0;
        }
        let count = f64::max(count, 1.0);
        let part_mm = sum / count;
        // Markers at the border may be in contact or not, with equal odds.
        let mut covariance_mm2 = DMat3::ZERO;
        for (i, element) in cloud.elements.iter().enumerate() {
            if element.is_used && cloud.is_border(i) {
                let off_mm = element.point_mm - part_mm;
                covariance_mm2 += outer(off_mm, off_mm * (0.25 / (count * count)));
            }
        }
        Centroid { part_mm, gel_mm: gel / count, covariance_mm2 }
    }
}

impl Travel {
    /// How the part moves, if squared lengths over their variances beyond `gate` are no noise.
    pub(super) fn kind(&self, gate: f64, hold: Hold) -> MotionKind {
        let exceeds = |v: DVec3, sigma: f64| v.length_squared() > gate * sigma * sigma;
        let rolls = exceeds(self.over_part_mm, self.over_part_sigma_mm)
            && exceeds(self.over_gel_mm, self.over_gel_sigma_mm)
            && self.over_part_mm.dot(self.over_gel_mm) > 0.0;
        match (rolls, hold) {
            (true, Hold::Slides) => MotionKind::RollsAndSlides,
            (true, _) => MotionKind::Rolls,
            (false, Hold::Slides) => MotionKind::Slides,
            (false, Hold::Sticks) => MotionKind::Rests,
            (false, Hold::Unknown) => MotionKind::Unknown,
        }
    }
}

fn translations(covariance: &Symmetric<6>) -> DMat3 {
    DMat3::from_cols_array_2d(&core::array::from_fn(|i| core::array::from_fn(|k| covariance[3 + i][3 + k])))
}

fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}
