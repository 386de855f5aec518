//! Time that a unit of work takes on the computer in use.

/// Share of frames that may take longer than predicted: 1 in 1000.
const LATE: f64 = 1e-3;
/// Relative step of the estimate after a late frame. It is 1000 times as large as the step after a frame in
/// time, so that the estimate rests where [`LATE`] of the frames are late.
const STEP: f64 = 0.05;
/// Relative step of the median. Tried 0.001 to 0.1 on made times: a computer that becomes eight times as
/// slow is believed after 1004 frames with 0.001, 122 with 0.01 and 23 with 0.1. With 0.1, interruptions of
/// every fifth frame count as its speed, and the limit is a quarter too cautious.
const MEDIAN_STEP: f64 = 0.01;
/// A frame that takes this many times the median was interrupted by another process. Interruptions do not
/// get shorter with less work, so they teach nothing: with them, one busy computer gave up all rungs for
/// deadlines of ten times the usual time (two processors, four other processes).
///
/// Tried 1.5 to 12 on made times with a tail up to twice the median. With 2, 0.15 % of the frames are late
/// instead of 0.1 %, and with 1.5, 0.65 %. From 4 on, frames that others make four times as long are
/// believed, and the limit doubles.
const INTERRUPTED: f64 = 3.0;

/// Running upper quantile of the time that a unit of work takes, by stochastic approximation (Robbins and
/// Monro 1951).
///
/// It has no clock: the caller measures. Record the limits that it gives, and a replay with them gives the
/// same bits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pace {
    ns_per_unit: f64,
    median: f64,
}

impl Pace {
    /// Learns from a frame of this work that took this time. Frames without work teach nothing.
    pub fn observe(&mut self, work: u64, taken_ns: u64) {
        if work == 0 {
            return;
        }
        let found = taken_ns as f64 / work as f64;
        if self.median == 0.0 {
            *self = Self { ns_per_unit: found, median: found };
            return;
        }
        let is_interrupted = found > INTERRUPTED * self.median;
        self.median *= if found > self.median { 1.0 + MEDIAN_STEP } else { 1.0 - MEDIAN_STEP };
        self.ns_per_unit *= match found > self.ns_per_unit {
            true if is_interrupted => 1.0,
            true => 1.0 + STEP,
            false => 1.0 - LATE * STEP,
        };
        self.ns_per_unit = self.ns_per_unit.clamp(self.median, INTERRUPTED * self.median);
    }

    /// Work that fits into this time; `None` before the first frame was observed.
    #[must_use]
    pub fn limit(&self, time_ns: u64) -> Option<u64> {
        (self.ns_per_unit > 0.0).then(|| (time_ns as f64 / self.ns_per_unit) as u64)
    }

    /// Nanoseconds for a unit of work; 0 before the first frame was observed.
    #[must_use]
    pub const fn ns_per_unit(&self) -> f64 {
        self.ns_per_unit
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::random::Stream;
    use proptest::prelude::*;

    /// Time of a frame: usually that of its work, up to twice as long in the tail.
    fn taken_ns(work: u64, ns_per_unit: f64, random: &mut Stream) -> u64 {
        let tail = random.uniform();
        let factor = if tail > 0.99 { 1.0 + (tail - 0.99) * 100.0 } else { 1.0 };
        (work as f64 * ns_per_unit * factor) as u64
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(16))]
        /// Of frames with a long tail of times, few are late, whatever the computer's speed, and although
        /// others interrupt one in a hundred for ten times as long.
        #[test]
        fn one_frame_in_a_thousand_is_late(
            seed in 0_u64.., ns_per_unit in 10.0..10_000.0_f64, is_disturbed: bool,
        ) {
            let (mut pace, mut random) = (Pace::default(), Stream::new(seed, "pace"));
            let mut late = 0;
            for frame in 0..60_000 {
                let work = 500 + (random.uniform() * 2000.0) as u64;
                let taken_ns = taken_ns(work, ns_per_unit, &mut random);
                let is_late = pace.ns_per_unit() * (work as f64) < taken_ns as f64;
                late += u32::from(frame >= 20_000 && is_late);
                let is_interrupted = is_disturbed && random.uniform() < 0.01;
                pace.observe(work, if is_interrupted { 10 * taken_ns } else { taken_ns });
            }
            prop_assert!((10..=100).contains(&late), "{late} of 40000 are late");
            prop_assert!(pace.ns_per_unit() < 2.1 * ns_per_unit);
        }

        /// A computer that becomes slower is believed within a second of frames, although each of them looks
        /// interrupted at first; one that becomes faster within some minutes.
        #[test]
        fn a_change_of_speed_is_learned(slower in 1.5..8.0_f64) {
            let mut pace = Pace::default();
            (0..1000).for_each(|_| pace.observe(1000, 100_000));
            (0..300).for_each(|_| pace.observe(1000, (100_000.0 * slower) as u64));
            prop_assert!(pace.ns_per_unit() > 99.0 * slower, "{}", pace.ns_per_unit());
            (0..60_000).for_each(|_| pace.observe(1000, 100_000));
            prop_assert!(pace.ns_per_unit() < 106.0, "{}", pace.ns_per_unit());
        }
    }

    #[test]
    fn nothing_is_known_before_the_first_frame() {
        let mut pace = Pace::default();
        pace.observe(0, 1_000_000);
        assert_eq!(pace.limit(1_000_000), None);
        pace.observe(1_000, 300_000);
        assert_eq!(pace.limit(1_000_000), Some(3_333));
    }
}
