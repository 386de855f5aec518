//! One static heap, which knows how much of it was in use.

use core::alloc::{GlobalAlloc, Layout};
use core::cell::UnsafeCell;
use core::ptr::{self, NonNull};
use linked_list_allocator::Heap;

/// What was taken from the heap.
#[derive(Clone, Copy, Default)]
pub struct HeapUse {
    /// Most bytes in use at one time, with the allocator's rounding.
    pub peak_bytes: usize,
    /// End of the highest block, from the heap's start: the size that the heap needs, with its gaps.
    pub reach_bytes: usize,
    pub allocations: usize,
}

/// The heap between the linker's symbols `_heap_start` and `_heap_end`.
pub struct StaticHeap(UnsafeCell<(Heap, HeapUse)>);

// SAFETY: there is one thread, and no interrupt allocates.
unsafe impl Sync for StaticHeap {}

unsafe extern "C" {
    static _heap_start: u8;
    static _heap_end: u8;
}

impl StaticHeap {
    /// Without memory, until `start` gives it some.
    pub const fn empty() -> Self {
        let none = HeapUse { peak_bytes: 0, reach_bytes: 0, allocations: 0 };
        Self(UnsafeCell::new((Heap::empty(), none)))
    }

    /// Takes the linker's region; returns its size in bytes.
    ///
    /// # Safety
    /// Call it once, before anything is allocated.
    pub unsafe fn start(&self) -> usize {
        let (start, end) = (&raw const _heap_start, &raw const _heap_end);
        let size_bytes = end.addr() - start.addr();
        // SAFETY: nothing else uses that region, and no reference to the heap lives on.
        unsafe { (*self.0.get()).0.init(start.cast_mut(), size_bytes) };
        size_bytes
    }

    /// What was taken since `forget`.
    pub fn used(&self) -> HeapUse {
        // SAFETY: no reference to the heap lives on.
        unsafe { (*self.0.get()).1 }
    }

    /// Counts from what is in use now.
    pub fn forget(&self) {
        // SAFETY: no reference to the heap lives on.
        let (heap, used) = unsafe { &mut *self.0.get() };
        *used = HeapUse { peak_bytes: heap.used(), ..HeapUse::default() };
    }
}

// SAFETY: the heap within does it; a caller that has what `alloc` gave has the only pointer to it.
unsafe impl GlobalAlloc for StaticHeap {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: no other reference to the heap lives on.
        let (heap, used) = unsafe { &mut *self.0.get() };
        let Ok(block) = heap.allocate_first_fit(layout) else { return ptr::null_mut() };
        let end_bytes = block.as_ptr().addr() + layout.size() - heap.bottom().addr();
        used.peak_bytes = used.peak_bytes.max(heap.used());
        used.reach_bytes = used.reach_bytes.max(end_bytes);
        used.allocations += 1;
        block.as_ptr()
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        let Some(block) = NonNull::new(block) else { return };
        // SAFETY: the caller has the block from `alloc`, with this layout.
        unsafe { (*self.0.get()).0.deallocate(block, layout) };
    }
}
