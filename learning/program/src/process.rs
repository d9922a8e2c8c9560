//! What a program that computes with models sets before it does anything else.
//!
//! A program that links this crate has its allocator.

/// Models allocate and free large tensors, frame by frame and step by step. The system's allocator gives that memory back
/// to the kernel and faults it in again each time; this one keeps it for a second.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Keeps candle to one thread: its own pool spins while it waits and is shared by all threads of the process, so that
/// nodes side by side, or the workers of a training, take each other's processor. Our operations are spread by rayon.
///
/// To be called first in `main`, while no other thread runs.
pub fn prepare() {
    const THREADS: &str = "CANDLE_NUM_THREADS";
    if std::env::var_os(THREADS).is_none() {
        // SAFETY: the first thing that main does; no other thread runs yet that could read the environment.
        unsafe { std::env::set_var(THREADS, "1") };
    }
}
