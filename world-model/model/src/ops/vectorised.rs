//! Functions that are compiled once for each instruction set and chosen from at run time.

/// Defines a function whose body, and whatever is inlined into it, the compiler may vectorise with
/// the widest instructions of the processor.
///
/// Without it the compiler must assume the oldest processor of the architecture, where even a
/// fused multiply-add is a call.
macro_rules! vectorised {
    ($(#[$meta:meta])* $vis:vis fn $name:ident($($arg:ident: $type:ty),* $(,)?) $body:block) => {
        $(#[$meta])*
        $vis fn $name($($arg: $type),*) {
            #[inline(always)]
            fn body($($arg: $type),*) $body

            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx512f")]
                fn avx512($($arg: $type),*) {
                    body($($arg),*);
                }

                #[target_feature(enable = "avx2,fma")]
                fn avx2($($arg: $type),*) {
                    body($($arg),*);
                }

                use $crate::ops::simd::InstructionSet;
                match InstructionSet::detect() {
                    // SAFETY: the processor was found to have these instructions.
                    InstructionSet::Avx512 => return unsafe { avx512($($arg),*) },
                    // SAFETY: as above.
                    InstructionSet::Avx2 => return unsafe { avx2($($arg),*) },
                    InstructionSet::Portable => {}
                }
            }
            body($($arg),*);
        }
    };
}

pub(crate) use vectorised;
