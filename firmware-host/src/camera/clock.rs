//! Checks whether the driver's timestamps can be of `CLOCK_MONOTONIC` and whether they increase.

use crate::source::SourceEvent;

/// A driver's timestamp may be this much later than the time of reading. Times converted from a device
/// clock are inaccurate at the start, and vivid's is the end of the coming frame.
const MAX_AHEAD_NS: u64 = 1_000_000_000;
/// A driver's timestamp may be this much earlier: no driver keeps an image longer, and wall-clock time
/// differs from time since boot by more.
const MAX_BEHIND_NS: u64 = 10_000_000_000;

/// Time of a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Timestamp {
    /// The driver's timestamp, or the time of reading in its place. It is later than every earlier one.
    pub time_ns: u64,
    /// Newly detected fault of the driver's timestamp.
    pub fault: Option<String>,
}

impl Timestamp {
    /// Event that reports the fault.
    #[must_use]
    pub fn event(&self, sequence: u64) -> Option<SourceEvent> {
        self.fault.as_ref().map(|reason| SourceEvent::Timestamp { sequence, reason: reason.clone() })
    }
}

/// Checks the timestamps of one stream.
///
/// A frame with an unusable timestamp gets the time of reading. A clock other than `CLOCK_MONOTONIC` is
/// reported once until timestamps are valid again. A timestamp that goes back is reported every time.
#[derive(Clone, Copy, Debug, Default)]
pub struct TimestampCheck {
    last_driver_ns: Option<u64>,
    last_ns: Option<u64>,
    foreign: bool,
}

impl TimestampCheck {
    /// Processes the next frame: the driver's timestamp, if its flags state `CLOCK_MONOTONIC`, and the
    /// time of reading on that clock.
    pub fn step(&mut self, driver_ns: Option<u64>, read_ns: u64) -> Timestamp {
        let wrong = match driver_ns {
            None => Some("the driver's timestamps are not of CLOCK_MONOTONIC".to_owned()),
            Some(ns)
                if ns > read_ns.saturating_add(MAX_AHEAD_NS)
                    || ns.saturating_add(MAX_BEHIND_NS) < read_ns =>
            {
                Some(format!(
                    "the driver's timestamp {ns} ns is {} s off CLOCK_MONOTONIC",
                    ns.abs_diff(read_ns) / 1_000_000_000
                ))
            }
            Some(_) => None,
        };
        let foreign = wrong.is_some();
        let known = std::mem::replace(&mut self.foreign, foreign);
        let news = wrong.filter(|_| !known);
        let back = match (driver_ns, self.last_driver_ns) {
            (Some(now), Some(last)) if !foreign && now <= last => {
                Some(format!("the driver's timestamp {now} ns does not go forward from {last} ns"))
            }
            _ => None,
        };
        self.last_driver_ns = driver_ns.filter(|_| !foreign);
        let usable = driver_ns.filter(|&ns| !foreign && self.last_ns.is_none_or(|last| ns > last));
        let earliest = self.last_ns.map_or(0, |last| last + 1);
        let time_ns = usable.unwrap_or(read_ns.max(earliest));
        self.last_ns = Some(time_ns);
        Timestamp { time_ns, fault: news.or(back) }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    const PERIOD_NS: u64 = 33_000_000;
    const START_NS: u64 = 100_000_000_000;

    #[test]
    fn another_clock_is_told_once_and_replaced() {
        let mut check = TimestampCheck::default();
        let realtime_ns = 1_800_000_000_000_000_000;
        for frame in 0..5 {
            let read_ns = START_NS + frame * PERIOD_NS;
            let stamp = check.step(Some(realtime_ns + frame * PERIOD_NS), read_ns);
            assert_eq!((stamp.time_ns, stamp.fault.is_some()), (read_ns, frame == 0));
        }
        let good = check.step(Some(START_NS + 6 * PERIOD_NS - 1000), START_NS + 6 * PERIOD_NS);
        assert_eq!(good, Timestamp { time_ns: START_NS + 6 * PERIOD_NS - 1000, fault: None });
        assert!(check.step(None, START_NS + 7 * PERIOD_NS).fault.unwrap().contains("CLOCK_MONOTONIC"));
    }

    proptest! {
        /// Time increases for any driver timestamps, and valid ones are used unchanged.
        #[test]
        fn time_goes_forward(
            stamps in prop::collection::vec((any::<bool>(), any::<u64>(), 0u64..5_000_000), 1..60)
        ) {
            let mut check = TimestampCheck::default();
            let mut last = None;
            for (frame, (good, wild, delay_ns)) in stamps.into_iter().enumerate() {
                let taken_ns = START_NS + frame as u64 * PERIOD_NS;
                let read_ns = taken_ns + delay_ns;
                let stamp = check.step(Some(if good { taken_ns } else { wild }), read_ns);
                prop_assert!(last.is_none_or(|last| stamp.time_ns > last));
                if good && last.is_none_or(|last| last < taken_ns) {
                    prop_assert_eq!(stamp.time_ns, taken_ns);
                }
                last = Some(stamp.time_ns);
            }
        }

        /// A timestamp is taken from 10 s before the time of reading to 1 s after it.
        #[test]
        fn stamps_of_another_clock_are_not_taken(off_ns in -40_000_000_000i64..20_000_000_000) {
            let stamp_ns = START_NS.wrapping_add_signed(off_ns);
            let stamp = TimestampCheck::default().step(Some(stamp_ns), START_NS);
            let is_own = (-10_000_000_000..=1_000_000_000).contains(&off_ns);
            prop_assert_eq!(stamp.time_ns, if is_own { stamp_ns } else { START_NS });
            prop_assert_eq!(stamp.fault.is_some(), !is_own);
        }

        #[test]
        fn steps_back_are_told_every_time(back_ns in 1u64..50_000_000) {
            let mut check = TimestampCheck::default();
            check.step(Some(START_NS), START_NS + 1000);
            let read_ns = START_NS + PERIOD_NS;
            let stamp = check.step(Some(START_NS - back_ns), read_ns);
            prop_assert!(stamp.fault.is_some() && stamp.time_ns == read_ns);
            let again = check.step(Some(START_NS - 2 * back_ns), read_ns + PERIOD_NS);
            prop_assert!(again.fault.is_some());
        }
    }
}
