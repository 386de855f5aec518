//! What differs between processors: the start, and a counter of instructions.
//!
//! With QEMU's `-icount shift=0` an instruction takes one nanosecond of the emulated clock. A timer of the
//! board then counts instructions, to within one period of its clock.

#[cfg(target_arch = "aarch64")]
mod aarch64;
#[cfg(target_arch = "arm")]
mod cortex_m;

#[cfg(target_arch = "aarch64")]
pub use aarch64::{counted_loop, instructions, start_counter};
#[cfg(target_arch = "arm")]
pub use cortex_m::{counted_loop, instructions, start_counter};
