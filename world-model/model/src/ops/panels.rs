//! Weights in the order in which the kernels read them.

use bytemuck::Pod;
use rayon::prelude::*;

use crate::ops::element::Element;
use crate::ops::panel_values::{MappedBytes, PanelValues};
use crate::ops::simd::{InstructionSet, LANES};

/// Inputs that a block of a transposition takes from each output: a cache line of f32, so that the lines that it reads
/// and writes stay in a first-level cache.
const BLOCK: usize = 16;

/// Number of the order in which a matrix is packed: to be raised with every change to it, so that what was packed before
/// is not taken for it.
pub(super) const LAYOUT: u32 = 1;

/// Rows of a panel that one task fills.
const ROWS: usize = 64;

/// A matrix (inputs x outputs), cut into panels of a few vectors of outputs, each panel contiguous.
#[derive(Clone, Debug)]
pub(crate) struct Panels<T: Pod = f32> {
    /// Instruction set that the panels are cut for.
    pub set: InstructionSet,
    /// Vectors in each panel.
    pub widths: Vec<usize>,
    /// Rows of the matrix.
    pub depth: usize,
    /// Outputs of the matrix.
    pub outputs: usize,
    /// The panels one after the other, padded with zeros to whole vectors.
    pub values: PanelValues<T>,
    /// One value an output, padded with zeros.
    pub bias: Vec<f32>,
}

impl<T: Element> Panels<T> {
    /// Zeros for a matrix (depth x outputs).
    pub(crate) fn zeros(depth: usize, outputs: usize) -> Self {
        let set = InstructionSet::detect();
        let vectors = outputs.div_ceil(LANES);
        // As equal as can be: six vectors are better as 3 + 3 than as 4 + 2.
        let count = vectors.div_ceil(set.tile_vectors());
        let widths = (0..count)
            .map(|i| vectors * (i + 1) / count - vectors * i / count)
            .collect();
        Self {
            set,
            widths,
            depth,
            outputs,
            values: PanelValues::zeros(depth * vectors * LANES),
            bias: vec![0.0; vectors * LANES],
        }
    }

    /// Panels that were packed before and lie in a file, with `bias` (or zeros); `None` if they are those of another matrix.
    pub(crate) fn mapped(
        depth: usize,
        outputs: usize,
        bias: Option<&[f32]>,
        values: MappedBytes,
    ) -> Option<Self> {
        let mut panels = Self::with_bias(0, outputs, bias);
        panels.depth = depth;
        let count = panels.bias.len().checked_mul(depth)?;
        panels.values = PanelValues::mapped(values, count)?;
        Some(panels)
    }

    /// Zeros for a matrix (depth x outputs), with `bias` (or zeros).
    fn with_bias(depth: usize, outputs: usize, bias: Option<&[f32]>) -> Self {
        let mut panels = Self::zeros(depth, outputs);
        for (target, b) in panels.bias.iter_mut().zip(bias.unwrap_or_default()) {
            *target = *b;
        }
        panels
    }

    /// Packs the transposes of `matrices` (each outputs x depth) one below the other, with `bias` (or zeros), on all
    /// threads of the pool.
    pub(crate) fn pack_transposed(
        depth: usize,
        outputs: usize,
        bias: Option<&[f32]>,
        matrices: &[&[f32]],
    ) -> Self {
        let mut panels = Self::with_bias(depth * matrices.len(), outputs, bias);
        let places: Vec<(usize, usize, usize)> = panels.iter().collect();
        let mut rest = &mut *panels.values;
        let mut parts = Vec::with_capacity(places.len() * matrices.len());
        for (vectors, _, first) in places {
            let width = vectors * LANES;
            let end = outputs.min(first + width);
            for matrix in matrices {
                let (panel, after) = rest.split_at_mut(depth * width);
                rest = after;
                let rows = matrix.get(first * depth..end * depth).unwrap_or_default();
                parts.push((width, panel, rows));
            }
        }
        parts
            .into_par_iter()
            .for_each(|(width, panel, rows)| transpose(depth, width, panel, rows));
        panels
    }

    /// Packs the matrix whose values `value(k, output)` gives, with `bias` (or zeros).
    pub(crate) fn pack(
        depth: usize,
        outputs: usize,
        bias: Option<&[f32]>,
        mut value: impl FnMut(usize, usize) -> f32,
    ) -> Self {
        let mut panels = Self::with_bias(depth, outputs, bias);
        let mut start = 0;
        let mut first = 0;
        for vectors in panels.widths.clone() {
            let width = vectors * LANES;
            let panel = panels.values.get_mut(start..start + depth * width);
            for (k, row) in panel
                .unwrap_or_default()
                .chunks_exact_mut(width)
                .enumerate()
            {
                for (j, v) in row.iter_mut().enumerate().take(outputs - first) {
                    *v = T::from_f32(value(k, first + j));
                }
            }
            start += depth * width;
            first += width;
        }
        panels
    }

    /// Writes the matrix back in row-major order.
    pub(crate) fn unpack(&self, matrix: &mut [f32]) {
        let mut start = 0;
        let mut first = 0;
        for vectors in &self.widths {
            let width = vectors * LANES;
            let panel = self.values.get(start..start + self.depth * width);
            let count = width.min(self.outputs - first);
            for (source, target) in panel
                .unwrap_or_default()
                .chunks_exact(width)
                .zip(matrix.chunks_exact_mut(self.outputs))
            {
                for (t, s) in target.iter_mut().skip(first).zip(source).take(count) {
                    *t = s.to_f32();
                }
            }
            start += self.depth * width;
            first += width;
        }
    }

