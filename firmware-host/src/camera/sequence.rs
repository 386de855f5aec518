//! Checks the driver's frame numbers for lost frames and impossible numbers.

/// Number of periods by which frames may arrive early before their numbers are doubted. After a delay,
/// drivers deliver several frames at once with closely spaced timestamps.
const ALLOWANCE: u64 = 16;

/// Result for one frame number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// The number extended to 64 bits: it continues where the driver's 32 bits wrap around.
    pub sequence: u64,
    /// Number of lost frames, or the expected number if this one is impossible.
    pub outcome: Result<u64, u64>,
}

impl Step {
    /// Frames lost since the previous one; unknown and 0 if the number is impossible.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.outcome.unwrap_or(0)
    }

    /// The expected number, if this one goes back or jumps too far.
    #[must_use]
    pub fn expected(&self) -> Option<u64> {
        self.outcome.err()
    }
}

/// Checks the numbers of one stream. A restarted stream needs a new check.
#[derive(Clone, Copy, Debug)]
pub struct SequenceCheck {
    period_ns: f64,
    last: Option<Last>,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    sequence: u64,
    time_ns: u64,
}

impl SequenceCheck {
    /// Check for a camera with this frame rate.
    #[must_use]
    pub fn new(frame_rate_hz: f64) -> Self {
        Self { period_ns: 1e9 / frame_rate_hz, last: None }
    }

    /// Processes the next frame's number and its time, which must not decrease.
    ///
    /// A gap counts as loss if that many frames are possible since the previous frame, at twice the
    /// nominal rate plus an allowance of 16 frames. Any other number is an error, and the stream
    /// continues from it.
    pub fn step(&mut self, number: u32, time_ns: u64) -> Step {
        let Some(last) = self.last else {
            let sequence = u64::from(number);
            self.last = Some(Last { sequence, time_ns });
            return Step { sequence, outcome: Ok(0) };
        };
        let expected = last.sequence + 1;
        let ahead = number.wrapping_sub(expected as u32);
        let periods = time_ns.saturating_sub(last.time_ns) as f64 / self.period_ns;
        // A float that is too large saturates at the largest integer.
        let max_lost = ((2.0 * periods) as u64).saturating_add(ALLOWANCE);
        let (sequence, outcome) = if u64::from(ahead) <= max_lost && ahead < 1 << 31 {
            (expected + u64::from(ahead), Ok(u64::from(ahead)))
        } else {
            (u64::from(number), Err(expected))
        };
        self.last = Some(Last { sequence, time_ns });
        Step { sequence, outcome }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PERIOD_NS: u64 = 33_333_333;

    proptest! {
        /// Every loss is counted exactly, also across the wrap of the driver's 32 bits.
        #[test]
        fn gaps_are_counted_over_the_wrap(
            start in any::<u32>(), lost in prop::collection::vec(0u32..200, 1..50)
        ) {
            let mut check = SequenceCheck::new(30.0);
            let (mut number, mut time_ns) = (start, 0);
            prop_assert_eq!(check.step(number, 0), Step { sequence: start.into(), outcome: Ok(0) });
            let mut expected = u64::from(start);
            for lost in lost {
                number = number.wrapping_add(lost + 1);
                time_ns += u64::from(lost + 1) * PERIOD_NS;
                expected += u64::from(lost + 1);
                let step = Step { sequence: expected, outcome: Ok(lost.into()) };
                prop_assert_eq!(check.step(number, time_ns), step);
            }
        }

        /// A number that goes back, repeats, or jumps farther than the elapsed time allows is an error;
        /// counting continues from it.
        #[test]
        fn impossible_numbers_are_errors(
            start in 1000u32..1 << 30, jump in prop_oneof![-999i64..=0, 20i64..1 << 29]
        ) {
            let mut check = SequenceCheck::new(30.0);
            check.step(start, 0);
            let wrong = (i64::from(start) + jump) as u32;
            let step = check.step(wrong, PERIOD_NS);
            prop_assert_eq!(step, Step { sequence: wrong.into(), outcome: Err(u64::from(start) + 1) });
            prop_assert_eq!(step.lost(), 0);
            let next = check.step(wrong + 1, 2 * PERIOD_NS);
            prop_assert_eq!(next, Step { sequence: u64::from(wrong) + 1, outcome: Ok(0) });
        }
    }
}
