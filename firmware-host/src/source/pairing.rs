//! Pairs the images of two devices by timestamps alone, without clocks, threads or devices.

use crate::camera::Side;
use std::collections::VecDeque;

/// An image, or a stand-in for one, with its time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stamped<T> {
    /// Time on a clock shared by both devices, nanoseconds.
    pub time_ns: u64,
    /// Images of the same device lost since the previous one.
    pub dropped: u64,
    /// The image.
    pub image: T,
}

/// Result of comparing the oldest image of each device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Match<T> {
    /// The images form a pair.
    Pair {
        /// The left image.
        left: Stamped<T>,
        /// The right image.
        right: Stamped<T>,
        /// Time of the right image minus that of the left one.
        skew_ns: i64,
        /// Pairs lost since the previous pair: lost, refused or displaced images of the device that has
        /// more of them.
        dropped: u64,
    },
    /// The images are too far apart: the older one has no partner and is refused.
    Refused {
        /// Device of the refused image.
        side: Side,
        /// Refused image.
        image: Stamped<T>,
        /// Time of the right image minus that of the left one.
        skew_ns: i64,
    },
}

/// Pairs the images of two devices.
///
/// Images of each device arrive in order. The oldest of each are compared: at most `max_skew_ns` apart
/// they are a pair. Otherwise the older one is refused, since later images of the other device are even
/// later. With a skew of at most half a frame period an image has one possible partner.
#[derive(Clone, Debug)]
pub struct Pairing<T> {
    max_skew_ns: u64,
    max_waiting: usize,
    left: Lane<T>,
    right: Lane<T>,
}

#[derive(Clone, Debug)]
struct Lane<T> {
    waiting: VecDeque<Stamped<T>>,
    /// Images lost since the last pair and before the oldest waiting one.
    lost: u64,
}

impl<T> Default for Lane<T> {
    fn default() -> Self {
        Self { waiting: VecDeque::new(), lost: 0 }
    }
}

impl<T> Lane<T> {
    fn lose(&mut self) -> Option<Stamped<T>> {
        let image = self.waiting.pop_front()?;
        self.lost += image.dropped + 1;
        Some(image)
    }
}

impl<T> Pairing<T> {
    /// Pairs images at most `max_skew_ns` apart; `max_waiting` images of each device may wait for a
    /// partner.
    #[must_use]
    pub fn new(max_skew_ns: u64, max_waiting: usize) -> Self {
        Self { max_skew_ns, max_waiting: max_waiting.max(1), left: Lane::default(), right: Lane::default() }
    }

    fn lane(&mut self, side: Side) -> &mut Lane<T> {
        match side {
            Side::Left => &mut self.left,
            Side::Right => &mut self.right,
        }
    }

    /// Adds an image. If too many wait because the other device is silent, the oldest is counted as lost
    /// and returned.
    pub fn push(&mut self, side: Side, image: Stamped<T>) -> Option<Stamped<T>> {
        let max_waiting = self.max_waiting;
        let lane = self.lane(side);
        lane.waiting.push_back(image);
        if lane.waiting.len() > max_waiting { lane.lose() } else { None }
    }

    /// Compares the oldest image of each device; `None` if either has none.
    pub fn compare(&mut self) -> Option<Match<T>> {
        let (left, right) = (self.left.waiting.front()?, self.right.waiting.front()?);
        let skew_ns = right.time_ns.wrapping_sub(left.time_ns) as i64;
        if left.time_ns.abs_diff(right.time_ns) > self.max_skew_ns {
            let side = if left.time_ns < right.time_ns { Side::Left } else { Side::Right };
            let image = self.lane(side).lose()?;
            return Some(Match::Refused { side, image, skew_ns });
        }
        let (left, right) = (self.left.waiting.pop_front()?, self.right.waiting.pop_front()?);
        let lost = |lane: &mut Lane<T>, image: &Stamped<T>| std::mem::take(&mut lane.lost) + image.dropped;
        let dropped = lost(&mut self.left, &left).max(lost(&mut self.right, &right));
        Some(Match::Pair { left, right, skew_ns, dropped })
    }

