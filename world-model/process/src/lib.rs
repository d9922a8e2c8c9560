//! What a program that computes with models sets before it does anything else.
//!
//! A program that links this crate has its allocator.

/// Models allocate and free large tensors, frame by frame and step by step; the system's allocator gives that memory back
/// to the kernel and faults it in again each time.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Freed memory stays with the process for so many milliseconds: what runs at the camera's rate, or step after step, finds
/// its buffers again, whose pages the kernel would else have to clear each time (a tenth of a vision transformer's time, a
/// twentieth of a training step's), and a node that has become idle still gives them back.
const KEEP_FREED_MS: std::ffi::c_long = 10_000;

/// To be called first in `main`, while no other thread runs.
pub fn prepare() {
    keep_freed_memory();
    keep_candle_to_one_thread();
}

fn keep_freed_memory() {
    /// `mi_option_purge_delay` of mimalloc.h, which the bindings have no name for.
    const PURGE_DELAY: libmimalloc_sys::mi_option_t = 15;
    // SAFETY: an option that exists in the mimalloc that is linked; setting it touches no memory of ours.
    unsafe { libmimalloc_sys::mi_option_set_default(PURGE_DELAY, KEEP_FREED_MS) };
}

/// Keeps candle to one thread: its own pool spins while it waits and is shared by all threads of the process, so that
/// nodes side by side, or the workers of a training, take each other's processor. Our operations are spread by rayon.
fn keep_candle_to_one_thread() {
    const THREADS: &str = "CANDLE_NUM_THREADS";
    if std::env::var_os(THREADS).is_none() {
        // SAFETY: the first thing that main does; no other thread runs yet that could read the environment.
        unsafe { std::env::set_var(THREADS, "1") };
    }
}
