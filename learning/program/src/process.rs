//! Process settings of programs that compute with models.
//!
//! Every program that links this crate has its allocator.

/// Models allocate and free large tensors for each frame and step. The system's allocator returns the memory to the kernel
/// and faults it in again; this one keeps it for a second.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Limits candle to one thread: its pool spins while it waits and is shared by all threads of the process, so nodes or
/// training workers in one process slow each other. Our operations run on rayon.
///
/// Call first in `main`, while no other thread runs.
pub fn prepare() {
    const THREADS: &str = "CANDLE_NUM_THREADS";
    if std::env::var_os(THREADS).is_none() {
        // SAFETY: called first in main; no other thread reads the environment yet.
        unsafe { std::env::set_var(THREADS, "1") };
    }
}
