//! Outputs for the messages of a frame.

use super::Topic;

/// An output for messages: a recording, or a network publisher.
///
/// An output that fails must not stop the robot. It then takes no more messages and reports the reason
/// through [`Self::fault`].
pub trait MessageSink {
    /// Takes one CDR message that refers to the time `time_ns`, in nanoseconds on the frame source's clock.
    ///
    /// Must return quickly: disk and network waits belong on another thread.
    fn write(&mut self, topic: Topic, time_ns: u64, message: &[u8]);

    /// Why this output takes no more messages, in words; `None` while it works.
    fn fault(&self) -> Option<String>;
}
