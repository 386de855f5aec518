//! Ctrl-C during long work of the core.

use gelstereo_core::stop::Stop;
use pyo3::prelude::*;
use std::cell::{Cell, RefCell};
use std::time::{Duration, Instant};

/// Python is asked for signals no more often than this, as it takes the interpreter's lock. A sixth of the 0.3 s that a
/// person notices.
const EVERY: Duration = Duration::from_millis(50);

/// Runs work without the interpreter's lock. A signal whose handler raises an exception stops the work, and the
/// exception is returned. Python handles signals in the main thread alone; other threads' work is not stopped.
pub fn stoppable<T: Send>(py: Python<'_>, work: impl FnOnce(Stop<'_>) -> T + Send) -> PyResult<T> {
    let (done, raised) = py.detach(|| {
        let (raised, asked) = (RefCell::new(None), Cell::new(Instant::now()));
        let stop = || {
            if raised.borrow().is_none() && asked.get().elapsed() >= EVERY {
                raised.replace(Python::attach(|py| py.check_signals()).err());
                asked.set(Instant::now());
            }
            raised.borrow().is_some()
        };
        let done = work(&stop);
        (done, raised.take())
    });
    raised.map_or(Ok(done), Err)
}

/// As [`stoppable`], something of every item: microseconds each.
pub fn stoppable_each<I: Sync, T: Send>(
    py: Python<'_>,
    items: &[I],
    mut one: impl FnMut(&I) -> T + Send,
) -> PyResult<Vec<T>> {
    let work = |stop: Stop<'_>| {
        let mut out = Vec::with_capacity(items.len());
        for (step, item) in items.iter().enumerate() {
            if step.is_multiple_of(ITEMS) && stop() {
                break;
            }
            out.push(one(item));
        }
        out
    };
    stoppable(py, work)
}

/// Items between two questions whether to stop.
const ITEMS: usize = 64;
