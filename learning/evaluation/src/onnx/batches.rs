//! Batches of constant size.

/// Items in groups of one size. The last group is padded with its last item, so that all runs have one shape: a file may fix
/// the shape, and a plan for another shape costs more than the padding.
pub(crate) struct Batches<'a, T> {
    items: std::slice::Chunks<'a, T>,
    size: usize,
}

pub(crate) struct Batch<'a, T> {
    items: &'a [T],
    size: usize,
}

impl<'a, T> Batches<'a, T> {
    pub(crate) fn new(items: &'a [T], size: usize) -> Self {
        let size = size.max(1);
        Self {
            items: items.chunks(size),
            size,
        }
    }
}

impl<'a, T> Iterator for Batches<'a, T> {
    type Item = Batch<'a, T>;

    fn next(&mut self) -> Option<Self::Item> {
        let items = self.items.next()?;
        Some(Batch {
            items,
            size: self.size,
        })
    }
}

impl<'a, T> Batch<'a, T> {
    /// Items of the run, with padding.
    pub(crate) fn len(&self) -> usize {
        self.size
    }

    /// Items without padding.
    pub(crate) fn given(&self) -> usize {
        self.items.len()
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &'a T> {
        let fill = self.items.last().into_iter().cycle();
        self.items.iter().chain(fill).take(self.size)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn last_item_fills_the_last_group() {
        let groups: Vec<(Vec<i32>, usize)> = Batches::new(&[1, 2, 3, 4, 5], 3)
            .map(|batch| (batch.iter().copied().collect(), batch.given()))
            .collect();
        assert_eq!(groups, [(vec![1, 2, 3], 3), (vec![4, 5, 5], 2)]);
        assert_eq!(Batches::<i32>::new(&[], 3).count(), 0);
    }
}
