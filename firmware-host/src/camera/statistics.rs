//! What a camera really does: rate, latency, losses.

use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Pairs that rate and latency are measured over: half a minute at 30 Hz.
const WINDOW: usize = 1024;

/// What a camera really does. Counts are since it was opened, rate and latency of the last 1024 pairs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraStatistics {
    /// Pairs handed over.
    pub pairs: u64,
    /// Pairs lost or passed over.
    pub dropped: u64,
    /// Frames that could not be used.
    pub corrupt: u64,
    /// Images without a partner near enough in time.
    pub skewed: u64,
    /// Sequence numbers that cannot be.
    pub sequence_faults: u64,
    /// Timestamps that cannot be.
    pub timestamp_faults: u64,
    /// Times that a device sent nothing for too long.
    pub stalls: u64,
    /// Times that a device went away, or could not be opened again.
    pub disconnects: u64,
    /// Times that a device was opened, the first one included.
    pub connects: u64,
    /// Events that nobody fetched.
    pub lost_events: u64,
    /// Pairs handed over in a second, by the driver's timestamps; absent before the second pair.
    pub rate_hz: Option<f64>,
    /// Pairs that the camera took in a second, lost ones included.
    pub camera_rate_hz: Option<f64>,
    /// Time from the driver's timestamp to the decoded pair: half of the pairs take at most so long.
    pub latency_p50_ms: Option<f64>,
    /// 99 % of the pairs take at most so long.
    pub latency_p99_ms: Option<f64>,
    /// The longest.
    pub latency_max_ms: Option<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    driver_ns: u64,
    latency_ns: u64,
    dropped: u64,
}

/// Collects [`CameraStatistics`].
#[derive(Clone, Debug, Default)]
pub struct Statistics {
    /// The counts; rate and latency are filled in by [`Self::summary`].
    pub counts: CameraStatistics,
    samples: VecDeque<Sample>,
}

impl Statistics {
    /// Takes a pair: the driver's timestamp, when it was decoded, and pairs lost before it.
    pub fn pair(&mut self, driver_ns: u64, decoded_ns: u64, dropped: u64) {
        self.counts.pairs += 1;
        self.counts.dropped += dropped;
        if self.samples.len() == WINDOW {
            self.samples.pop_front();
        }
        self.samples.push_back(Sample {
            driver_ns,
            latency_ns: decoded_ns.saturating_sub(driver_ns),
            dropped,
        });
    }

    /// The pairs to come have nothing to do with those before: the camera was opened again.
    pub fn restart(&mut self) {
        self.samples.clear();
    }

    /// Counts, rate and latency.
    #[must_use]
    pub fn summary(&self) -> CameraStatistics {
        let mut summary = self.counts;
        if let (Some(first), Some(last)) = (self.samples.front(), self.samples.back())
            && last.driver_ns > first.driver_ns
        {
            let seconds = (last.driver_ns - first.driver_ns) as f64 * 1e-9;
            let handed_over = self.samples.len() as u64 - 1;
            let dropped: u64 = self.samples.iter().skip(1).map(|sample| sample.dropped).sum();
            summary.rate_hz = Some(handed_over as f64 / seconds);
            summary.camera_rate_hz = Some((handed_over + dropped) as f64 / seconds);
        }
        let mut latencies: Vec<u64> = self.samples.iter().map(|sample| sample.latency_ns).collect();
        latencies.sort_unstable();
        summary.latency_p50_ms = percentile_ms(&latencies, 50);
        summary.latency_p99_ms = percentile_ms(&latencies, 99);
        summary.latency_max_ms = percentile_ms(&latencies, 100);
        summary
    }
}

/// The smallest of the sorted values that so many percent do not exceed.
fn percentile_ms(sorted_ns: &[u64], percent: usize) -> Option<f64> {
    let rank = (sorted_ns.len() * percent).div_ceil(100);
    sorted_ns.get(rank.saturating_sub(1)).map(|&ns| ns as f64 * 1e-6)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn rate_and_latency_are_those_of_the_pairs() {
        let mut statistics = Statistics::default();
        assert_eq!(statistics.summary(), CameraStatistics::default());
        // 101 pairs at 25 Hz of a camera that takes 50 Hz; latencies 1 to 101 ms.
        for n in 0..101u64 {
            let driver_ns = n * 40_000_000;
            statistics.pair(driver_ns, driver_ns + (n + 1) * 1_000_000, u64::from(n > 0));
        }
        let summary = statistics.summary();
        assert_eq!((summary.pairs, summary.dropped), (101, 100));
        assert!((summary.rate_hz.unwrap() - 25.0).abs() < 1e-9);
        assert!((summary.camera_rate_hz.unwrap() - 50.0).abs() < 1e-9);
        assert_eq!(summary.latency_p50_ms, Some(51.0));
        assert_eq!(summary.latency_p99_ms, Some(100.0));
        assert_eq!(summary.latency_max_ms, Some(101.0));
    }

    #[test]
    fn memory_is_bounded() {
        let mut statistics = Statistics::default();
        for n in 0..5000 {
            statistics.pair(n * 1000, n * 1000 + 500, 0);
        }
        assert_eq!(statistics.samples.len(), WINDOW);
        assert_eq!(statistics.summary().pairs, 5000);
    }
}
