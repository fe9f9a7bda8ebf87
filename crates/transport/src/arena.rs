//! Large arrays that are read all over: asks the system for huge pages, because a random walk
//! through a hundred megabytes otherwise waits as long for page tables as for the data.

/// Bytes from which huge pages are asked for. A tree over a million triangles is far above.
const HUGE_FROM: usize = 16 << 20;

/// An empty vector with room for `count`, on huge pages where it is large and the system has
/// them. Room that is never written takes no memory.
pub(crate) fn with_huge_pages<T>(count: usize) -> Vec<T> {
    let vector = Vec::<T>::with_capacity(count);
    advise(vector.as_ptr() as usize, count * size_of::<T>());
    vector
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