    /// Counts all waiting images as lost and returns them, for a device that restarts.
    pub fn clear(&mut self) -> Vec<Stamped<T>> {
        let mut lost = Vec::new();
        for side in [Side::Left, Side::Right] {
            while let Some(image) = self.lane(side).lose() {
                lost.push(image);
            }
        }
        lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PERIOD_NS: i64 = 33_000_000;
    const MAX_SKEW_NS: u64 = 5_000_000;

    /// Output of one device: the jitter of each period, or `None` for a lost frame.
    fn device() -> impl Strategy<Value = Vec<Option<i64>>> {
        prop::collection::vec(prop::option::weighted(0.8, -2_000_000..2_000_000i64), 1..60)
    }

    /// Images with the number of their period, and drops as the driver would count them.
    fn images(frames: &[Option<i64>], phase_ns: i64) -> Vec<Stamped<usize>> {
        let mut dropped = 0;
        let mut images = Vec::new();
        for (number, jitter_ns) in frames.iter().enumerate() {
            match jitter_ns {
                Some(jitter_ns) => {
                    let time_ns = (10 * PERIOD_NS + number as i64 * PERIOD_NS + phase_ns + jitter_ns) as u64;
                    images.push(Stamped { time_ns, dropped: std::mem::take(&mut dropped), image: number });
                }
                None => dropped += 1,
            }
        }
        images
    }

    /// Feeds both devices' images in an arbitrary interleaving and compares as often as possible.
    fn run(
        left: &[Stamped<usize>],
        right: &[Stamped<usize>],
        turns: &[bool],
        max_waiting: usize,
    ) -> (Vec<Match<usize>>, u64) {
        let mut pairing = Pairing::new(MAX_SKEW_NS, max_waiting);
        let (mut left, mut right) = (left.iter(), right.iter());
        let (mut matches, mut pushed_out) = (Vec::new(), 0);
        for turn in turns.iter().copied().cycle() {
            let (side, next) = match (turn, left.len(), right.len()) {
                (_, 0, 0) => break,
                (true, 1.., _) | (_, 1.., 0) => (Side::Left, left.next()),
                _ => (Side::Right, right.next()),
            };
            if let Some(image) = next {
                pushed_out += u64::from(pairing.push(side, image.clone()).is_some());
            }
            while let Some(found) = pairing.compare() {
                matches.push(found);
            }
        }
        let waiting = pairing.clear().len() as u64;
        (matches, pushed_out + waiting)
    }

    proptest! {
        #[test]
        fn pairs_are_near_in_order_and_counted(
            left in device(), right in device(), phase_ns in -40_000_000..40_000_000i64,
            turns in prop::collection::vec(any::<bool>(), 1..40), max_waiting in 1usize..9
        ) {
            let (left, right) = (images(&left, 0), images(&right, phase_ns));
            let (matches, others) = run(&left, &right, &turns, max_waiting);
            let (mut last, mut pairs, mut refused) = ([None, None], 0, 0);
            for found in &matches {
                match found {
                    Match::Pair { left, right, skew_ns, dropped } => {
                        prop_assert_eq!(*skew_ns, right.time_ns as i64 - left.time_ns as i64);
                        prop_assert!(skew_ns.unsigned_abs() <= MAX_SKEW_NS);
                        // An image carries the number of its period: numbers between two pairs are lost.
                        let between = [(0, left.image), (1, right.image)].map(|(side, number)| {
                            let before = last[side].replace(number);
                            let lost = number as u64 - before.map_or(0, |before| before as u64 + 1);
                            (before.is_none_or(|before| before < number), lost)
                        });
                        prop_assert!(between[0].0 && between[1].0, "order is kept");
                        prop_assert_eq!(*dropped, between[0].1.max(between[1].1));
                        pairs += 1;
                    }
                    Match::Refused { skew_ns, .. } => {
                        prop_assert!(skew_ns.unsigned_abs() > MAX_SKEW_NS);
                        refused += 1;
                    }
                }
            }
            prop_assert_eq!((left.len() + right.len()) as u64, 2 * pairs + refused + others);
        }

        /// Two devices in phase without loss are paired completely, whichever delivers first.
        #[test]
        fn devices_in_step_are_paired_completely(
            jitters in prop::collection::vec((-2_000_000..2_000_000i64, -2_000_000..2_000_000i64), 1..60)
        ) {
            let (left, right): (Vec<_>, Vec<_>) = jitters.into_iter().unzip();
            let sent = |jitters: Vec<i64>| jitters.into_iter().map(Some).collect::<Vec<_>>();
            let (left, right) = (sent(left), sent(right));
            let (left, right) = (images(&left, 0), images(&right, 0));
            let (matches, others) = run(&left, &right, &[true, false], 2);
            prop_assert_eq!(matches.len(), left.len());
            let lossless = matches.iter().all(|found| matches!(found, Match::Pair { dropped: 0, .. }));
            prop_assert!(others == 0 && lossless);
        }
    }

    #[test]
    fn a_silent_device_holds_nothing_up() {
        let mut pairing = Pairing::new(MAX_SKEW_NS, 4);
        let image = |n: u64| Stamped { time_ns: n * PERIOD_NS as u64, dropped: 0, image: n };
        let pushed_out: Vec<_> = (0..100).filter_map(|n| pairing.push(Side::Left, image(n))).collect();
        assert_eq!(pushed_out.len(), 96);
        assert_eq!(pairing.compare(), None);
        pairing.push(Side::Right, image(99));
        let refused =
            (0..3).filter(|_| matches!(pairing.compare(), Some(Match::Refused { side: Side::Left, .. })));
        assert_eq!(refused.count(), 3);
        assert!(matches!(pairing.compare(), Some(Match::Pair { dropped: 99, skew_ns: 0, .. })));
    }
}
