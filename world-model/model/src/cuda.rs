//! The libraries of CUDA, loaded when a GPU is opened rather than when the program starts.
//!
//! candle's feature `cuda` has a program linked to the driver's library and the toolkit's: without them, on a machine
//! without a GPU above all, it would not start. This crate defines the functions that candle calls, by the same names, so
//! that the linker needs none of these libraries, and the program names none. Each function goes on to the library's, the
//! address of which [`load`] finds out.
//!
//! ```no_run
//! match crate::cuda::load() {
//!     Ok(()) => println!("what a GPU takes is there"),
//!     Err(missing) => println!("{missing}"),
//! }
//! ```
//!
//! A function that is not here is linked as ever. The runtime library (`libcudart`) is not loaded: what candle has of it
//! are kernels for quantised weights and mixtures of experts, and no model of this workspace uses them. Here they end the
//! program.

mod functions;
mod library;
mod runtime;

use std::sync::OnceLock;

pub use library::Missing;

/// Loads the libraries, once in a process, and keeps them.
///
/// # Errors
/// [`Missing`] says which library cannot be loaded, or which function it does not have; the same each time.
pub fn load() -> Result<(), Missing> {
    static LOADED: OnceLock<Result<(), Missing>> = OnceLock::new();
    LOADED
        .get_or_init(|| {
            // Named, as the functions of the libraries are.
            std::hint::black_box(runtime::ALL);
            library::load(functions::libraries(), None)
        })
        .clone()
}
