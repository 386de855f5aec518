//! The gel's decay length, estimated from the shoulder beside contacts.
//!
//! A free marker carries no pressure, h = l² Δh, anywhere: the sums Σ h² and Σ h Δh over free markers
//! have the ratio l². Heights exceed their noise a hundredfold; second differences do not. The sums,
//! corrected for the mean contribution of noise, are therefore the least-squares fit of Δh to h. The free
//! markers are those that [`Pressure`] does not find salient. It needs no exact length for that, provided
//! the given one is too long: free markers then have pressures below 0. With a length that is too short
//! by more than a tenth, the whole shoulder may count as contact, which leaves nothing to estimate from.
//!
//! Simulated, four presses of a part: from a first guess of 2.5 to 8 mm, the true 2.5 mm to 0.07 mm with
//! 10 um of noise and to 0.0005 mm with 0.1 um, for every part.

use super::Pressure;
use crate::math::sqrt;
use crate::track::MarkerState;
use alloc::vec::Vec;

/// Rows and columns between a salient marker and a free one: rim markers may be misclassified as free.
const MARGIN: usize = 2;

/// A decay length and its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decay {
    /// The length, for `contact.decay_mm`.
    pub decay_mm: f64,
    /// Its standard deviation, from the noise of the heights. It excludes the difference between a second
    /// difference and a second derivative: the length is used with the same differences.
    pub sigma_mm: f64,
    /// Number of observations of free markers.
    pub markers: usize,
}

/// Sums over free markers of any number of frames.
#[derive(Clone, Debug, Default)]
pub struct DecayFit {
    /// Σ h².
    heights_mm2: f64,
    /// Σ h Δh.
    curvatures: f64,
    /// Variance of Σ h Δh, its covariance with Σ h², and the variance of Σ h², from the noise of the
    /// heights.
    variance: [f64; 3],
    markers: usize,
    free: Vec<bool>,
    gradient: Vec<[f64; 2]>,
}

impl DecayFit {
    /// Clears all frames, and reserves memory for this many markers.
    pub fn start(&mut self, markers: usize) {
        self.free.clear();
        self.free.reserve(markers);
        self.gradient.clear();
        self.gradient.reserve(markers);
        let (free, gradient) = (core::mem::take(&mut self.free), core::mem::take(&mut self.gradient));
        *self = Self { free, gradient, ..Self::default() };
    }

    /// Adds the last frame processed by `pressure`, with its indentations, states and salient markers. A
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
            // The marker's noise is in both factors.
            let own = pressure.stencils().taps(i).next().map_or(0.0, |(_, weight)| (1.0 - weight) / l2);
            self.heights_mm2 += h * h - variance_mm2[i];
            self.curvatures += h * curvature - own * variance_mm2[i];
            self.markers += 1;
            self.gradient[i][0] += curvature + h / l2;
            self.gradient[i][1] += 2.0 * h;
            let mut squares = 0.0;
            for (k, weight) in pressure.stencils().taps(i) {
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

    /// Selects free markers whose neighbours are all seen: inside the lattice, and not near a salient
    /// one.
    fn choose(&mut self, pressure: &Pressure, state: &[MarkerState], salient: &[bool]) {
        self.free.clear();
        self.free.extend((0..salient.len()).map(|i| {
            let seen = |(k, _): (usize, f64)| state[k] == MarkerState::Seen;
            pressure.stencils().is_inner(i) && pressure.stencils().taps(i).all(seen)
        }));
        for i in (0..salient.len()).filter(|&i| salient[i]) {
            pressure.stencils().window(i, MARGIN).for_each(|k| self.free[k] = false);
        }
    }

    /// The length, or `None` until its standard deviation is below a third of it, for example before any
    /// contact.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::RestSurface;
    use crate::math::DVec3;
    use crate::math::random::Stream;
    use alloc::vec;

    /// Gel that is flat but for noise adds nothing to the sums on average. Over n markers the sum of squares
    /// less their variance has a standard deviation of √(2n) variances; five of them.
    #[test]
    fn noise_adds_no_height() {
        const SIDE: usize = 25;
        let at = |i: usize| DVec3::new(0.9 * (i % SIDE) as f64, 0.9 * (i / SIDE) as f64, 30.0);
        let rest = RestSurface::new(&(0..SIDE * SIDE).map(at).collect::<Vec<_>>()).unwrap();
        let mut pressure = Pressure::new(&rest, SIDE, SIDE, 2.5).unwrap();
        let (mut fit, mut stream, mut found) = (DecayFit::default(), Stream::new(3, "flat gel"), Vec::new());
        let (state, mut salient) = ([MarkerState::Seen; SIDE * SIDE], vec![false; SIDE * SIDE]);
        salient[0] = true;
        fit.start(SIDE * SIDE);
        for _ in 0..20 {
            let heights_mm: Vec<f64> = (0..SIDE * SIDE).map(|_| 0.01 * stream.normal()).collect();
            pressure.run(&heights_mm, core::iter::repeat_n(1e-4, SIDE * SIDE), &state, &mut found).unwrap();
            fit.add(&pressure, &heights_mm, &state, &salient);
        }
        assert!(fit.markers > 9000, "{}", fit.markers);
        let most_mm2 = 5.0 * sqrt(2.0 * fit.markers as f64) * 1e-4;
        assert!(fit.heights_mm2.abs() < most_mm2, "{} mm2", fit.heights_mm2);
    }
}
