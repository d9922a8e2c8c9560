//! What would be called of `libcudart`, by code that a compiler of CUDA made. Such code makes its kernels known when the
//! program starts, with or without a GPU: that does nothing here. To launch one ends the program: it would compute nothing,
//! and nobody would be told.

#![allow(non_snake_case)] // CUDA's names

use std::ffi::c_void;

macro_rules! runtime {
    (does_nothing { $($quiet:ident),* $(,)? } ends_the_program { $($fatal:ident),* $(,)? }) => {
        $(#[unsafe(no_mangle)]
        extern "C" fn $quiet() {})*

        $(#[unsafe(no_mangle)]
        extern "C" fn $fatal() {
            not_here(stringify!($fatal));
        })*

        /// All functions of this module but the one with a result.
        pub(crate) static ALL: (&[extern "C" fn()], extern "C" fn() -> *const c_void) =
            (&[$($quiet,)* $($fatal),*], __cudaRegisterFatBinary);
    };
}

runtime! {
    does_nothing {
        __cudaRegisterFatBinaryEnd, __cudaRegisterFunction, __cudaRegisterVar, __cudaUnregisterFatBinary,
    }
    ends_the_program {
        __cudaGetKernel, __cudaLaunchKernel_ptsz, __cudaPopCallConfiguration, __cudaPushCallConfiguration,
        cudaFuncSetAttribute, cudaGetDevice,
    }
}

/// What the code calls its kernels by from then on; nobody looks behind it.
#[unsafe(no_mangle)]
extern "C" fn __cudaRegisterFatBinary() -> *const c_void {
    static HANDLE: u64 = 0;
    (&raw const HANDLE).cast()
}

fn not_here(function: &str) {
    eprintln!(
        "{function} of libcudart was called: quantised weights and mixtures of experts are not computed on a GPU"
    );
    std::process::abort();
}
