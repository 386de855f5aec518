//! Compiles only while gelstereo-core and gelstereo-sim need no std.
#![no_std]

use core::alloc::{GlobalAlloc, Layout};

struct NoMemory;

// SAFETY: it hands out no memory at all, which every caller must be ready for.
unsafe impl GlobalAlloc for NoMemory {
    unsafe fn alloc(&self, _layout: Layout) -> *mut u8 {
        core::ptr::null_mut()
    }

    unsafe fn dealloc(&self, _pointer: *mut u8, _layout: Layout) {}
}

#[global_allocator]
static ALLOCATOR: NoMemory = NoMemory;

#[panic_handler]
fn panic(_info: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}

/// Number of markers of the default lattice: something of the core that the linker must keep.
#[unsafe(no_mangle)]
pub extern "C" fn default_markers() -> usize {
    let scene_markers = gelstereo_sim::Scene::default().gel.missing.len();
    gelstereo_core::params::Params::default().lattice.max_missing(1000) + scene_markers
}
