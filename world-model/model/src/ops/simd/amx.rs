//! Tiles of AMX: eight registers of sixteen rows of 64 bytes, and their products.
//!
//! The instructions are written as assembly, as their intrinsics are not stable.
//! Source: Intel 64 and IA-32 Architectures Software Developer's Manual, volume 1, chapter 18, and the instructions' pages
//! in volume 2.

use std::arch::asm;
use std::arch::x86_64::__cpuid_count;
use std::sync::OnceLock;

#[cfg(all(test, target_os = "linux"))]
pub(crate) mod emulator;

/// Rows of a tile at most.
pub(crate) const ROWS: usize = 16;
/// Bytes of a row of a tile.
pub(crate) const ROW_BYTES: usize = 64;

/// Bits of EDX of leaf 7 of cpuid.
const AMX_BF16: u32 = 1 << 22;
const AMX_TILE: u32 = 1 << 24;
const AMX_INT8: u32 = 1 << 25;

/// Whether the processor has tiles and products of bf16, and the system lets this process use them.
pub(super) fn has_bf16() -> bool {
    has(AMX_BF16)
}

/// As [`has_bf16`], of bytes.
pub(super) fn has_int8() -> bool {
    has(AMX_INT8)
}

fn has(products: u32) -> bool {
    static FEATURES: OnceLock<u32> = OnceLock::new();
    let features = FEATURES.get_or_init(|| {
        let features = __cpuid_count(7, 0).edx;
        match features & AMX_TILE != 0 && is_permitted() {
            true => features,
            false => 0,
        }
    });
    features & products != 0
}

/// Whether the system keeps tiles when it switches threads, and lets this process use them: asks it.
#[cfg(target_os = "linux")]
fn is_permitted() -> bool {
    /// XTILECFG and XTILEDATA in XCR0.
    const TILES: u64 = 0b11 << 17;
    /// From `asm/prctl.h`, which libc does not have, and the number of XTILEDATA.
    const ARCH_REQ_XCOMP_PERM: libc::c_long = 0x1023;
    const TILE_DATA: libc::c_long = 18;

    // SAFETY: `is_x86_feature_detected` says that the system has enabled the instruction.
    let are_kept = is_x86_feature_detected!("xsave") && unsafe { enabled_state() } & TILES == TILES;
    // SAFETY: the call changes no memory of this process. A thread's stack for signals that were too small for tiles makes
    // it fail.
    are_kept && unsafe { libc::syscall(libc::SYS_arch_prctl, ARCH_REQ_XCOMP_PERM, TILE_DATA) == 0 }
}

/// Other systems ask in other ways.
#[cfg(not(target_os = "linux"))]
fn is_permitted() -> bool {
    false
}

/// XCR0: what the system keeps of a thread.
///
/// # Safety
/// The processor must have the instruction, and the system must have enabled it.
#[cfg(target_os = "linux")]
#[target_feature(enable = "xsave")]
unsafe fn enabled_state() -> u64 {
    // SAFETY: as for this function.
    unsafe { std::arch::x86_64::_xgetbv(0) }
}

/// The shapes of the tile registers, for as long as it lives.
///
/// Registers 0 to 3 are for sums, 4 and 5 for inputs (all of these of as many rows), 6 and 7 for weights.
pub(crate) struct Shapes {
    rows: usize,
    /// Another thread has other registers.
    of_thread: std::marker::PhantomData<*const ()>,
}

/// What `ldtilecfg` reads.
#[repr(C, align(64))]
struct Layout {
    palette: u8,
    start_row: u8,
    reserved: [u8; 14],
    row_bytes: [u16; 16],
    rows: [u8; 16],
}

