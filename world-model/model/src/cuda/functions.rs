//! The functions that candle calls.

/// Defines functions that go on to those of the same names in libraries, and a function that gives a table of these.
macro_rules! forwarded {
    ($visibility:vis fn $table:ident; $(
        [$($file:literal),+] of $part_of:literal { $($function:ident),* $(,)? }
    )*) => {
        #[allow(non_upper_case_globals)] // the functions' names
        mod slots {
            $($(pub(super) static $function: $crate::cuda::library::Slot = $crate::cuda::library::Slot::new();)*)*
        }

        #[allow(non_snake_case)] // CUDA's names
        mod entries {
            $($(
                /// Goes on with whatever it was given: it changes no register that arguments are in, and no stack.
                #[unsafe(no_mangle)]
                #[unsafe(naked)]
                pub(super) extern "C" fn $function() {
                    #[cfg(target_arch = "x86_64")]
                    ::core::arch::naked_asm!("jmp qword ptr [rip + {}]", sym super::slots::$function);
                    #[cfg(target_arch = "aarch64")]
                    ::core::arch::naked_asm!(
                        "adrp x16, {0}",
                        "ldr x16, [x16, :lo12:{0}]",
                        "br x16",
                        sym super::slots::$function
                    );
                }
            )*)*

            pub(super) static ALL: &[extern "C" fn()] = &[$($($function),*),*];
        }

        $visibility fn $table() -> &'static [$crate::cuda::library::Library] {
            // Named, so that linkers take the functions where they take the table.
            ::std::hint::black_box(entries::ALL);
            static TABLE: &[$crate::cuda::library::Library] = &[$(
                $crate::cuda::library::Library {
                    files: &[$($file),+],
                    part_of: $part_of,
                    functions: &[$((stringify!($function), &slots::$function)),*],
                }
            ),*];
            TABLE
        }
    };
}

#[cfg(test)]
pub(crate) use forwarded;

forwarded! {
    pub(crate) fn libraries;
    ["libcuda.so.1"] of "the NVIDIA driver; a machine without it has no GPU that can be used" {
        cuCtxDestroy_v2, cuCtxGetCurrent, cuCtxSetCurrent, cuCtxSynchronize, cuDeviceGet, cuDeviceGetAttribute,
        cuDeviceGetCount, cuDeviceGetName, cuDevicePrimaryCtxRelease_v2, cuDevicePrimaryCtxRetain, cuDeviceTotalMem_v2,
        cuDriverGetVersion, cuEventCreate, cuEventDestroy_v2, cuEventRecord, cuEventSynchronize, cuGetErrorName,
        cuGetErrorString, cuGraphDestroy, cuGraphExecDestroy, cuGraphInstantiateWithFlags, cuGraphLaunch, cuGraphUpload,
        cuInit, cuLaunchKernel, cuMemAllocAsync, cuMemAlloc_v2, cuMemFreeAsync, cuMemFree_v2, cuMemGetInfo_v2,
        cuMemcpyDtoDAsync_v2, cuMemcpyDtoHAsync_v2, cuMemcpyHtoDAsync_v2, cuMemcpyPeerAsync, cuMemsetD8Async,
        cuModuleGetFunction, cuModuleLoad, cuModuleLoadData, cuModuleUnload, cuStreamBeginCapture_v2, cuStreamCreate,
        cuStreamDestroy_v2, cuStreamEndCapture, cuStreamIsCapturing, cuStreamSynchronize, cuStreamWaitEvent,
    }
    ["libcublas.so.13", "libcublas.so.12"] of "the CUDA toolkit; `pip install nvidia-cublas` has it too, and \
        LD_LIBRARY_PATH says where" {
        cublasCreate_v2, cublasDestroy_v2, cublasDgemmStridedBatched, cublasGemmEx, cublasGemmStridedBatchedEx,
        cublasSetStream_v2,
    }
    ["libcurand.so.10"] of "the CUDA toolkit; `pip install nvidia-curand` has it too, and LD_LIBRARY_PATH says where" {
        curandCreateGenerator, curandDestroyGenerator, curandGenerateNormal, curandGenerateNormalDouble,
        curandGenerateUniform, curandGenerateUniformDouble, curandSetPseudoRandomGeneratorSeed, curandSetStream,
    }
}