    /// For each panel: its vectors, its first value and its first output.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (usize, usize, usize)> {
        self.widths.iter().scan((0, 0), |(start, first), &vectors| {
            let item = (vectors, *start, *first);
            *start += self.depth * vectors * LANES;
            *first += vectors * LANES;
            Some(item)
        })
    }
}

impl Panels<f32> {
    /// Packs the matrix to whose row `k`, from output `first` on, `add(k, first, row)` adds its values to zeros, with `bias`
    /// (or zeros), on all threads of the pool.
    pub(crate) fn pack_rows(
        depth: usize,
        outputs: usize,
        bias: Option<&[f32]>,
        add: impl Fn(usize, usize, &mut [f32]) + Sync,
    ) -> Self {
        let mut panels = Self::with_bias(depth, outputs, bias);
        let places: Vec<(usize, usize, usize)> = panels.iter().collect();
        for (vectors, start, first) in places {
            let width = vectors * LANES;
            let count = width.min(outputs - first);
            let panel = panels.values.get_mut(start..start + depth * width);
            let blocks = panel.unwrap_or_default().par_chunks_mut(ROWS * width);
            blocks.enumerate().for_each(|(block, rows)| {
                for (k, row) in (block * ROWS..).zip(rows.chunks_exact_mut(width)) {
                    add(k, first, row.get_mut(..count).unwrap_or_default());
                }
            });
        }
        panels
    }
}

/// Writes the transpose of `rows` (at most `width`, of `depth` values each) to `panel` (depth x width).
fn transpose<T: Element>(depth: usize, width: usize, panel: &mut [T], rows: &[f32]) {
    for (block, panel) in panel.chunks_mut(BLOCK * width).enumerate() {
        for (j, row) in rows.chunks_exact(depth.max(1)).enumerate() {
            let row = row.get(block * BLOCK..).unwrap_or_default();
            for (target, value) in panel.iter_mut().skip(j).step_by(width).zip(row) {
                *target = T::from_f32(*value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_packed_transpose_is_the_transpose_packed() {
        for (depth, outputs) in [(1, 1), (5, 3), (16, 64), (33, 100), (40, 49)] {
            let matrix: Vec<f32> = (0..outputs * depth).map(|i| i as f32 + 1.0).collect();
            let bias: Vec<f32> = (0..outputs).map(|i| -(i as f32)).collect();
            let value = |k: usize, n: usize| matrix[n * depth + k];
            let expected = Panels::<f32>::pack(depth, outputs, Some(&bias), value);
            let packed = Panels::<f32>::pack_transposed(depth, outputs, Some(&bias), &[&matrix]);
            assert_eq!(*packed.values, *expected.values, "{depth} x {outputs}");
            assert_eq!(packed.bias, expected.bias);
            let packed = Panels::pack_rows(depth, outputs, Some(&bias), |k, first, row| {
                for (n, v) in (first..).zip(row) {
                    *v += value(k, n);
                }
            });
            assert_eq!(
                *packed.values, *expected.values,
                "rows of {depth} x {outputs}"
            );
        }
    }

    #[test]
    fn the_layout_is_the_one_of_its_number() {
        let (depth, outputs) = (7, 150);
        let matrix: Vec<f32> = (0..outputs * depth).map(|i| i as f32).collect();
        let panels = Panels::<f32>::pack_transposed(depth, outputs, None, &[&matrix]);
        let widths = match panels.set.tile_vectors() {
            1 => vec![1; 10],
            most => vec![3, 3, 4]
                .into_iter()
                .map(|w: usize| w.min(most))
                .collect(),
        };
        assert_eq!(panels.widths, widths);
        let mut expected = Vec::new();
        let mut first = 0;
        for vectors in widths {
            for k in 0..depth {
                let places = first..first + vectors * LANES;
                expected.extend(places.map(|n| matrix.get(n * depth + k).map_or(0.0, |v| *v)));
            }
            first += vectors * LANES;
        }
        assert_eq!(
            *panels.values, *expected,
            "raise LAYOUT, then mend this test"
        );
        assert_eq!(LAYOUT, 1, "mend the order that this test expects");
    }

    #[test]
    fn mapped_panels_are_the_packed_ones() {
        use std::io::Write as _;
        use std::sync::Arc;
        let (depth, outputs) = (33, 100);
        let matrix: Vec<f32> = (0..outputs * depth).map(|i| i as f32).collect();
        let bias: Vec<f32> = (0..outputs).map(|i| i as f32).collect();
        let packed = Panels::<f32>::pack_transposed(depth, outputs, Some(&bias), &[&matrix]);
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(bytemuck::cast_slice(&packed.values))
            .unwrap();
        // SAFETY: nobody else has the file.
        let map = Arc::new(unsafe { memmap2::Mmap::map(&file) }.unwrap());
        let mapped = |depth, outputs| {
            let values = MappedBytes::new(&map, 0..map.len()).unwrap();
            Panels::<f32>::mapped(depth, outputs, Some(&bias), values)
        };
        let same = mapped(depth, outputs).unwrap();
        assert_eq!(*same.values, *packed.values);
        assert_eq!((same.widths, same.bias), (packed.widths, packed.bias));
        assert_eq!((same.depth, same.outputs), (depth, outputs));
        for (depth, outputs) in [(32, 100), (33, 120), (0, 0), (usize::MAX, 100)] {
            assert!(mapped(depth, outputs).is_none(), "{depth} x {outputs}");
        }
    }
}
