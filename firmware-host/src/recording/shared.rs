//! What a recording and its thread know of each other.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Memory for messages that the disk has not taken yet: about 3 s of plain pairs of 640 x 480 at 30 Hz, more
/// than a disk usually pauses.
const MAX_QUEUE_BYTES: usize = 64 << 20;

#[derive(Debug, Default)]
struct State {
    queued_bytes: usize,
    fault: Option<String>,
}

/// The queue's filling, and why there is no more writing.
#[derive(Debug, Default)]
pub(super) struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts bytes into the queue; `false` when they do not fit. With `wait` there is room sooner or later.
    pub fn queue(&self, bytes: usize, wait: bool) -> bool {
        let mut state = self.lock();
        while state.queued_bytes > 0 && state.queued_bytes + bytes > MAX_QUEUE_BYTES {
            if !wait || state.fault.is_some() {
                return false;
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        state.queued_bytes += bytes;
        true
    }

    pub fn queued_bytes(&self) -> usize {
        self.lock().queued_bytes
    }

    /// These bytes left the queue.
    pub fn written(&self, bytes: usize) {
        self.lock().queued_bytes -= bytes;
        self.changed.notify_all();
    }

    pub fn fail(&self, reason: &str) {
        self.lock().fault.get_or_insert_with(|| reason.to_owned());
        self.changed.notify_all();
    }

    pub fn fault(&self) -> Option<String> {
        self.lock().fault.clone()
    }
}
