//! Memory of packed weights.

use std::fmt;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut, Range};
use std::sync::Arc;

use bytemuck::Pod;
use memmap2::{Mmap, MmapMut, MmapOptions};

/// Size of a large page of the system, on every processor with 4 KiB pages.
const LARGE_PAGE: usize = 2 << 20;

/// Bytes of a file that is mapped for reading. Clones share the map.
#[derive(Clone, Debug)]
pub struct MappedBytes {
    map: Arc<Mmap>,
    range: Range<usize>,
}

impl MappedBytes {
    /// The bytes `range` of `map`; `None` if it has not that many.
    pub fn new(map: &Arc<Mmap>, range: Range<usize>) -> Option<Self> {
        map.get(range.clone())?;
        let map = Arc::clone(map);
        Some(Self { map, range })
    }

    /// The first `count` bytes, and those behind them; `None` if there are not that many.
    pub(super) fn split_at(&self, count: usize) -> Option<(Self, Self)> {
        let middle = self.range.start.checked_add(count)?;
        let part = |range| Self::new(&self.map, range);
        (middle <= self.range.end)
            .then(|| part(self.range.start..middle).zip(part(middle..self.range.end)))?
    }

    /// The bytes.
    pub fn as_slice(&self) -> &[u8] {
        self.map.get(self.range.clone()).unwrap_or_default()
    }
}

/// Values of packed weights.
///
/// What fills large pages asks for them: the system clears a page before it is first written, and of small ones that takes
/// longer than packing. The first writer of a page does it, so that many threads that pack also clear in parallel.
pub(crate) struct PanelValues<T> {
    memory: Memory<T>,
}

enum Memory<T> {
    /// Too few for a large page, or all that the system gave.
    Heap(Vec<T>),
    /// The bytes `range` of pages of their own.
    Pages(Pages<T>),
    /// What was packed before, and lies in a file.
    File(MappedBytes),
}

struct Pages<T> {
    map: MmapMut,
    /// Bytes of the values: they start on a large page.
    range: Range<usize>,
    values: PhantomData<T>,
}

impl<T: Pod> PanelValues<T> {
    /// So many zeros.
    pub(crate) fn zeros(count: usize) -> Self {
        let memory = match Pages::zeros(count) {
            Some(pages) => Memory::Pages(pages),
            None => Memory::Heap(vec![T::zeroed(); count]),
        };
        Self { memory }
    }

    /// The values in `bytes`; `None` if they are not `count`, or not aligned.
    pub(crate) fn mapped(bytes: MappedBytes, count: usize) -> Option<Self> {
        let values: &[T] = bytemuck::try_cast_slice(bytes.as_slice()).ok()?;
        (values.len() == count).then_some(Self {
            memory: Memory::File(bytes),
        })
    }
}

impl<T: Pod> PanelValues<T> {
    /// A copy in memory of its own.
    fn copied(&self) -> Self {
        let mut copy = Self::zeros(self.len());
        copy.copy_from_slice(self);
        copy
    }
}

impl<T: Pod> Pages<T> {
    /// `None` if they do not fill a large page, or the system does not give them.
    fn zeros(count: usize) -> Option<Self> {
        let bytes = count.checked_mul(size_of::<T>())?;
        if bytes < LARGE_PAGE {
            return None;
        }
        // Room for the start to be moved to a large page; what is left over before it and behind the end is never touched.
        let room = bytes.checked_add(LARGE_PAGE)?;
        let map = MmapOptions::new().len(room).map_anon().ok()?;
        let start = map.as_ptr().align_offset(LARGE_PAGE);
        let range = start..start.checked_add(bytes)?;
        #[cfg(target_os = "linux")]
        {
            // A system without large pages takes small ones.
            map.advise_range(memmap2::Advice::HugePage, start, bytes)
                .ok();
        }
        let pages = Self {
            map,
            range,
            values: PhantomData,
        };
        // Pages are aligned for everything; should that ever not hold, the heap is.
        (pages.len() == count).then_some(pages)
    }
}

