//! The functions that candle calls.

use crate::library::Library;

/// Defines functions that go on to those of the same names in libraries, and a table of these.
macro_rules! forwarded {
    ($visibility:vis static $table:ident; $(
        [$($file:literal),+] of $part_of:literal { $($function:ident),* $(,)? }
    )*) => {
        #[allow(non_upper_case_globals)] // the functions' names
        mod slots {
            $($(pub(super) static $function: $crate::library::Slot = $crate::library::Slot::new();)*)*
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

            /// Named, so that whoever takes the table takes the functions too, with every linker.
            #[used]
            static ALL: &[extern "C" fn()] = &[$($($function),*),*];
        }

        $visibility static $table: &[$crate::library::Library] = &[$(
            $crate::library::Library {
                files: &[$($file),+],
                part_of: $part_of,
                functions: &[$((stringify!($function), &slots::$function)),*],
            }
        ),*];
    };
}

#[cfg(test)]
pub(crate) use forwarded;

forwarded! {
    pub(crate) static LIBRARIES;
    ["libcuda.so.1"] of "the NVIDIA driver; a machine without it has no GPU that can be used" {
        cuInit
    }
}
