//! Functions that are compiled once for each instruction set and chosen from at run time.

/// Defines a function whose body, and whatever is inlined into it, the compiler may vectorise with
/// the widest instructions of the processor.
///
/// Without it the compiler must assume the oldest processor of the architecture, where even a
/// fused multiply-add is a call.
macro_rules! vectorised {
    (
        $(#[$meta:meta])*
        $vis:vis fn $name:ident $(<$of:ident: $bound:path>)? ($($arg:ident: $type:ty),* $(,)?) $body:block
    ) => {
        $(#[$meta])*
        $vis fn $name $(<$of: $bound>)? ($($arg: $type),*) {
            #[inline(always)]
            fn body $(<$of: $bound>)? ($($arg: $type),*) $body

            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx512f")]
                fn avx512 $(<$of: $bound>)? ($($arg: $type),*) {
                    body $(::<$of>)? ($($arg),*);
                }

                #[target_feature(enable = "avx2,fma")]
                fn avx2 $(<$of: $bound>)? ($($arg: $type),*) {
                    body $(::<$of>)? ($($arg),*);
                }

                use $crate::ops::simd::InstructionSet;
                match InstructionSet::detect() {
                    // SAFETY: the processor was found to have these instructions.
                    InstructionSet::Avx512 => return unsafe { avx512 $(::<$of>)? ($($arg),*) },
                    // SAFETY: as above.
                    InstructionSet::Avx2 => return unsafe { avx2 $(::<$of>)? ($($arg),*) },
                    InstructionSet::Portable => {}
                }
            }
            body $(::<$of>)? ($($arg),*);
        }
    };
}

pub(crate) use vectorised;
