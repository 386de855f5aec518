//! State shared by a recording and its thread.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Memory for messages waiting for the disk: about 3 s of plain 640 x 480 pairs at 30 Hz, longer than the
/// usual pauses of a disk.
const MAX_QUEUE_BYTES: usize = 64 << 20;

#[derive(Debug, Default)]
struct State {
    queued_bytes: usize,
    fault: Option<String>,
}

/// Fill level of the queue, and the reason why writing ended.
#[derive(Debug, Default)]
pub(super) struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reserves bytes in the queue; `false` when they do not fit. With `wait` it blocks until there is room.
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

    /// Releases bytes that left the queue.
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