impl Shapes {
    /// For tiles of `rows` rows of inputs and sums, 1 to [`ROWS`].
    ///
    /// # Safety
    /// The processor must have tiles, which this process may use, and no other `Shapes` may live in this thread.
    pub(crate) unsafe fn load(rows: usize) -> Self {
        const REGISTERS: usize = 8;
        debug_assert!((1..=ROWS).contains(&rows));
        let mut layout = Layout {
            palette: 1,
            start_row: 0,
            reserved: [0; 14],
            row_bytes: [0; 16],
            rows: [0; 16],
        };
        for register in 0..REGISTERS {
            // At most 64 and 16.
            layout.row_bytes[register] = ROW_BYTES as u16;
            layout.rows[register] = if register < 6 { rows } else { ROWS } as u8;
        }
        // SAFETY: as for this function. It reads the 64 bytes, and zeroes registers that the compiler does not use.
        unsafe {
            asm!("ldtilecfg [{layout}]", layout = in(reg) &raw const layout, options(nostack, readonly, preserves_flags));
        }
        Self {
            rows,
            of_thread: std::marker::PhantomData,
        }
    }

    /// Rows of the tiles of inputs and sums.
    pub(crate) fn rows(&self) -> usize {
        self.rows
    }
}

impl Drop for Shapes {
    fn drop(&mut self) {
        // SAFETY: there are tiles, as they were loaded. With them released the system need not keep them.
        unsafe { asm!("tilerelease", options(nomem, nostack, preserves_flags)) };
    }
}

/// What products of tiles read: two tiles of inputs, and the weights that they are multiplied with.
#[derive(Clone, Copy)]
pub(crate) struct Operands {
    /// The first row of both tiles of inputs, and the bytes from one row to the next.
    pub(crate) inputs: [*const u8; 2],
    pub(crate) input_pitch: usize,
    /// The first row of weights, of which [`ROWS`] are taken at a time, and the bytes from one row to the next.
    pub(crate) weights: *const u8,
    pub(crate) weight_pitch: usize,
    /// Products of tiles that follow each other: [`ROW_BYTES`] of every row of inputs, [`ROWS`] rows of weights; not 0.
    pub(crate) steps: usize,
    /// How often that is done, not 0, and the bytes from where it ends to where it begins again.
    pub(crate) runs: usize,
    pub(crate) next_inputs: usize,
    pub(crate) next_weights: usize,
}

/// Sums of two tiles of inputs, each with one or two of weights side by side.
#[repr(C, align(64))]
pub(crate) struct Sums(pub(crate) [[[[f32; 16]; ROWS]; 2]; 2]);

/// An instruction that multiplies tiles.
pub(crate) trait TileProduct {
    /// Adds the products with a tile of weights to the first sums of both tiles of inputs.
    ///
    /// # Safety
    /// `operands` must be readable as it says, `shapes` loaded in this thread, and the processor must have the instruction.
    unsafe fn add_one(shapes: &Shapes, operands: &Operands, sums: &mut Sums);

    /// Adds the products with two tiles of weights side by side to all sums.
    ///
    /// # Safety
    /// As for [`Self::add_one`].
    unsafe fn add_two(shapes: &Shapes, operands: &Operands, sums: &mut Sums);
}

