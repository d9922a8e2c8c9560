//! Instructions for products of fewer bits.

use std::sync::OnceLock;

#[cfg(target_arch = "x86_64")]
use super::{InstructionSet, MOST_VECTORS, amx};

/// How products of bf16 are computed where the processor has an instruction for them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Bf16Unit {
    /// tdpbf16ps on tiles of AMX.
    #[cfg(target_arch = "x86_64")]
    Amx,
    /// vdpbf16ps on 512 bits.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// bfdot on 128 bits.
    #[cfg(target_arch = "aarch64")]
    Neon,
}

impl Bf16Unit {
    /// Those of this architecture, the best one first.
    pub(crate) const ALL: &[Self] = &[
        #[cfg(target_arch = "x86_64")]
        Self::Amx,
        #[cfg(target_arch = "x86_64")]
        Self::Avx512,
        #[cfg(target_arch = "aarch64")]
        Self::Neon,
    ];

    /// The best one of this machine, if it has any.
    pub(crate) fn detect() -> Option<Self> {
        static DETECTED: OnceLock<Option<Bf16Unit>> = OnceLock::new();
        *DETECTED.get_or_init(|| Self::ALL.iter().copied().find(|unit| unit.is_there()))
    }

    /// Whether this machine has it.
    pub(crate) fn is_there(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Amx => amx::has_bf16(),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                InstructionSet::Avx512.is_there() && is_x86_feature_detected!("avx512bf16")
            }
            #[cfg(target_arch = "aarch64")]
            Self::Neon => std::arch::is_aarch64_feature_detected!("bf16"),
        }
    }

    /// Whether it can be tested on this machine: AMX is emulated where it is not.
    #[cfg(test)]
    pub(crate) fn can_be_tested(self) -> bool {
        match self {
            #[cfg(all(target_arch = "x86_64", target_os = "linux"))]
            Self::Amx => self.is_there() || amx::emulator::install(),
            _ => self.is_there(),
        }
    }

    /// What users are told.
    pub(crate) fn name(self) -> &'static str {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Amx => "amx-bf16",
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => "avx512-bf16",
            #[cfg(target_arch = "aarch64")]
            Self::Neon => "neon-bf16",
        }
    }
}

/// How products of bytes are computed. All give the same sums, to the bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Int8Unit {
    /// As they are.
    Bytes(BytesUnit),
    /// As 16-bit whole numbers, by vpmaddwd. vpmaddubsw multiplies bytes, but only where the sign of one is moved to the
    /// other, and needs vpmaddwd for its sums all the same: together slower (1.4 times as fast as products of f32, on
    /// Zen 3, where vpmaddwd alone is nearly twice as fast).
    #[cfg(target_arch = "x86_64")]
    Avx2,
}

/// What multiplies bytes as they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BytesUnit {
    /// tdpbssd on tiles of AMX.
    #[cfg(target_arch = "x86_64")]
    Amx,
    /// vpdpbusd on 512 bits.
    #[cfg(target_arch = "x86_64")]
    Avx512Vnni,
    /// sdot on 128 bits.
    #[cfg(target_arch = "aarch64")]
    Neon,
    Portable,
}

impl Int8Unit {
    /// Those of this architecture, the best one first.
    pub(crate) const ALL: &[Self] = &[
        #[cfg(target_arch = "x86_64")]
        Self::Bytes(BytesUnit::Amx),
        #[cfg(target_arch = "x86_64")]
        Self::Bytes(BytesUnit::Avx512Vnni),
        #[cfg(target_arch = "x86_64")]
        Self::Avx2,
        #[cfg(target_arch = "aarch64")]
        Self::Bytes(BytesUnit::Neon),
        Self::Bytes(BytesUnit::Portable),
    ];

    /// The best one of this machine.
    pub(crate) fn detect() -> Self {
        static DETECTED: OnceLock<Int8Unit> = OnceLock::new();
        *DETECTED.get_or_init(|| {
            let best = Self::ALL.iter().copied().find(|unit| unit.is_there());
            best.unwrap_or(Self::Bytes(BytesUnit::Portable))
        })
    }

    /// Whether this machine has it.
    pub(crate) fn is_there(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Bytes(BytesUnit::Amx) => amx::has_int8(),
            #[cfg(target_arch = "x86_64")]
            Self::Bytes(BytesUnit::Avx512Vnni) => {
                InstructionSet::Avx512.is_there() && is_x86_feature_detected!("avx512vnni")
            }
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => InstructionSet::Avx2.is_there(),
            #[cfg(target_arch = "aarch64")]
            Self::Bytes(BytesUnit::Neon) => std::arch::is_aarch64_feature_detected!("dotprod"),
            Self::Bytes(BytesUnit::Portable) => true,
        }
    }

    /// Whether it can be tested on this machine: AMX is emulated where it is not.
    #[cfg(test)]
    pub(crate) fn can_be_tested(self) -> bool {
        match self {
            #[cfg(all(target_arch = "x86_64", target_os = "linux"))]
            Self::Bytes(BytesUnit::Amx) => self.is_there() || amx::emulator::install(),
            _ => self.is_there(),
        }
    }

    /// As [`InstructionSet::tile_vectors`].
    pub(crate) fn tile_vectors(self) -> usize {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Bytes(BytesUnit::Amx | BytesUnit::Avx512Vnni) => MOST_VECTORS,
            _ => 1,
        }
    }

    /// What is added to every input, for a unit that multiplies bytes without a sign with bytes that have one; the sums
    /// start lower by as much times their weights.
    pub(crate) fn input_offset(self) -> i32 {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Bytes(BytesUnit::Avx512Vnni) => 128,
            // No faster than with signs, but so every processor tests what the offset takes.
            Self::Bytes(BytesUnit::Portable) => 128,
            _ => 0,
        }
    }

    /// What users are told.
    pub(crate) fn name(self) -> &'static str {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Bytes(BytesUnit::Amx) => "amx-int8",
            #[cfg(target_arch = "x86_64")]
            Self::Bytes(BytesUnit::Avx512Vnni) => "avx512-vnni",
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => "avx2-int8",
            #[cfg(target_arch = "aarch64")]
            Self::Bytes(BytesUnit::Neon) => "neon-dotprod",
            Self::Bytes(BytesUnit::Portable) => "portable-int8",
        }
    }
}
