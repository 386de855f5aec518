//! The gel's decay length, told from the shoulder beside contacts.
//!
//! A free marker carries no pressure, h = l² Δh, wherever it stands: the sums Σ h² and Σ h Δh over free markers have the ratio
//! l². Heights stand out of their noise a hundredfold where second differences do not, so that the sums, less what noise adds
//! to them in the mean, are the least squares of Δh over h. Which markers are free is taken from the saliency of
//! [`Pressure`], which need not know the length for that if it is given one that is too long: free markers then show
//! pressures below 0. With one that is too short by more than a tenth it may take the whole shoulder for contact, and nothing
//! is left to tell the length from.
//!
//! Simulated, four presses of a part: from a first guess of 2.5 to 8 mm the true 2.5 mm to 0.07 mm at 10 um of noise, to
//! 0.0005 mm at 0.1 um, whatever the part.

use super::Pressure;
use crate::math::sqrt;
use crate::track::MarkerState;
use alloc::vec::Vec;

/// Rows and columns between a salient marker and one that is taken as free: rim markers may pass for free ones.
const MARGIN: usize = 2;

/// A decay length and how well it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decay {
    /// The length, for `contact.decay_mm`.
    pub decay_mm: f64,
    /// Its standard deviation, from the noise of the heights. The difference between a second difference and a second derivative
    /// is not in it: it belongs to the length, which is used with the same differences.
    pub sigma_mm: f64,
    /// How often a free marker was counted.
    pub markers: usize,
}

/// Sums over free markers of any number of frames.
#[derive(Clone, Debug, Default)]
pub struct DecayFit {
    /// Σ h².
    heights_mm2: f64,
    /// Σ h Δh.
    curvatures: f64,
    /// Derivatives of Σ h Δh and of Σ h² by the noise of each height, times its variance, as squares and product.
    variance: [f64; 3],
    markers: usize,
    free: Vec<bool>,
    gradient: Vec<[f64; 2]>,
}

impl DecayFit {
    /// Forgets all frames, and makes room for so many markers: none is allocated later.
    pub fn start(&mut self, markers: usize) {
        self.free.clear();
        self.free.reserve(markers);
        self.gradient.clear();
        self.gradient.reserve(markers);
        let (free, gradient) = (core::mem::take(&mut self.free), core::mem::take(&mut self.gradient));
        *self = Self { free, gradient, ..Self::default() };
    }

    /// Adds the frame that `pressure` was run on last, with its indentations and states and the salient markers that it gave. A
    /// frame without contact adds nothing.
    pub fn add(
        &mut self,
        pressure: &Pressure,
        indentation_mm: &[f64],
        state: &[MarkerState],
        salient: &[bool],
    ) {
        let count = pressure.pressure_mm().len();
        let fits = [indentation_mm.len(), state.len(), salient.len()].iter().all(|&len| len == count);
        if !fits || !salient.contains(&true) {
            return;
        }
        self.choose(pressure, state, salient);
        self.gradient.clear();
        self.gradient.resize(count, [0.0; 2]);
        let variance_mm2 = pressure.variance_mm2();
        let l2 = pressure.decay_mm() * pressure.decay_mm();
        for i in (0..count).filter(|&i| self.free[i]) {
            let h = indentation_mm[i];
            let curvature = (h - pressure.pressure_mm()[i]) / l2;
            // Noise of the marker is in both factors.
            let own = pressure.taps(i).next().map_or(0.0, |(_, weight)| (1.0 - weight) / l2);
            self.heights_mm2 += h * h - variance_mm2[i];
            self.curvatures += h * curvature - own * variance_mm2[i];
            self.markers += 1;
            self.gradient[i][0] += curvature + h / l2;
            self.gradient[i][1] += 2.0 * h;
            let mut squares = 0.0;
            for (k, weight) in pressure.taps(i) {
                self.gradient[k][0] -= h * weight / l2;
                squares += variance_mm2[k] * weight * weight / (l2 * l2);
            }
            // Products of two noises.
            self.variance[0] += variance_mm2[i] * squares;
        }
        for (&[curvature, height], &variance) in self.gradient.iter().zip(variance_mm2) {
            self.variance[0] += variance * curvature * curvature;
            self.variance[1] += variance * curvature * height;
            self.variance[2] += variance * height * height;
        }
    }

    /// Free markers, of which all neighbours are seen: within the lattice, and not beside a salient one.
    fn choose(&mut self, pressure: &Pressure, state: &[MarkerState], salient: &[bool]) {
        self.free.clear();
        self.free.extend((0..salient.len()).map(|i| {
            let seen = |(k, _): (usize, f64)| state[k] == MarkerState::Seen;
            pressure.taps(i).count() == 5 && pressure.taps(i).all(seen)
        }));
        for i in (0..salient.len()).filter(|&i| salient[i]) {
            pressure.window(i, MARGIN).for_each(|k| self.free[k] = false);
        }
    }

    /// The length, or `None` while it is not known to a third of itself: after frames without contact, say.
    #[must_use]
    pub fn decay(&self) -> Option<Decay> {
        let inverse = self.curvatures / self.heights_mm2; // 1 / l²
        let [cc, ch, hh] = self.variance;
        let variance = (cc - 2.0 * inverse * ch + inverse * inverse * hh).max(0.0);
        let sigma = sqrt(variance) / self.heights_mm2;
        let decay_mm = 1.0 / sqrt(inverse);
        let sigma_mm = 0.5 * decay_mm * sigma / inverse;
        (self.heights_mm2 > 0.0 && inverse > 0.0 && 3.0 * sigma_mm < decay_mm).then_some(Decay {
            decay_mm,
            sigma_mm,
            markers: self.markers,
        })
    }
}
