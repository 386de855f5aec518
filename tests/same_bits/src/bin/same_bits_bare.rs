//! Compares some of the digests on a Cortex-M of QEMU (`mps2-an386`), and says how much memory that took.
#![no_std]
#![no_main]

extern crate alloc;

use alloc::vec::Vec;
use core::alloc::{GlobalAlloc, Layout};
use core::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use cortex_m as _;
use cortex_m_semihosting::{debug, hprintln};
use embedded_alloc::LlffHeap;
use same_bits::{COMMITTED, Digests, GROUPS, Outcome, compare};

/// The board's PSRAM, for the heap; code and stack are in its static memory (`memory.x`).
const PSRAM: usize = 0x2100_0000;
const PSRAM_BYTES: usize = 16 << 20;

/// Groups that an emulated processor without double precision computes within a minute.
const ASKED: [&str; 5] = ["arithmetic", "function", "preset", "template", "register"];

/// A heap that knows how much of it was in use at most.
struct Counted {
    heap: LlffHeap,
    used: AtomicUsize,
    peak: AtomicUsize,
}

#[global_allocator]
static HEAP: Counted =
    Counted { heap: LlffHeap::empty(), used: AtomicUsize::new(0), peak: AtomicUsize::new(0) };

// SAFETY: the heap within does all of it; there is one thread, and no interrupt that allocates.
unsafe impl GlobalAlloc for Counted {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let used = self.used.load(Relaxed) + layout.size();
        self.used.store(used, Relaxed);
        self.peak.store(self.peak.load(Relaxed).max(used), Relaxed);
        unsafe { self.heap.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        self.used.store(self.used.load(Relaxed) - layout.size(), Relaxed);
        unsafe { self.heap.dealloc(pointer, layout) }
    }
}

/// Whether all is equal.
fn compared() -> Outcome<bool> {
    let mut found = Digests::new();
    let groups: Vec<_> = GROUPS.into_iter().filter(|group| ASKED.contains(&group.name)).collect();
    for group in groups {
        HEAP.peak.store(HEAP.used.load(Relaxed), Relaxed);
        (group.run)(&mut found)?;
        hprintln!("  {}: {} KiB of heap at most", group.name, HEAP.peak.load(Relaxed).div_ceil(1024));
    }
    let comparison = compare(COMMITTED, &ASKED, &found);
    hprintln!("{}", comparison);
    Ok(comparison.is_good())
}

#[cortex_m_rt::entry]
fn main() -> ! {
    // SAFETY: nothing else is in that memory, and this is done once, before anything is allocated.
    unsafe { HEAP.heap.init(PSRAM, PSRAM_BYTES) };
    let is_good = compared().unwrap_or_else(|error| {
        hprintln!("{}", error);
        false
    });
    debug::exit(if is_good { debug::EXIT_SUCCESS } else { debug::EXIT_FAILURE });
    loop {}
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    hprintln!("{}", info);
    debug::exit(debug::EXIT_FAILURE);
    loop {}
}
