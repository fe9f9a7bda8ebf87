//! One block of memory for all that a walk through a tree reads, in cache lines.
//!
//! Large blocks ask the system for huge pages: a random walk through a hundred megabytes
//! otherwise waits as long for page tables as for the data.

/// Bytes from which huge pages are asked for. A tree over a million triangles is far above.
const HUGE_FROM: usize = 16 << 20;

/// A cache line.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Line([u32; 16]);

/// What an arena holds.
///
/// # Safety
/// Made of 32-bit numbers without gaps, all values of which are allowed; as large as its
/// alignment, 64, or a multiple.
pub(crate) unsafe trait Lines: Copy {}

/// Nodes and leaves side by side, each named by the number of its first line.
pub(crate) struct Arena(Vec<Line>);

impl Arena {
    /// An empty arena. Room that is never written takes no memory.
    pub(crate) fn with_room(bytes: usize) -> Arena {
        let count = bytes.div_ceil(size_of::<Line>());
        let lines = Vec::<Line>::with_capacity(count);
        advise(lines.as_ptr() as usize, count * size_of::<Line>());
        Arena(lines)
    }

    /// Bytes in use.
    pub(crate) fn bytes(&self) -> usize {
        self.0.len() * size_of::<Line>()
    }

    /// Appends an item and returns its name.
    pub(crate) fn push<T: Lines>(&mut self, item: &T) -> u32 {
        let name = self.0.len() as u32;
        // SAFETY: `Lines` promises whole, aligned lines without gaps.
        let lines = unsafe {
            std::slice::from_raw_parts(std::ptr::from_ref(item).cast(), size_of::<T>() / 64)
        };
        self.0.extend_from_slice(lines);
        name
    }

    /// Replaces an item.
    pub(crate) fn set<T: Lines>(&mut self, name: u32, item: &T) {
        // SAFETY: as for `push`.
        let lines: &[Line] = unsafe {
            std::slice::from_raw_parts(std::ptr::from_ref(item).cast(), size_of::<T>() / 64)
        };
        self.0[name as usize..][..lines.len()].copy_from_slice(lines);
    }

    /// An item by name.
    ///
    /// # Safety
    /// An item of type `T` was pushed under this name.
    #[inline(always)]
    pub(crate) unsafe fn get<T: Lines>(&self, name: u32) -> &T {
        debug_assert!(name as usize + size_of::<T>() / 64 <= self.0.len());
        unsafe { &*self.0.as_ptr().add(name as usize).cast() }
    }

    /// Starts to fetch the five lines that the largest item has.
    #[inline(always)]
    pub(crate) fn prefetch(&self, name: u32) {
        #[cfg(target_arch = "x86_64")]
        for k in 0..5 {
            use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
            let line = self.0.as_ptr().wrapping_add(name as usize + k);
            // SAFETY: a prefetch of any address is allowed.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(line.cast()) };
        }
        #[cfg(not(target_arch = "x86_64"))]
        let _ = name;
    }
}

#[cfg(target_os = "linux")]
fn advise(start: usize, bytes: usize) {
    const PAGE: usize = 4096;
    if bytes < HUGE_FROM {
        return;
    }
    let from = start.next_multiple_of(PAGE);
    let length = (start + bytes - from) / PAGE * PAGE;
    // SAFETY: whole pages inside one allocation of ours; the advice changes no content. A
    // refusal costs speed only, so the answer is not looked at.
    unsafe { libc::madvise(from as *mut libc::c_void, length, libc::MADV_HUGEPAGE) };
}

#[cfg(not(target_os = "linux"))]
fn advise(_start: usize, _bytes: usize) {
    const _: usize = HUGE_FROM;
}
