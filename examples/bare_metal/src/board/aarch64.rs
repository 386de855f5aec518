//! An aarch64 of QEMU's `virt` board.

use core::arch::{asm, global_asm};

// The floating-point unit, then the stack; the board starts with exception level 1.
global_asm!(
    ".section .text.boot",
    ".global _start",
    "_start:",
    "mrs x0, cpacr_el1",
    "orr x0, x0, #(3 << 20)",
    "msr cpacr_el1, x0",
    "isb",
    "ldr x0, =_stack_start",
    "mov sp, x0",
    "bl {main}",
    main = sym start,
);

extern "C" fn start() -> ! {
    crate::main()
}

/// The architecture's timer always runs.
pub fn start_counter() {}

/// Instructions since the board started, in steps of one tick: 16 at QEMU's 62.5 MHz.
pub fn instructions() -> u64 {
    let (ticks, hz): (u64, u64);
    // SAFETY: it reads two registers.
    unsafe { asm!("isb", "mrs {0}, cntvct_el0", "mrs {1}, cntfrq_el0", out(reg) ticks, out(reg) hz) };
    ticks * (1_000_000_000 / hz)
}

/// Executes two instructions so many times.
pub fn counted_loop(rounds: usize) {
    // SAFETY: it changes one register.
    unsafe { asm!("2:", "subs {0}, {0}, #1", "b.ne 2b", inout(reg) rounds => _, options(nomem, nostack)) };
}
