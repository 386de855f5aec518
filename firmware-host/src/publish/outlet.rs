//! A bounded queue with a sending thread, so that slow listeners never block the producer.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Largest number of waiting items: seconds of results at 30 Hz.
const MAX_ITEMS: usize = 256;
/// Largest number of waiting bytes: two seconds of images at 640 x 480 and 30 Hz.
const MAX_BYTES: usize = 1 << 25;
/// Period at which a waiting producer checks its stop flag.
const STOP_CHECK: Duration = Duration::from_millis(50);

/// Behaviour of a full queue.
#[derive(Clone, Copy, Debug)]
pub enum Overflow<'a> {
    /// The oldest item is dropped and counted.
    DropOldest,
    /// The producer waits until the flag is raised; afterwards the oldest item is dropped.
    WaitUnless(&'a AtomicBool),
}

#[derive(Debug)]
struct Content<T> {
    items: VecDeque<(T, usize)>,
    bytes: usize,
    dropped: u64,
    closed: bool,
    ended: bool,
    fault: Option<String>,
}

#[derive(Debug)]
struct Shared<T> {
    content: Mutex<Content<T>>,
    changed: Condvar,
}

impl<T> Shared<T> {
    fn lock(&self) -> MutexGuard<'_, Content<T>> {
        self.content.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next item; `None` after the last one.
    fn pop(&self) -> Option<T> {
        let waits = |content: &mut Content<T>| content.items.is_empty() && !content.closed;
        let mut content = self.changed.wait_while(self.lock(), waits).unwrap_or_else(PoisonError::into_inner);
        let (item, bytes) = content.items.pop_front()?;
        content.bytes -= bytes;
        drop(content);
        self.changed.notify_all();
        Some(item)
    }
}

/// Passes items to a thread. After the thread's first failure items are discarded, and [`Self::fault`]
/// returns the reason.
#[derive(Debug)]
pub struct Outlet<T> {
    shared: Arc<Shared<T>>,
}

impl<T: Send + 'static> Outlet<T> {
    /// Starts a thread that passes every item to `send`.
    ///
    /// # Errors
    /// Error of the system if it cannot create a thread.
    pub fn spawn(
        name: &str,
        mut send: impl FnMut(T) -> Result<(), String> + Send + 'static,
    ) -> std::io::Result<Self> {
        let content = Content {
            items: VecDeque::new(),
            bytes: 0,
            dropped: 0,
            closed: false,
            ended: false,
            fault: None,
        };
        let shared = Arc::new(Shared { content: Mutex::new(content), changed: Condvar::new() });
        let behind = Arc::clone(&shared);
        std::thread::Builder::new().name(name.to_owned()).spawn(move || {
            while let Some(item) = behind.pop() {
                if let Err(fault) = send(item) {
                    behind.lock().fault = Some(fault);
                    break;
                }
            }
            drop(send);
            let mut content = behind.lock();
            content.items.clear();
            content.bytes = 0;
            content.ended = true;
            drop(content);
            behind.changed.notify_all();
        })?;
        Ok(Self { shared })
    }

    /// Adds an item of `bytes` bytes.
    pub fn push(&self, item: T, bytes: usize, overflow: Overflow<'_>) {
        let mut content = self.shared.lock();
        if let Overflow::WaitUnless(stop) = overflow {
            while !content.ended && content.is_full(bytes) && !stop.load(Ordering::Relaxed) {
                let waited = self.shared.changed.wait_timeout(content, STOP_CHECK);
                content = waited.unwrap_or_else(PoisonError::into_inner).0;
            }
        }
        if content.ended {
            return;
        }
        while content.is_full(bytes) {
            let Some((_, freed)) = content.items.pop_front() else { break };
            content.bytes -= freed;
            content.dropped += 1;
        }
        content.items.push_back((item, bytes));
        content.bytes += bytes;
        drop(content);
        self.shared.changed.notify_all();
    }

    /// Number of items dropped for newer ones.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.shared.lock().dropped
    }

    /// Reason why items are discarded; `None` while they are sent.
    #[must_use]
    pub fn fault(&self) -> Option<String> {
        self.shared.lock().fault.clone()
    }

    /// Lets the thread send waiting items for at most `timeout`. Returns the number of unsent items.
    pub fn finish(self, timeout: Duration) -> usize {
        let deadline = Instant::now() + timeout;
        let mut content = self.shared.lock();
        content.closed = true;
        self.shared.changed.notify_all();
        while !content.ended {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                break;
            }
            let waited = self.shared.changed.wait_timeout(content, left);
            content = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        content.items.len()
    }
}

