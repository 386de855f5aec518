//! A Cortex-M of the MPS2 boards.

use core::arch::asm;
use core::ptr;

/// The first CMSDK timer: control, value and reload registers, 4 bytes each. It counts down at 25 MHz.
const TIMER: *mut u32 = 0x4000_0000 as *mut u32;
const NS_PER_TICK: u64 = 40;

#[cortex_m_rt::entry]
fn start() -> ! {
    crate::main()
}

#[cortex_m_rt::exception]
unsafe fn HardFault(_frame: &cortex_m_rt::ExceptionFrame) -> ! {
    panic!("hard fault")
}

pub fn start_counter() {
    // SAFETY: nothing else uses this timer.
    unsafe {
        ptr::write_volatile(TIMER.add(2), u32::MAX);
        ptr::write_volatile(TIMER.add(1), u32::MAX);
        ptr::write_volatile(TIMER, 1);
    }
}

/// Instructions since `start_counter`, in steps of 40; it starts again after 171 thousand million.
pub fn instructions() -> u64 {
    // SAFETY: as above.
    let left = unsafe { ptr::read_volatile(TIMER.add(1)) };
    u64::from(u32::MAX - left) * NS_PER_TICK
}

/// Executes two instructions so many times.
pub fn counted_loop(rounds: usize) {
    // SAFETY: it changes one register.
    unsafe { asm!("2:", "subs {0}, {0}, #1", "bne 2b", inout(reg) rounds => _, options(nomem, nostack)) };
}
