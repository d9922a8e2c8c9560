//! Weights that are asked for before they are read.
//!
//! The first tile of a row waits for a panel from memory; all others find it in the second level of cache. So the tiles of one
//! panel ask for the next, a few lines at a time: many at once would fill the buffers that the tiles' own reads need
//! (docs/benchmarks.md, "Beside ONNX Runtime and OpenVINO").

use std::sync::OnceLock;

use crate::ops::simd::{CACHE_LINE, prefetch};

/// Bytes to ask for, and how many of them each time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ahead {
    bytes: *const u8,
    left: usize,
    at_once: usize,
}

impl Ahead {
    /// Asks for nothing.
    pub(crate) const NOTHING: Self = Self {
        bytes: std::ptr::null(),
        left: 0,
        at_once: 0,
    };

    /// Asks for `values`, where the second level of cache has room for them and for as many before them. Intel's processors
    /// have told its size; of AMD's, Zen 3 and Zen 4 were slower with what was asked for.
    pub(crate) fn of<T>(values: &[T]) -> Self {
        let length = size_of_val(values);
        match 2 * length <= second_level() {
            true => Self {
                bytes: values.as_ptr().cast(),
                left: length,
                at_once: 0,
            },
            false => Self::NOTHING,
        }
    }

    /// To be asked for in as many parts.
    pub(super) fn in_parts(self, parts: usize) -> Self {
        let part = self.left.div_ceil(parts.max(1));
        Self {
            at_once: part.next_multiple_of(CACHE_LINE),
            ..self
        }
    }

    /// Whether all was asked for.
    #[inline(always)]
    pub(super) fn is_done(&self) -> bool {
        self.left == 0
    }

    /// Asks for a part.
    ///
    /// # Safety
    /// The values that this was made of are still there.
    #[inline(always)]
    pub(super) unsafe fn ask(&mut self) {
        let part = self.at_once.min(self.left);
        // SAFETY: as for this function; `left` bytes of the values are at `bytes`.
        unsafe {
            prefetch(std::slice::from_raw_parts(self.bytes, part));
            self.bytes = self.bytes.add(part);
        }
        self.left -= part;
    }
}

/// Size of the second level of cache, of one core \[byte\]; 0 where the processor does not tell it as Intel's do.
pub(crate) fn second_level() -> usize {
    static SIZE: OnceLock<usize> = OnceLock::new();
    *SIZE.get_or_init(|| {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::x86_64::{__cpuid, __cpuid_count};
            // "Deterministic cache parameters", Intel's manual, volume 2, CPUID.
            const CACHES: u32 = 4;
            if __cpuid(0).eax < CACHES {
                return 0;
            }
            let caches = (0..16).map(|index| __cpuid_count(CACHES, index));
            let mut caches = caches.take_while(|cache| cache.eax & 0x1f != 0);
            let second = caches.find(|cache| (cache.eax >> 5) & 7 == 2);
            second.map_or(0, |cache| {
                let field = |shift: u32, bits: u32| (cache.ebx >> shift) & ((1 << bits) - 1);
                let (ways, partitions, line) = (field(22, 10), field(12, 10), field(0, 12));
                let number = |less_one: u32| less_one as usize + 1;
                number(ways) * number(partitions) * number(line) * number(cache.ecx)
            })
        }
        #[cfg(not(target_arch = "x86_64"))]
        0
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_byte_is_asked_for_once() {
        let values = [0u8; 1000];
        let ahead = Ahead {
            bytes: values.as_ptr(),
            left: values.len(),
            at_once: 0,
        };
        let mut ahead = ahead.in_parts(4);
        for left in [744, 488, 232, 0, 0] {
            // SAFETY: the values are there.
            unsafe { ahead.ask() };
            assert_eq!(ahead.left, left);
        }
        assert_eq!(ahead.bytes, values.as_ptr_range().end);
    }

    #[test]
    fn what_does_not_fit_is_not_asked_for() {
        let half = second_level() / 2;
        assert_eq!(Ahead::of(&vec![0u8; half]).left, half);
        assert_eq!(Ahead::of(&vec![0u8; half + 1]).left, 0);
    }
}
