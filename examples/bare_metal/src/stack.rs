//! How deep the stack went: it is filled with a pattern, and what is left of that was never used.

use core::ptr;

const PATTERN: u32 = 0xA5A5_5A5A;

/// Left unpainted below the painting function's own frame, bytes.
const MARGIN_BYTES: usize = 256;

unsafe extern "C" {
    /// Lowest and highest address of the stack, from the linker script.
    static _stack_end: u32;
    static _stack_start: u32;
}

/// Fills the free part of the stack.
#[inline(never)]
pub fn paint() {
    let here = 0_u32;
    let top = (&raw const here).addr() - MARGIN_BYTES;
    let mut word = (&raw const _stack_end).cast_mut();
    while word.addr() < top {
        // SAFETY: between the stack's end and this frame nothing is in use.
        unsafe {
            ptr::write_volatile(word, PATTERN);
            word = word.add(1);
        }
    }
}

/// Bytes of stack used at most since `paint`, or in use when it was called.
pub fn peak_bytes() -> usize {
    let mut word = &raw const _stack_end;
    let start = &raw const _stack_start;
    // SAFETY: it stays between the two ends of the stack.
    while word < start && unsafe { ptr::read_volatile(word) } == PATTERN {
        word = unsafe { word.add(1) };
    }
    start.addr() - word.addr()
}