impl<T: Pod> Deref for Pages<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        let bytes = self.map.get(self.range.clone()).unwrap_or_default();
        bytemuck::try_cast_slice(bytes).unwrap_or_default()
    }
}

impl<T: Pod> Deref for PanelValues<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        match &self.memory {
            Memory::Heap(values) => values,
            Memory::Pages(pages) => pages,
            Memory::File(bytes) => bytemuck::try_cast_slice(bytes.as_slice()).unwrap_or_default(),
        }
    }
}

impl<T: Pod> DerefMut for PanelValues<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        if let Memory::File(_) = self.memory {
            // The file stays as it is.
            *self = self.copied();
        }
        match &mut self.memory {
            Memory::Heap(values) => values,
            Memory::Pages(Pages { map, range, .. }) => {
                let bytes = map.get_mut(range.clone()).unwrap_or_default();
                bytemuck::try_cast_slice_mut(bytes).unwrap_or_default()
            }
            Memory::File(_) => &mut [],
        }
    }
}

impl<T: Pod> Clone for PanelValues<T> {
    fn clone(&self) -> Self {
        match &self.memory {
            Memory::File(bytes) => Self {
                memory: Memory::File(bytes.clone()),
            },
            _ => self.copied(),
        }
    }
}

impl<T: Pod + fmt::Debug> fmt::Debug for PanelValues<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        (**self).fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::simd::LANES;

    #[test]
    fn values_are_zeros_that_can_be_written_and_copied() {
        let large = LARGE_PAGE / size_of::<f32>();
        for count in [0, 1, 100, large - 1, large, large + 1, 3 * large + 17] {
            let mut values = PanelValues::<f32>::zeros(count);
            assert_eq!(values.len(), count);
            assert!(values.iter().all(|v| *v == 0.0));
            for (i, v) in values.iter_mut().enumerate() {
                *v = i as f32;
            }
            let copy = values.clone();
            values.fill(-1.0);
            assert!(copy.iter().enumerate().all(|(i, v)| *v == i as f32));
            assert_eq!(copy.len(), count);
        }
    }

    #[test]
    fn what_fills_large_pages_starts_on_one() {
        let large = LARGE_PAGE / size_of::<f32>();
        for count in [large, 2 * large + LANES] {
            let values = PanelValues::<f32>::zeros(count);
            assert!(matches!(values.memory, Memory::Pages(_)));
            assert_eq!(values.as_ptr().align_offset(LARGE_PAGE), 0);
        }
        let values = PanelValues::<f32>::zeros(large - 1);
        assert!(matches!(values.memory, Memory::Heap(_)));
    }

    #[test]
    fn a_files_values_are_shared_until_they_are_written() {
        use std::io::Write as _;
        let numbers: Vec<f32> = (0..1024).map(|i| i as f32).collect();
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(bytemuck::cast_slice(&numbers)).unwrap();
        // SAFETY: nobody else has the file.
        let map = Arc::new(unsafe { Mmap::map(&file) }.unwrap());
        let bytes = |range| MappedBytes::new(&map, range);
        assert!(bytes(0..4097).is_none() && bytes(4096..4100).is_none());
        let values = |range, count| PanelValues::<f32>::mapped(bytes(range).unwrap(), count);
        assert!(values(0..256, 63).is_none() && values(0..255, 64).is_none());
        assert!(values(2..258, 64).is_none(), "not aligned");
        let mut values = values(64..4096, 1008).unwrap();
        assert_eq!(*values, numbers[16..]);
        assert_eq!(values.clone().as_ptr(), values.as_ptr());
        values[0] = -1.0;
        assert_eq!((values[0], values[1]), (-1.0, 17.0));
        assert_eq!(bytes(64..68).unwrap().as_slice(), 16f32.to_ne_bytes());
    }
}
