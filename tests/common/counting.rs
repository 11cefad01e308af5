//! An allocator that counts what one thread allocates and frees, while it is asked to.
//! `SHOW_ALLOCATIONS=1` prints where each one came from.

use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
};

thread_local! {
    /// Allocations and frees of this thread, while they are counted.
    static COUNTED: Cell<u64> = const { Cell::new(0) };
    static COUNTING: Cell<bool> = const { Cell::new(false) };
}

struct Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Counts what this does on this thread.
pub(crate) fn counted<T>(what: impl FnOnce() -> T) -> T {
    with(true, what)
}

/// Counts nothing of what this does.
pub(crate) fn uncounted<T>(what: impl FnOnce() -> T) -> T {
    with(false, what)
}

fn with<T>(counting: bool, what: impl FnOnce() -> T) -> T {
    let before = COUNTING.replace(counting);
    let result = what();
    COUNTING.set(before);
    result
}

/// How many allocations and frees of this thread were counted since the last [`begin`].
pub(crate) fn so_far() -> u64 {
    COUNTED.get()
}

/// Begins at 0 again.
pub(crate) fn begin() {
    COUNTED.set(0);
}

fn count() {
    // Fails only while the thread ends.
    let _ = COUNTING.try_with(|counting| {
        if counting.get() {
            let _ = COUNTED.try_with(|counted| counted.set(counted.get() + 1));
            counting.set(false);
            if std::env::var_os("SHOW_ALLOCATIONS").is_some() {
                eprintln!("{}", std::backtrace::Backtrace::force_capture());
            }
            counting.set(true);
        }
    });
}

// SAFETY: every call goes to the system's allocator as it came; counting touches only thread-local cells without destructors.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: as the caller promised.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        count();
        // SAFETY: as the caller promised.
        unsafe { System.dealloc(memory, layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: as the caller promised.
        unsafe { System.realloc(memory, layout, size) }
    }
}
