//! The driver's frame numbers: which frames were lost, and which numbers cannot be.

/// Frames may come this many periods closer together than the nominal rate says before their numbers are doubted:
/// drivers hand over several frames at once after a delay, with timestamps that bunch up.
const ALLOWANCE: u64 = 16;

/// What a frame's number says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// The number, extended to 64 bits: it goes on counting where the driver's 32 bits start again.
    pub sequence: u64,
    /// What came of the comparison with the frame before.
    pub outcome: Result<u64, u64>,
}

impl Step {
    /// Frames that were lost since the frame before. Unknown, and 0, where the number cannot be.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.outcome.unwrap_or(0)
    }

    /// The number that was expected, where this one goes back or jumps too far.
    #[must_use]
    pub fn expected(&self) -> Option<u64> {
        self.outcome.err()
    }
}

/// Follows the numbers of one stream. A stream that starts again needs a new one.
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
    /// For a camera of this frame rate.
    #[must_use]
    pub fn new(frame_rate_hz: f64) -> Self {
        Self { period_ns: 1e9 / frame_rate_hz, last: None }
    }

    /// Takes the next frame's number and its moment, which never goes back.
    ///
    /// A gap is loss as long as so many frames can have been taken since the frame before, at twice the nominal rate
    /// with an allowance of 16 frames. Any other number is an error: the stream then goes on from that number.
    pub fn step(&mut self, number: u32, time_ns: u64) -> Step {
        let Some(last) = self.last else {
            let sequence = u64::from(number);
            self.last = Some(Last { sequence, time_ns });
            return Step { sequence, outcome: Ok(0) };
        };
        let expected = last.sequence + 1;
        let ahead = number.wrapping_sub(expected as u32);
        let periods = time_ns.saturating_sub(last.time_ns) as f64 / self.period_ns;
        // A float that is too large becomes the largest integer.
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
        /// Whatever is lost, and wherever the driver's 32 bits start again, every loss is counted exactly.
        #[test]
        fn gaps_are_counted_over_the_wrap(start in any::<u32>(), lost in prop::collection::vec(0u32..200, 1..50)) {
            let mut check = SequenceCheck::new(30.0);
            let (mut number, mut time_ns) = (start, 0);
            prop_assert_eq!(check.step(number, 0), Step { sequence: start.into(), outcome: Ok(0) });
            let mut expected = u64::from(start);
            for lost in lost {
                number = number.wrapping_add(lost + 1);
                time_ns += u64::from(lost + 1) * PERIOD_NS;
                expected += u64::from(lost + 1);
                prop_assert_eq!(check.step(number, time_ns), Step { sequence: expected, outcome: Ok(lost.into()) });
            }
        }

        /// A number that goes back, stays, or jumps farther than time allows is an error, and the next one counts on.
        #[test]
        fn impossible_numbers_are_errors(start in 1000u32..1 << 30, jump in prop_oneof![-999i64..=0, 20i64..1 << 29]) {
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
