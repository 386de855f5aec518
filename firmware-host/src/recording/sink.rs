//! Where the messages of a frame go.

use super::Topic;

/// An output for messages: a recording, or a network publisher.
///
/// An output that fails must not stop the robot. It takes no more messages then, and says why when it is asked.
pub trait MessageSink {
    /// Takes one CDR message about the moment `time_ns`, in nanoseconds on the frame source's clock.
    ///
    /// Returns soon: what waits for a disk or a network waits elsewhere.
    fn write(&mut self, topic: Topic, time_ns: u64, message: &[u8]);

    /// Why this output takes no more messages, in words; `None` while it works.
    fn fault(&self) -> Option<String>;
}
