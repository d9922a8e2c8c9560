//! Where in a file a tensor lies.

use std::sync::Arc;

use super::Element;
use super::storage::Storage;

/// Tensors with more dimensions than this are taken for damage.
const MAX_RANK: usize = 16;

/// Where a tensor's values are, in bytes from the start of the file, checked to lie within it.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    pub(super) element: Element,
    pub(super) shape: Vec<usize>,
    /// Values from one index to the next, for each dimension; `None` if rows follow each other without gaps.
    pub(super) strides: Option<Vec<usize>>,
    /// First byte of the value at index 0.
    pub(super) start: usize,
    /// What has a checksum and holds the values, in a torch file.
    pub(super) storage: Option<Arc<Storage>>,
}

impl Entry {
    /// Checks an entry against the range of bytes that its values may take.
    pub(super) fn checked(
        element: Element,
        shape: Vec<usize>,
        strides: Option<Vec<usize>>,
        start: usize,
        end: usize,
    ) -> Result<Self, String> {
        if shape.len() > MAX_RANK || strides.as_ref().is_some_and(|s| s.len() != shape.len()) {
            return Err(format!("shape {shape:?} with strides {strides:?}"));
        }
        let strides = strides.filter(|strides| !are_contiguous(&shape, strides));
        let entry = Self {
            element,
            shape,
            strides,
            start,
            storage: None,
        };
        let fits = |span| start.checked_add(span).is_some_and(|last| last <= end);
        match entry.span() {
            // A tensor may repeat values, but what is read of a file stays bounded by the file.
            Some(span) if fits(span) && entry.count() <= end => Ok(entry),
            _ => Err(format!(
                "{:?} values {} with strides {:?} from byte {start} on reach beyond their data, which end at {end}",
                entry.shape,
                entry.element.name(),
                entry.strides,
            )),
        }
    }

    /// Number of values.
    pub(super) fn count(&self) -> usize {
        self.shape.iter().product()
    }

    /// Bytes from the first value to the end of the last one; `None` if that overflows.
    pub(super) fn span(&self) -> Option<usize> {
        let mut count = 1usize;
        for size in &self.shape {
            count = count.checked_mul(*size)?;
        }
        if count == 0 {
            return Some(0);
        }
        let values = match &self.strides {
            None => count,
            Some(strides) => {
                let mut last = 0usize;
                for (size, stride) in self.shape.iter().zip(strides) {
                    last = last.checked_add((size - 1).checked_mul(*stride)?)?;
                }
                last.checked_add(1)?
            }
        };
        values.checked_mul(self.element.size())
    }
}

fn are_contiguous(shape: &[usize], strides: &[usize]) -> bool {
    let mut expected = 1usize;
    shape.iter().zip(strides).rev().all(|(size, stride)| {
        let fits = *size == 1 || *stride == expected;
        expected = expected.saturating_mul(*size);
        fits
    })
}