macro_rules! tile_product {
    ($(#[$meta:meta])* $name:ident, $multiply:literal) => {
        $(#[$meta])*
        pub(crate) struct $name;

        impl TileProduct for $name {
            #[inline(always)]
            unsafe fn add_one(_shapes: &Shapes, operands: &Operands, sums: &mut Sums) {
                let [first, second] = operands.inputs;
                // SAFETY: as for this function; the sums have room for two tiles of any number of rows, 2048 bytes apart.
                unsafe {
                    asm!(
                        "tileloadd tmm0, [{sums} + {at}]",
                        "tileloadd tmm2, [{sums} + {at} + 2048]",
                        "2:",
                        "mov {at}, {steps}",
                        "3:",
                        "tileloadd tmm6, [{weights} + {weight_pitch}]",
                        "tileloadd tmm4, [{first} + {input_pitch}]",
                        concat!($multiply, " tmm0, tmm4, tmm6"),
                        "tileloadd tmm5, [{second} + {input_pitch}]",
                        concat!($multiply, " tmm2, tmm5, tmm6"),
                        "add {first}, 64",
                        "add {second}, 64",
                        "add {weights}, {weight_step}",
                        "dec {at}",
                        "jnz 3b",
                        "add {first}, {next_inputs}",
                        "add {second}, {next_inputs}",
                        "add {weights}, {next_weights}",
                        "dec {runs}",
                        "jnz 2b",
                        "mov {at:e}, 64",
                        "tilestored [{sums} + {at}], tmm0",
                        "tilestored [{sums} + {at} + 2048], tmm2",
                        sums = in(reg) sums,
                        at = inout(reg) ROW_BYTES => _,
                        first = inout(reg) first => _,
                        second = inout(reg) second => _,
                        input_pitch = in(reg) operands.input_pitch,
                        weights = inout(reg) operands.weights => _,
                        weight_pitch = in(reg) operands.weight_pitch,
                        weight_step = in(reg) ROWS * operands.weight_pitch,
                        steps = in(reg) operands.steps,
                        runs = inout(reg) operands.runs => _,
                        next_inputs = in(reg) operands.next_inputs,
                        next_weights = in(reg) operands.next_weights,
                        out("tmm0") _, out("tmm2") _, out("tmm4") _, out("tmm5") _, out("tmm6") _,
                        options(nostack),
                    );
                }
            }

            #[inline(always)]
            unsafe fn add_two(_shapes: &Shapes, operands: &Operands, sums: &mut Sums) {
                let [first, second] = operands.inputs;
                // SAFETY: as above, of four tiles, 1024 bytes apart.
                unsafe {
                    asm!(
                        "tileloadd tmm0, [{sums} + {at}]",
                        "tileloadd tmm1, [{sums} + {at} + 1024]",
                        "tileloadd tmm2, [{sums} + {at} + 2048]",
                        "tileloadd tmm3, [{sums} + {at} + 3072]",
                        "2:",
                        "mov {at}, {steps}",
                        "3:",
                        "tileloadd tmm6, [{weights} + {weight_pitch}]",
                        "tileloadd tmm4, [{first} + {input_pitch}]",
                        concat!($multiply, " tmm0, tmm4, tmm6"),
                        "tileloadd tmm7, [{weights} + {weight_pitch} + 64]",
                        concat!($multiply, " tmm1, tmm4, tmm7"),
                        "tileloadd tmm5, [{second} + {input_pitch}]",
                        concat!($multiply, " tmm2, tmm5, tmm6"),
                        concat!($multiply, " tmm3, tmm5, tmm7"),
                        "add {first}, 64",
                        "add {second}, 64",
                        "add {weights}, {weight_step}",
                        "dec {at}",
                        "jnz 3b",
                        "add {first}, {next_inputs}",
                        "add {second}, {next_inputs}",
                        "add {weights}, {next_weights}",
                        "dec {runs}",
                        "jnz 2b",
                        "mov {at:e}, 64",
                        "tilestored [{sums} + {at}], tmm0",
                        "tilestored [{sums} + {at} + 1024], tmm1",
                        "tilestored [{sums} + {at} + 2048], tmm2",
                        "tilestored [{sums} + {at} + 3072], tmm3",
                        sums = in(reg) sums,
                        at = inout(reg) ROW_BYTES => _,
                        first = inout(reg) first => _,
                        second = inout(reg) second => _,
                        input_pitch = in(reg) operands.input_pitch,
                        weights = inout(reg) operands.weights => _,
                        weight_pitch = in(reg) operands.weight_pitch,
                        weight_step = in(reg) ROWS * operands.weight_pitch,
                        steps = in(reg) operands.steps,
                        runs = inout(reg) operands.runs => _,
                        next_inputs = in(reg) operands.next_inputs,
                        next_weights = in(reg) operands.next_weights,
                        out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
                        out("tmm4") _, out("tmm5") _, out("tmm6") _, out("tmm7") _,
                        options(nostack),
                    );
                }
            }
        }
    };
}

tile_product! {
    /// Of pairs of bf16, with sums of f32.
    Bf16Tiles, "tdpbf16ps"
}

tile_product! {
    /// Of four bytes with signs, with sums of i32.
    Int8Tiles, "tdpbssd"
}
