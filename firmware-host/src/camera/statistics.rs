//! Measured performance of a camera: rate, latency, losses.

use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Number of pairs for rate and latency: half a minute at 30 Hz.
const WINDOW: usize = 1024;

/// Measured performance of a camera. Counts start at opening; rate and latency cover the last 1024 pairs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraStatistics {
    /// Pairs delivered.
    pub pairs: u64,
    /// Pairs lost or skipped.
    pub dropped: u64,
    /// Unusable frames.
    pub corrupt: u64,
    /// Images without a partner close enough in time.
    pub skewed: u64,
    /// Impossible sequence numbers.
    pub sequence_faults: u64,
    /// Invalid timestamps.
    pub timestamp_faults: u64,
    /// Times that a device sent nothing for too long.
    pub stalls: u64,
    /// Times that a device was disconnected or could not be reopened.
    pub disconnects: u64,
    /// Times that a device was opened, including the first.
    pub connects: u64,
    /// Events dropped before they were fetched.
    pub lost_events: u64,
    /// Pairs delivered per second, by the driver's timestamps; `None` before the second pair.
    pub rate_hz: Option<f64>,
    /// Pairs captured per second, including lost ones.
    pub camera_rate_hz: Option<f64>,
    /// Median time from the driver's timestamp to the decoded pair.
    pub latency_p50_ms: Option<f64>,
    /// 99th percentile of this time.
    pub latency_p99_ms: Option<f64>,
    /// Maximum of this time.
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
    /// Counts; [`Self::summary`] adds rate and latency.
    pub counts: CameraStatistics,
    samples: VecDeque<Sample>,
}

impl Statistics {
    /// Adds a pair: the driver's timestamp, the time of decoding, and the number of pairs lost before it.
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

    /// Discards the samples when the camera was reopened: earlier timestamps are unrelated to later ones.
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

/// Nearest-rank percentile of sorted values.
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
        // 101 pairs at 25 Hz of a camera that captures at 50 Hz; latencies 1 to 101 ms.
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
