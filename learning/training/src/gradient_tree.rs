//! The sum of a step's gradients in a fixed order.
//!
//! Sums of floats depend on their order. So the small batches of a step are the leaves of a binary tree, and each node is
//! the sum of its two children: any threads and processes may compute any of the leaves, and the root has the same bytes.
//! A process sends few nodes instead of all its leaves.

use std::{
    collections::{BTreeMap, BTreeSet},
    ops::Range,
    sync::{Mutex, PoisonError},
};

use rayon::prelude::*;

use crate::run::StepLoss;

/// Place of a node: the leaves from `index << level`, up to `1 << level` of them.
///
/// A node without a right sibling is its own parent, and has the parent's place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place {
    /// Height above the leaves.
    pub level: u32,
    /// Index in its level.
    pub index: usize,
}

impl Place {
    /// The place of a leaf among `count`.
    fn of_leaf(leaf: usize, count: usize) -> Self {
        let (level, index) = (0, leaf);
        Self { level, index }.risen(count)
    }

    /// The parent in a tree of `count` leaves.
    fn parent(self, count: usize) -> Self {
        let (level, index) = (self.level + 1, self.index >> 1);
        Self { level, index }.risen(count)
    }

    fn sibling(self) -> Self {
        Self {
            index: self.index ^ 1,
            ..self
        }
    }

    fn is_left(self) -> bool {
        self.index.is_multiple_of(2)
    }

    /// The highest place of the same leaves.
    fn risen(mut self, count: usize) -> Self {
        let has_sibling =
            |place: Self| !place.is_left() || (place.index + 1) << place.level < count;
        while self.index > 0 && !has_sibling(self) {
            self.level += 1;
            self.index >>= 1;
        }
        self
    }

    fn is_root(self, count: usize) -> bool {
        self.index == 0 && 1_usize << self.level >= count
    }
}

/// Places of the fewest nodes with the leaves `leaves` of `count`, in order.
pub fn covering(leaves: Range<usize>, count: usize) -> Vec<Place> {
    let mut places = BTreeSet::new();
    for leaf in leaves {
        let mut place = Place::of_leaf(leaf, count);
        while !place.is_root(count) && places.remove(&place.sibling()) {
            place = place.parent(count);
        }
        places.insert(place);
    }
    places.into_iter().collect()
}

/// A sum with its place.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// Place in the tree.
    pub place: Place,
    /// Sum of its leaves.
    pub sum: StepLoss,
}

/// A tree whose nodes arrive in any order; complete ones replace their children.
#[derive(Debug)]
pub struct GradientTree {
    count: usize,
    nodes: Mutex<BTreeMap<Place, StepLoss>>,
}

impl GradientTree {
    /// A tree of `count` leaves.
    pub fn new(count: usize) -> Self {
        Self {
            count,
            nodes: Mutex::default(),
        }
    }

    /// Adds the leaf `leaf`.
    pub fn add_leaf(&self, leaf: usize, sum: StepLoss) {
        let place = Place::of_leaf(leaf, self.count);
        self.add(Node { place, sum });
    }

    /// Adds a node, and sums it with its sibling if that is present, up to the root.
    pub fn add(&self, node: Node) {
        let Node { mut place, mut sum } = node;
        loop {
            // Locked only for the exchange: other threads add meanwhile.
            let other = {
                let mut nodes = self.nodes.lock().unwrap_or_else(PoisonError::into_inner);
                let other = match place.is_root(self.count) {
                    true => None,
                    false => nodes.remove(&place.sibling()),
                };
                let Some(other) = other else {
                    nodes.insert(place, sum);
                    return;
                };
                other
            };
            sum = match place.is_left() {
                true => added(sum, &other),
                false => added(other, &sum),
            };
            place = place.parent(self.count);
        }
    }

    /// All nodes, by place.
    pub fn into_nodes(self) -> Vec<Node> {
        let nodes = self
            .nodes
            .into_inner()
            .unwrap_or_else(PoisonError::into_inner);
        let nodes = nodes.into_iter();
        nodes.map(|(place, sum)| Node { place, sum }).collect()
    }

    /// The sum of all leaves; `None` if one is missing.
    pub fn into_root(self) -> Option<StepLoss> {
        let count = self.count;
        let root = self.into_nodes().pop()?;
        root.place.is_root(count).then_some(root.sum)
    }
}

fn added(mut left: StepLoss, right: &StepLoss) -> StepLoss {
    left.loss += right.loss;
    for ((_, sum), (_, part)) in left.parts.iter_mut().zip(&right.parts) {
        *sum += part;
    }
    let gradients = left.gradient.par_iter_mut().zip(&right.gradient);
    gradients.for_each(|(sums, parts)| {
        for (sum, part) in sums.iter_mut().zip(parts) {
            *sum += part;
        }
    });
    left
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A leaf whose sums depend on their order.
    fn leaf(index: usize) -> StepLoss {
        let value = 1.0 / (3 + index * index) as f32;
        StepLoss {
            loss: value,
            parts: vec![("part", f64::from(value))],
            gradient: vec![vec![value, -value * 7.0], vec![1e8 * value]],
        }
    }

    fn whole(count: usize, order: impl Iterator<Item = usize>) -> StepLoss {
        let tree = GradientTree::new(count);
        order.for_each(|index| tree.add_leaf(index, leaf(index)));
        tree.into_root().unwrap()
    }

    #[test]
    fn sum_is_of_pairs_and_missing_leaves_have_no_root() {
        let pairs = added(added(leaf(0), &leaf(1)), &added(leaf(2), &leaf(3)));
        assert_eq!(whole(4, 0..4), pairs);
        assert_eq!(whole(5, 0..5), added(pairs, &leaf(4)));
        assert_eq!(whole(1, 0..1), leaf(0));
        let tree = GradientTree::new(3);
        tree.add_leaf(0, leaf(0));
        tree.add_leaf(2, leaf(2));
        assert_eq!(tree.into_root(), None);
        assert_eq!(GradientTree::new(3).into_root(), None);
    }

    proptest! {
        #[test]
        fn root_is_independent_of_order_and_process(
            count in 1..40_usize,
            cuts in proptest::collection::vec(0..40_usize, 0..5),
            is_reversed: bool,
        ) {
            let expected = whole(count, 0..count);
            let order: Vec<usize> = match is_reversed {
                true => (0..count).rev().collect(),
                false => (0..count).collect(),
            };
            prop_assert_eq!(&whole(count, order.into_iter()), &expected);

            let mut cuts: Vec<usize> = cuts.into_iter().map(|cut| cut.min(count)).collect();
            cuts.extend([0, count]);
            cuts.sort_unstable();
            let tree = GradientTree::new(count);
            for ends in cuts.windows(2).rev() {
                let leaves = ends[0]..ends[1];
                let part = GradientTree::new(count);
                leaves.clone().for_each(|index| part.add_leaf(index, leaf(index)));
                let nodes = part.into_nodes();
                let places: Vec<Place> = nodes.iter().map(|node| node.place).collect();
                prop_assert_eq!(places, covering(leaves, count));
                nodes.into_iter().for_each(|node| tree.add(node));
            }
            prop_assert_eq!(tree.into_root().unwrap(), expected);
        }
    }
}
