//! Ring buffer of the latest messages, held until a trigger.

use super::part::Message;
use std::collections::VecDeque;

/// Keeps the newest messages, up to a duration and a size.
#[derive(Clone, Debug)]
pub(super) struct Ring {
    messages: VecDeque<Message>,
    bytes: usize,
    max_ns: u64,
    max_bytes: usize,
}

impl Ring {
    pub fn new(max_ns: u64, max_bytes: usize) -> Self {
        Self { messages: VecDeque::new(), bytes: 0, max_ns, max_bytes }
    }

    /// Adds a message and drops the oldest ones.
    pub fn push(&mut self, message: Message) {
        let oldest_ns = message.log_ns.saturating_sub(self.max_ns);
        self.bytes += message.data.len();
        self.messages.push_back(message);
        while self.bytes > self.max_bytes || self.messages.front().is_some_and(|m| m.log_ns < oldest_ns) {
            let Some(oldest) = self.messages.pop_front() else { break };
            self.bytes -= oldest.data.len();
        }
    }

    /// Empties the ring; returns its messages from the first whole frame on.
    pub fn take(&mut self) -> VecDeque<Message> {
        let mut messages = std::mem::take(&mut self.messages);
        self.bytes = 0;
        let whole = messages.iter().position(|message| message.begins_pair).unwrap_or(0);
        messages.drain(..whole);
        messages
    }
}

#[cfg(test)]
mod tests {
    use super::super::Topic;
    use super::*;

    fn message(log_ns: u64, bytes: usize, begins_pair: bool) -> Message {
        let topic = if begins_pair { Topic::Capture } else { Topic::Frame };
        Message { topic, log_ns, publish_ns: log_ns, data: vec![0; bytes], begins_pair }
    }

    #[test]
    fn the_oldest_go_by_time_and_by_size_and_a_frame_is_whole() {
        let mut ring = Ring::new(10, 100);
        for time in 0..30 {
            ring.push(message(time, 1, true));
            ring.push(message(time, 1, false));
        }
        let kept = ring.take();
        assert_eq!(kept.len(), 22, "19 to 29 inclusive");
        assert!(kept[0].log_ns == 19 && kept[0].begins_pair);
        assert!(ring.take().is_empty());
        for time in 0..9 {
            ring.push(message(time, 30, true));
            ring.push(message(time, 15, false));
        }
        // 100 bytes hold two frames and the end of a third.
        assert_eq!(ring.take().len(), 4);
    }
}
