//! Ending long work early.
//!
//! Functions that can take seconds have a form `*_unless`, which asks a closure every few milliseconds whether to go on. The
//! answer is the same, bit for bit, as without one, unless the closure says to stop. Then nothing is made, and the
//! inputs are as they were.

/// Asked every few milliseconds; `true` stops the work.
pub type Stop<'a> = &'a dyn Fn() -> bool;

/// Never stops.
pub const NEVER: Stop<'static> = &|| false;

/// The work was stopped before its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stopped;

impl core::fmt::Display for Stopped {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("the work was stopped before its end")
    }
}

impl core::error::Error for Stopped {}

/// Steps between two questions. A step is a nearest point or less, some microseconds: asking costs under a
/// thousandth of the work, and an answer is waited for by a few milliseconds.
const STEPS: usize = 1024;

/// The same of steps that look at much of a template: at most a millisecond each.
const HEAVY_STEPS: usize = 64;

/// Asks, before the first of every [`STEPS`] steps.
#[inline]
pub(crate) fn ask(stop: Stop<'_>, step: usize) -> Result<(), Stopped> {
    if step.is_multiple_of(STEPS) && stop() { Err(Stopped) } else { Ok(()) }
}

/// Asks, before the first of every [`HEAVY_STEPS`] steps.
#[inline]
pub(crate) fn ask_often(stop: Stop<'_>, step: usize) -> Result<(), Stopped> {
    if step.is_multiple_of(HEAVY_STEPS) && stop() { Err(Stopped) } else { Ok(()) }
}
