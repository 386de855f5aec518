//! Ctrl-C during long computations in the core.

use gelstereo_core::stop::Stop;
use pyo3::prelude::*;
use std::cell::{Cell, RefCell};
use std::time::{Duration, Instant};

/// Shortest interval between checks for signals, because each takes the interpreter's lock. One sixth of
/// the 0.3 s that a person notices.
const EVERY: Duration = Duration::from_millis(50);

/// Runs work with the interpreter's lock released. If a signal handler raises an exception, the work
/// stops and the exception is returned. Python handles signals only in the main thread; work of other
/// threads is not stopped.
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

/// As [`stoppable`], for a function of every item that takes microseconds.
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

/// Items between two checks for a stop.
const ITEMS: usize = 64;