impl<T> Drop for Outlet<T> {
    fn drop(&mut self) {
        self.shared.lock().closed = true;
        self.shared.changed.notify_all();
    }
}

impl<T> Content<T> {
    /// Whether an item of `bytes` bytes does not fit. An empty queue accepts any.
    fn is_full(&self, bytes: usize) -> bool {
        !self.items.is_empty() && (self.items.len() >= MAX_ITEMS || self.bytes + bytes > MAX_BYTES)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::sync::mpsc;

    const LIMIT: Duration = Duration::from_secs(20);

    /// A hanging thread does not block the producer; its unsent items are counted.
    #[test]
    fn a_listener_that_hangs_costs_only_its_own_messages() {
        let (release, hang) = mpsc::channel::<()>();
        let (sent, arrived) = mpsc::channel();
        let outlet = Outlet::spawn("test", move |item: usize| {
            sent.send(item).unwrap();
            let _ = hang.recv();
            Ok(())
        })
        .unwrap();
        outlet.push(0, 1, Overflow::DropOldest);
        assert_eq!(arrived.recv_timeout(LIMIT), Ok(0));
        let begun = Instant::now();
        for item in 1..=1000 {
            outlet.push(item, 1, Overflow::DropOldest);
        }
        assert!(begun.elapsed() < LIMIT);
        assert_eq!(outlet.dropped(), 1000 - MAX_ITEMS as u64);
        drop(release);
        assert_eq!(outlet.finish(LIMIT), 0);
        let rest: Vec<usize> = arrived.iter().collect();
        assert_eq!(rest, (1001 - MAX_ITEMS..=1000).collect::<Vec<_>>(), "the newest were kept, in order");
    }

    #[test]
    fn bytes_are_bounded_but_one_item_always_finds_room() {
        let (release, hang) = mpsc::channel::<()>();
        let outlet = Outlet::spawn("test", move |()| {
            let _ = hang.recv();
            Ok(())
        })
        .unwrap();
        for _ in 0..10 {
            outlet.push((), MAX_BYTES, Overflow::DropOldest);
        }
        assert!(outlet.dropped() >= 8, "one is being sent, one waits");
        assert!(outlet.finish(Duration::from_millis(10)) <= 1);
        drop(release);
    }

    #[test]
    fn a_producer_that_may_wait_loses_nothing_and_can_be_stopped() {
        let stop = AtomicBool::new(false);
        let (sent, arrived) = mpsc::channel();
        let outlet =
            Outlet::spawn("test", move |item: usize| sent.send(item).map_err(|error| error.to_string()))
                .unwrap();
        for item in 0..5000 {
            outlet.push(item, 1, Overflow::WaitUnless(&stop));
        }
        assert_eq!((outlet.dropped(), outlet.finish(LIMIT)), (0, 0));
        assert_eq!(arrived.iter().collect::<Vec<_>>(), (0..5000).collect::<Vec<_>>());

        let (release, hang) = mpsc::channel::<()>();
        let outlet = Outlet::spawn("test", move |_: usize| {
            let _ = hang.recv();
            Ok(())
        })
        .unwrap();
        stop.store(true, Ordering::Relaxed);
        for item in 0..1000 {
            outlet.push(item, 1, Overflow::WaitUnless(&stop));
        }
        assert!(outlet.dropped() > 0);
        drop(release);
    }

    #[test]
    fn a_failure_is_kept_and_ends_the_outlet() {
        let outlet = Outlet::spawn("test", |_: u8| Err("no space".to_owned())).unwrap();
        outlet.push(1, 1, Overflow::DropOldest);
        let begun = Instant::now();
        while outlet.fault().is_none() && begun.elapsed() < LIMIT {
            std::thread::yield_now();
        }
        assert_eq!(outlet.fault().as_deref(), Some("no space"));
        outlet.push(2, 1, Overflow::DropOldest);
        assert_eq!(outlet.finish(LIMIT), 0);
    }
}
