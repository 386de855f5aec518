//! Queue from device threads to the reader: bounded, in order, with every loss counted.

use super::FrameShape;
use crate::source::SourceEvent;
use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Largest number of waiting events. It bounds memory if a camera fails for hours without a reader.
const MAX_EVENTS: usize = 256;
/// Largest number of spare buffers.
const MAX_SPARES: usize = 64;

/// Device of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Side {
    /// The stereo device, or the device of the left view.
    Left,
    /// The device of the right view.
    Right,
}

/// A frame from the driver.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct RawFrame {
    /// Shape of the data.
    pub shape: FrameShape,
    /// Frame number of the driver, extended to 64 bits.
    pub sequence: u64,
    /// Time on `CLOCK_MONOTONIC`.
    pub time_ns: u64,
    /// Frames lost since the previous one.
    pub dropped: u64,
    /// Frame data.
    pub bytes: Vec<u8>,
}

/// Message of a device thread.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Message {
    /// A frame.
    Frame(RawFrame),
    /// An event.
    Event(SourceEvent),
    /// The thread ended.
    Ended,
}

#[derive(Debug, Default)]
struct Content {
    messages: VecDeque<(Side, Message)>,
    spares: Vec<Vec<u8>>,
    lost_events: u64,
}

/// Queue between the device threads and one reader.
#[derive(Debug)]
pub(crate) struct Mailbox {
    content: Mutex<Content>,
    arrival: Condvar,
    max_frames: usize,
}

impl Mailbox {
    /// Queue for up to `max_frames` frames of each device.
    pub fn new(max_frames: usize) -> Self {
        Self { content: Mutex::default(), arrival: Condvar::new(), max_frames }
    }

    fn lock(&self) -> MutexGuard<'_, Content> {
        // A panic while the lock was held leaves only complete messages.
        self.content.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a message. If the queue is full, the oldest of its kind is dropped. A dropped frame is
    /// counted in the next one, a dropped event in [`Self::lost_events`].
    pub fn put(&self, side: Side, message: Message) {
        let mut content = self.lock();
        let is_frame = matches!(message, Message::Frame(_));
        content.messages.push_back((side, message));
        let same = |(of, other): &(Side, Message)| match other {
            Message::Frame(_) => is_frame && *of == side,
            Message::Event(_) => !is_frame,
            Message::Ended => false,
        };
        let room = if is_frame { self.max_frames } else { MAX_EVENTS };
        if content.messages.iter().filter(|message| same(message)).count() > room
            && let Some(oldest) = content.messages.iter().position(same)
        {
            match content.messages.remove(oldest) {
                Some((_, Message::Frame(lost))) => {
                    let next = content.messages.iter_mut().find_map(|(of, message)| match message {
                        Message::Frame(frame) if *of == side => Some(frame),
                        _ => None,
                    });
                    if let Some(next) = next {
                        next.dropped += lost.dropped + 1;
                    }
                    Self::keep(&mut content, lost.bytes);
                }
                _ => content.lost_events += 1,
            }
        }
        drop(content);
        self.arrival.notify_all();
    }

    /// Takes the oldest message.
    pub fn take(&self) -> Option<(Side, Message)> {
        self.lock().messages.pop_front()
    }

    /// Waits for a message; `false` if none came by the deadline.
    pub fn wait_until(&self, deadline: Option<Instant>) -> bool {
        let mut content = self.lock();
        while content.messages.is_empty() {
            content = match deadline {
                Some(deadline) => {
                    let left = deadline.saturating_duration_since(Instant::now());
                    if left.is_zero() {
                        return false;
                    }
                    self.arrival
                        .wait_timeout(content, left)
                        .map_or_else(|e| e.into_inner().0, |(guard, _)| guard)
                }
                None => self.arrival.wait(content).unwrap_or_else(PoisonError::into_inner),
            };
        }
        true
    }

    /// Buffer for the next frame, reused if available.
    pub fn spare(&self) -> Vec<u8> {
        self.lock().spares.pop().unwrap_or_default()
    }

    /// Returns a buffer for reuse.
    pub fn give_back(&self, bytes: Vec<u8>) {
        Self::keep(&mut self.lock(), bytes);
    }

    fn keep(content: &mut Content, mut bytes: Vec<u8>) {
        if content.spares.len() < MAX_SPARES && bytes.capacity() > 0 {
            bytes.clear();
            content.spares.push(bytes);
        }
    }

    /// Number of dropped events.
    pub fn lost_events(&self) -> u64 {
        self.lock().lost_events
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::PixelFormat;
    use proptest::prelude::*;
    use std::time::Duration;

    fn frame(sequence: u64) -> Message {
        let shape = FrameShape { format: PixelFormat::Grey, width: 2, height: 2, stride: 2 };
        Message::Frame(RawFrame { shape, sequence, time_ns: sequence, dropped: 0, bytes: vec![0; 4] })
    }

    proptest! {
        /// Frames stay in order, at most `max_frames` wait, and each is either delivered or counted as
        /// dropped.
        #[test]
        fn every_frame_is_handed_over_or_counted(
            max_frames in 1usize..6, steps in prop::collection::vec((any::<bool>(), any::<bool>()), 1..200)
        ) {
            let mailbox = Mailbox::new(max_frames);
            let (mut put, mut next, mut counted) = ([0u64; 2], [0u64; 2], [0u64; 2]);
            for (is_put, is_left) in steps.into_iter().chain([(false, true); 12]) {
                let side = if is_left { Side::Left } else { Side::Right };
                if is_put {
                    let n = &mut put[side as usize];
                    mailbox.put(side, frame(*n));
                    *n += 1;
                } else if let Some((side, Message::Frame(frame))) = mailbox.take() {
                    let n = side as usize;
                    prop_assert_eq!(frame.sequence, next[n] + frame.dropped);
                    next[n] = frame.sequence + 1;
                    counted[n] += 1 + frame.dropped;
                }
            }
            prop_assert!(mailbox.take().is_none(), "at most 2 x 5 frames wait");
            prop_assert_eq!(put, counted);
        }
    }

    #[test]
    fn events_are_kept_in_order_and_bounded() {
        let mailbox = Mailbox::new(2);
        for n in 0..300 {
            let event = SourceEvent::Corrupt { sequence: n, reason: String::new() };
            mailbox.put(Side::Left, Message::Event(event));
        }
        assert_eq!(mailbox.lost_events(), 300 - MAX_EVENTS as u64);
        let first = mailbox.take();
        assert!(matches!(
            first,
            Some((Side::Left, Message::Event(SourceEvent::Corrupt { sequence: 44, .. })))
        ));
    }

    #[test]
    fn waiting_ends_in_time_and_with_a_message() {
        let mailbox = Mailbox::new(2);
        assert!(!mailbox.wait_until(Some(Instant::now() + Duration::from_millis(5))));
        std::thread::scope(|scope| {
            scope.spawn(|| mailbox.put(Side::Right, frame(7)));
            assert!(mailbox.wait_until(None));
        });
    }
}
