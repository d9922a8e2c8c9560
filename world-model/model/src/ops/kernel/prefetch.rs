//! Prefetching of weights.
//!
//! The first tile of a row waits for a panel from memory; all others find it in the L2 cache. So the tiles of one panel prefetch the
//! next one, a few cache lines at a time: many lines at once would fill the buffers that the tiles' own loads need
//! (docs/benchmarks.md, "Beside ONNX Runtime and OpenVINO").

use std::sync::OnceLock;

use crate::ops::simd::{CACHE_LINE, prefetch};

/// Bytes to prefetch in parts.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prefetch {
    bytes: *const u8,
    left: usize,
    part: usize,
}

impl Prefetch {
    /// No bytes.
    pub(crate) const NOTHING: Self = Self {
        bytes: std::ptr::dangling(),
        left: 0,
        part: 0,
    };

    /// `values`, if the L2 cache has room for them and for as many others; otherwise no bytes.
    pub(crate) fn of<T>(values: &[T]) -> Self {
        let length = size_of_val(values);
        match 2 * length <= l2_cache_size() {
            true => Self {
                bytes: values.as_ptr().cast(),
                left: length,
                part: 0,
            },
            false => Self::NOTHING,
        }
    }

    /// The same bytes in `parts` parts of whole cache lines.
    pub(super) fn in_parts(self, parts: usize) -> Self {
        Self {
            part: self
                .left
                .div_ceil(parts.max(1))
                .next_multiple_of(CACHE_LINE),
            ..self
        }
    }

    /// Whether no bytes are left.
    #[inline(always)]
    pub(super) fn is_done(&self) -> bool {
        self.left == 0
    }

    /// Prefetches the next part.
    ///
    /// # Safety
    /// The values of [`Self::of`] must still be alive.
    #[inline(always)]
    pub(super) unsafe fn next_part(&mut self) {
        let part = self.part.min(self.left);
        // SAFETY: as for this function; `left` bytes of the values are at `bytes`.
        unsafe {
            prefetch(std::slice::from_raw_parts(self.bytes, part));
            self.bytes = self.bytes.add(part);
        }
        self.left -= part;
    }
}

/// Size of a core's L2 cache \[byte\], by CPUID; 0 on processors that do not report it.
pub(crate) fn l2_cache_size() -> usize {
    static SIZE: OnceLock<usize> = OnceLock::new();
    *SIZE.get_or_init(|| {
        #[cfg(target_arch = "x86_64")]
        {
            // "Deterministic cache parameters" of Intel's manual, volume 2, CPUID; "Cache properties" of AMD's, volume 3,
            // appendix E. The fields are the same.
            const INTEL: u32 = 4;
            const AMD: u32 = 0x8000_001d;
            [INTEL, AMD]
                .into_iter()
                .find_map(reported_l2_cache_size)
                .unwrap_or(0)
        }
        #[cfg(not(target_arch = "x86_64"))]
        0
    })
}

/// Size of a core's L2 cache \[byte\] by this leaf of CPUID; `None` on processors without it.
#[cfg(target_arch = "x86_64")]
fn reported_l2_cache_size(leaf: u32) -> Option<usize> {
    use std::arch::x86_64::{__cpuid, __cpuid_count};
    const EXTENDED: u32 = 0x8000_0000;
    if __cpuid(leaf & EXTENDED).eax < leaf {
        return None;
    }
    l2_size((0..16).map(|index| __cpuid_count(leaf, index)))
}

/// Size of the L2 cache \[byte\] among a processor's caches, as CPUID reports them.
#[cfg(target_arch = "x86_64")]
fn l2_size(caches: impl Iterator<Item = std::arch::x86_64::CpuidResult>) -> Option<usize> {
    let mut caches = caches.take_while(|cache| cache.eax & 0x1f != 0);
    let second = caches.find(|cache| (cache.eax >> 5) & 7 == 2)?;
    let field = |shift: u32, bits: u32| (second.ebx >> shift) & ((1 << bits) - 1);
    let (ways, partitions, line) = (field(22, 10), field(12, 10), field(0, 12));
    let number = |less_one: u32| less_one as usize + 1;
    Some(number(ways) * number(partitions) * number(line) * number(second.ecx))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_byte_is_prefetched_once() {
        let values = [0u8; 1000];
        let prefetch = Prefetch {
            bytes: values.as_ptr(),
            left: values.len(),
            part: 0,
        };
        let mut prefetch = prefetch.in_parts(4);
        for left in [744, 488, 232, 0, 0] {
            // SAFETY: the values are alive.
            unsafe { prefetch.next_part() };
            assert_eq!(prefetch.left, left);
        }
        assert_eq!(prefetch.bytes, values.as_ptr_range().end);
    }

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn l2_cache_is_found_among_all_caches() {
        let cache = |[eax, ebx, ecx]: [u32; 3]| std::arch::x86_64::CpuidResult {
            eax,
            ebx,
            ecx,
            edx: 0,
        };
        // Data and instructions in L1, both in an L2 of 1 MiB (16 ways, lines of 64 bytes, 1024 sets), the end.
        let caches = [
            [0x121, 0x02c0_003f, 63],
            [0x122, 0x01c0_003f, 63],
            [0x143, 0x03c0_003f, 1023],
            [0; 3],
        ];
        assert_eq!(l2_size(caches.map(cache).into_iter()), Some(1 << 20));
        // Intel's leaf on a processor of AMD.
        assert_eq!(l2_size([cache([0; 3])].into_iter()), None);
    }

    #[test]
    fn values_too_large_for_the_cache_are_not_prefetched() {
        let half = l2_cache_size() / 2;
        assert_eq!(Prefetch::of(&vec![0u8; half]).left, half);
        assert_eq!(Prefetch::of(&vec![0u8; half + 1]).left, 0);
    }
}
