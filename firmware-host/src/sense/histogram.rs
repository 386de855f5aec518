//! Quantiles of an unbounded stream of durations in fixed memory.

use std::time::Duration;

/// Bins per doubling: a quantile is too long by at most 1/16 of a doubling (4.4 %).
const BINS_PER_DOUBLING: f64 = 16.0;
/// From 1 µs to 2^30 µs (18 minutes); durations outside count in the first or last bin.
const BINS: usize = 30 * BINS_PER_DOUBLING as usize + 1;

/// Counts of durations in bins of equal ratio. Counts are exact; a quantile is the upper edge of its bin.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    counts: Vec<u64>,
    total: u64,
    max: Duration,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { counts: vec![0; BINS], total: 0, max: Duration::ZERO }
    }
}

impl Histogram {
    /// Counts one duration.
    pub fn add(&mut self, duration: Duration) {
        let bin = (duration.as_secs_f64() * 1e6).log2() * BINS_PER_DOUBLING;
        // A cast of a negative number gives 0.
        self.counts[(bin.ceil() as usize).min(BINS - 1)] += 1;
        self.total += 1;
        self.max = self.max.max(duration);
    }

    /// Number of durations counted.
    #[must_use]
    pub const fn total(&self) -> u64 {
        self.total
    }

    /// The longest duration.
    #[must_use]
    pub const fn max(&self) -> Duration {
        self.max
    }

    /// The `q` quantile, at most 4.4 % too long; `None` before the first duration.
    #[must_use]
    pub fn quantile(&self, q: f64) -> Option<Duration> {
        let wanted = ((q * self.total as f64).ceil() as u64).max(1);
        let mut below = 0;
        let bin = self.counts.iter().position(|count| {
            below += count;
            below >= wanted
        })?;
        let edge = Duration::from_secs_f64((bin as f64 / BINS_PER_DOUBLING).exp2() * 1e-6);
        Some(edge.min(self.max))
    }

    /// Adds the counts of `other`.
    pub fn merge(&mut self, other: &Self) {
        for (count, more) in self.counts.iter_mut().zip(&other.counts) {
            *count += more;
        }
        self.total += other.total;
        self.max = self.max.max(other.max);
    }

    /// Clears all counts.
    pub fn clear(&mut self) {
        self.counts.fill(0);
        self.total = 0;
        self.max = Duration::ZERO;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn quantiles_are_those_of_the_sorted_list(
            mut micros in prop::collection::vec(1_u64..1_000_000_000, 1..300),
            q in 0.0..=1.0_f64,
        ) {
            let mut histogram = Histogram::default();
            micros.iter().for_each(|&us| histogram.add(Duration::from_micros(us)));
            micros.sort_unstable();
            let rank = ((q * micros.len() as f64).ceil() as usize).max(1);
            let exact = micros[rank - 1] as f64;
            let found = histogram.quantile(q).map_or(0.0, |d| d.as_secs_f64() * 1e6);
            // Durations are rounded to nanoseconds.
            prop_assert!(found > exact - 0.002 && found <= exact * 1.0443 + 0.002, "{found} for {exact}");
            prop_assert_eq!(histogram.total(), micros.len() as u64);
        }

        #[test]
        fn merging_counts_all(
            first in prop::collection::vec(0_u64..5_000_000, 0..50),
            second in prop::collection::vec(0_u64..5_000_000, 0..50),
        ) {
            let of = |list: &[u64]| {
                let mut histogram = Histogram::default();
                list.iter().for_each(|&us| histogram.add(Duration::from_micros(us)));
                histogram
            };
            let mut merged = of(&first);
            merged.merge(&of(&second));
            prop_assert_eq!(merged, of(&[first, second].concat()));
        }
    }

    #[test]
    fn what_is_outside_the_bins_is_counted_too() {
        let mut histogram = Histogram::default();
        assert_eq!(histogram.quantile(0.5), None);
        histogram.add(Duration::ZERO);
        histogram.add(Duration::from_secs(100_000));
        assert_eq!((histogram.total(), histogram.max()), (2, Duration::from_secs(100_000)));
        assert_eq!(histogram.quantile(0.5), Some(Duration::from_micros(1)));
        histogram.clear();
        assert_eq!(histogram, Histogram::default());
    }
}
