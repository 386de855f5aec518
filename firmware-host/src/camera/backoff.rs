//! Pauses before reconnecting to a lost camera.

use std::time::Duration;

/// Pauses that double from the shortest to the longest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Backoff {
    min: Duration,
    max: Duration,
    next: Duration,
}

impl Backoff {
    /// Pauses from `min` to `max`; a `max` below `min` counts as `min`.
    #[must_use]
    pub fn new(min: Duration, max: Duration) -> Self {
        Self { min, max: max.max(min), next: min }
    }

    /// The next pause.
    pub fn pause(&mut self) -> Duration {
        let pause = self.next;
        self.next = pause.saturating_mul(2).min(self.max);
        pause
    }

    /// Restarts from the shortest pause once the camera works.
    pub fn reset(&mut self) {
        self.next = self.min;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn pauses_double_up_to_the_bound(min_ms in 1u64..1000, max_ms in 1u64..100_000, tries in 1u32..80) {
            let (min, max) = (Duration::from_millis(min_ms), Duration::from_millis(max_ms.max(min_ms)));
            let mut backoff = Backoff::new(min, Duration::from_millis(max_ms));
            for attempt in 0..tries {
                let doubled = min.saturating_mul(2u32.saturating_pow(attempt));
                prop_assert_eq!(backoff.pause(), doubled.min(max));
            }
            backoff.reset();
            prop_assert_eq!(backoff.pause(), min);
        }
    }
}
