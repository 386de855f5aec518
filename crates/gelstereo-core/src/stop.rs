//! Early cancellation of long work.
//!
//! Functions that can take seconds have a variant `*_unless`, which calls a closure every few
//! milliseconds. If the closure requests a stop, nothing is returned and the inputs are unchanged.
//! Otherwise the result is bit-identical to that of the plain function.

/// Called every few milliseconds; `true` stops the work.
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

/// Steps between two calls of the closure. A step is at most one nearest-point query, some microseconds.
/// The calls cost less than a thousandth of the work, and stopping takes a few milliseconds.
const STEPS: usize = 1024;

/// As [`STEPS`], for steps over much of a template: at most a millisecond each.
const HEAVY_STEPS: usize = 64;

/// Calls the closure before the first of every [`STEPS`] steps.
#[inline]
pub(crate) fn ask(stop: Stop<'_>, step: usize) -> Result<(), Stopped> {
    if step.is_multiple_of(STEPS) && stop() { Err(Stopped) } else { Ok(()) }
}

/// Calls the closure before the first of every [`HEAVY_STEPS`] steps.
#[inline]
pub(crate) fn ask_often(stop: Stop<'_>, step: usize) -> Result<(), Stopped> {
    if step.is_multiple_of(HEAVY_STEPS) && stop() { Err(Stopped) } else { Ok(()) }
}
