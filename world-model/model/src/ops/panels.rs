//! Weights in the order in which the kernels read them.

use rayon::prelude::*;

use crate::ops::element::{Element, Float, round_scaled};
use crate::ops::panel_values::{MappedBytes, PanelValues};
use crate::ops::simd::{InstructionSet, LANES};

/// Inputs that a block of a transposition takes from each output: a cache line of f32, so that the lines that it reads
/// and writes stay in a first-level cache.
const BLOCK: usize = 16;

/// Number of the order in which a matrix is packed: to be raised with every change to it, so that what was packed before
/// is not taken for it.
pub(super) const LAYOUT: u32 = 2;

/// Rows of a panel that one task fills.
const ROWS: usize = 64;

/// A matrix (inputs x outputs), cut into panels of a few vectors of outputs, each panel contiguous.
///
/// In a panel the inputs of a group ([`Element::GROUP`]) lie side by side for each output: (group, output, input of the
/// group). The last group is filled up with zeros.
#[derive(Clone, Debug)]
pub(crate) struct Panels<T: Element = f32> {
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
        Self::cut(depth, outputs, T::tile_vectors())
    }

    /// Zeros for a matrix (depth x outputs), in panels of `most` vectors at most.
    fn cut(depth: usize, outputs: usize, most: usize) -> Self {
        let vectors = outputs.div_ceil(LANES);
        // As equal as can be: six vectors are better as 3 + 3 than as 4 + 2.
        let count = vectors.div_ceil(most);
        let widths = (0..count)
            .map(|i| vectors * (i + 1) / count - vectors * i / count)
            .collect();
        Self {
            set: InstructionSet::detect(),
            widths,
            depth,
            outputs,
            values: PanelValues::zeros(depth.next_multiple_of(T::GROUP) * vectors * LANES),
            bias: vec![0.0; vectors * LANES],
        }
    }

    /// Rows of the matrix with those that fill up the last group.
    pub(crate) fn whole_depth(&self) -> usize {
        self.depth.next_multiple_of(T::GROUP)
    }

    /// Panels that were packed before and lie in a file, with `bias` (or zeros); `None` if they are those of another matrix.
    pub(crate) fn mapped(
        depth: usize,
        outputs: usize,
        bias: Option<&[f32]>,
        values: MappedBytes,
    ) -> Option<Self> {
        Self::mapped_in(T::tile_vectors(), (depth, outputs), bias, values)
    }

    /// As [`Self::mapped`], of panels of `most` vectors at most.
    pub(super) fn mapped_in(
        most: usize,
        (depth, outputs): (usize, usize),
        bias: Option<&[f32]>,
        values: MappedBytes,
    ) -> Option<Self> {
        let mut panels = Self::cut(0, outputs, most).with_bias(bias);
        panels.depth = depth;
        let whole = depth.checked_next_multiple_of(T::GROUP)?;
        let count = panels.bias.len().checked_mul(whole)?;
        panels.values = PanelValues::mapped(values, count)?;
        Some(panels)
    }

    /// The same with `bias` (or as it is).
    fn with_bias(mut self, bias: Option<&[f32]>) -> Self {
        for (target, b) in self.bias.iter_mut().zip(bias.unwrap_or_default()) {
            *target = *b;
        }
        self
    }

    /// Packs the transpose of `matrix` (outputs x depth), with `bias` (or zeros), on all threads of the pool.
    pub(crate) fn pack_transposed(
        depth: usize,
        outputs: usize,
        bias: Option<&[f32]>,
        matrix: &[f32],
    ) -> Self {
        Self::pack_transposed_in(T::tile_vectors(), (depth, outputs), bias, matrix)
    }

    /// As [`Self::pack_transposed`], in panels of `most` vectors at most.
    pub(super) fn pack_transposed_in(
        most: usize,
        (depth, outputs): (usize, usize),
        bias: Option<&[f32]>,
        matrix: &[f32],
    ) -> Self {
        let zeros = Self::cut(depth, outputs, most).with_bias(bias);
        zeros.filled(depth, &[matrix])
    }

    /// With the transposes of `matrices` (each outputs x `depth`) one below the other.
    fn filled(mut self, depth: usize, matrices: &[&[f32]]) -> Self {
        let outputs = self.outputs;
        let places: Vec<(usize, usize, usize)> = self.iter().collect();
        let mut rest = &mut *self.values;
        let mut parts = Vec::with_capacity(places.len() * matrices.len());
        for (vectors, _, first) in places {
            let width = vectors * LANES;
            let end = outputs.min(first + width);
            for matrix in matrices {
                let (panel, after) = rest.split_at_mut(depth.next_multiple_of(T::GROUP) * width);
                rest = after;
                let rows = matrix.get(first * depth..end * depth).unwrap_or_default();
                parts.push((width, panel, rows));
            }
        }
        parts
            .into_par_iter()
            .for_each(|(width, panel, rows)| transpose(depth, width, panel, rows));
        self
    }

    /// Packs the matrix to whose row `k`, from output `first` on, `add(k, first, row)` adds its values to zeros, with `bias`
    /// (or zeros), on all threads of the pool.
    pub(crate) fn pack_rows(
        depth: usize,
        outputs: usize,
        bias: Option<&[f32]>,
        add: impl Fn(usize, usize, &mut [f32]) + Sync,
    ) -> Self {
        let mut panels = Self::zeros(depth, outputs).with_bias(bias);
        let places: Vec<(usize, usize, usize)> = panels.iter().collect();
        let whole = panels.whole_depth();
        for (vectors, start, first) in places {
            let width = vectors * LANES;
            let count = width.min(outputs - first);
            let panel = panels.values.get_mut(start..start + whole * width);
            let blocks = panel.unwrap_or_default().par_chunks_mut(ROWS * width);
            blocks.enumerate().for_each(|(block, rows)| {
                let mut row = vec![0.0; count];
                for (group, values) in rows.chunks_exact_mut(T::GROUP * width).enumerate() {
                    let k = block * ROWS + group * T::GROUP;
                    for (place, k) in (k..depth.min(k + T::GROUP)).enumerate() {
                        row.fill(0.0);
                        add(k, first, &mut row);
                        let targets = values.iter_mut().skip(place).step_by(T::GROUP);
                        for (target, value) in targets.zip(&row) {
                            *target = T::from_f32(*value);
                        }
                    }
                }
            });
        }
        panels
    }

    /// For each panel: its vectors, its first value and its first output.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (usize, usize, usize)> {
        self.widths.iter().scan((0, 0), |(start, first), &vectors| {
            let item = (vectors, *start, *first);
            *start += self.whole_depth() * vectors * LANES;
            *first += vectors * LANES;
            Some(item)
        })
    }
}

impl<T: Float> Panels<T> {
    /// Packs the matrix whose column `n` is `column(n)` (`depth` values) times `factor`, on the calling thread.
    pub(crate) fn pack_columns<'a>(
        depth: usize,
        outputs: usize,
        factor: f32,
        column: impl Fn(usize) -> &'a [f32],
    ) -> Self {
        let mut panels = Self::zeros(depth, outputs);
        let places: Vec<(usize, usize, usize)> = panels.iter().collect();
        let whole = panels.whole_depth();
        let mut rounded = vec![T::ZERO; whole];
        for (vectors, start, first) in places {
            let width = vectors * LANES;
            let panel = panels.values.get_mut(start..start + whole * width);
            let panel = panel.unwrap_or_default();
            for (j, n) in (first..outputs.min(first + width)).enumerate() {
                round_scaled(column(n), factor, &mut rounded);
                write_column(&rounded, j, width, panel);
            }
        }
        panels
    }

    /// Packs the matrix whose row `k` is `row(k)`, on the calling thread.
    pub(crate) fn pack_plain_rows<'a>(
        depth: usize,
        outputs: usize,
        row: impl Fn(usize) -> &'a [f32],
    ) -> Self {
        let mut panels = Self::zeros(depth, outputs);
        let places: Vec<(usize, usize, usize)> = panels.iter().collect();
        let whole = panels.whole_depth();
        // Rows that fill up the last group.
        let zeros = vec![0.0; outputs];
        let row = |k: usize| if k < depth { row(k) } else { &zeros };
        let mut rows: Vec<&[f32]> = Vec::with_capacity(T::GROUP);
        for (vectors, start, first) in places {
            let width = vectors * LANES;
            let end = outputs.min(first + width);
            let panel = panels.values.get_mut(start..start + whole * width);
            let groups = panel.unwrap_or_default().chunks_exact_mut(T::GROUP * width);
            for (group, values) in groups.enumerate() {
                let of_group = group * T::GROUP..(group + 1) * T::GROUP;
                rows.clear();
                rows.extend(of_group.map(|k| row(k).get(first..end).unwrap_or_default()));
                T::interleave(&rows, values);
            }
        }
        panels
    }
}

impl Panels<f32> {
    /// Packs the transposes of `matrices` (each outputs x depth) one below the other, on all threads of the pool.
    pub(crate) fn pack_all_transposed(depth: usize, outputs: usize, matrices: &[&[f32]]) -> Self {
        Self::zeros(depth * matrices.len(), outputs).filled(depth, matrices)
    }

    /// Writes the matrix back in row-major order.
    pub(crate) fn unpack(&self, matrix: &mut [f32]) {
        for (vectors, start, first) in self.iter() {
            let width = vectors * LANES;
            let panel = self.values.get(start..start + self.depth * width);
            let count = width.min(self.outputs - first);
            for (source, target) in panel
                .unwrap_or_default()
                .chunks_exact(width)
                .zip(matrix.chunks_exact_mut(self.outputs))
            {
                for (t, s) in target.iter_mut().skip(first).zip(source).take(count) {
                    *t = *s;
                }
            }
        }
    }
}

/// Writes the transpose of `rows` (at most `width`, of `depth` values each) to `panel` (depth x width).
fn transpose<T: Element>(depth: usize, width: usize, panel: &mut [T], rows: &[f32]) {
    for (block, panel) in panel.chunks_mut(BLOCK * width).enumerate() {
        for (j, row) in rows.chunks_exact(depth.max(1)).enumerate() {
            let row = row.get(block * BLOCK..).unwrap_or_default();
            // Zeros fill up the last group.
            let mut rounded = [T::ZERO; BLOCK];
            round_scaled(row, 1.0, &mut rounded);
            write_column(&rounded, j, width, panel);
        }
    }
}

/// Writes `values` to column `j` of `panel` (whole groups of rows of `width` values).
fn write_column<T: Element>(values: &[T], j: usize, width: usize, panel: &mut [T]) {
    let groups = panel.chunks_exact_mut(T::GROUP * width);
    for (group, values) in groups.zip(values.chunks_exact(T::GROUP)) {
        if let Some(place) = group.get_mut(j * T::GROUP..(j + 1) * T::GROUP) {
            place.copy_from_slice(values);
        }
    }
}

#[cfg(test)]
mod tests {
    use half::bf16;

    use super::*;

    fn check<T: Float + Into<f32>>(depth: usize, outputs: usize) {
        // Whole numbers that bf16 has.
        let matrix: Vec<f32> = (0..outputs * depth)
            .map(|i| (i % 251) as f32 + 1.0)
            .collect();
        let bias: Vec<f32> = (0..outputs).map(|i| -(i as f32)).collect();
        let what = format!("{depth} x {outputs} in groups of {}", T::GROUP);
        let transposed = Panels::<T>::pack_transposed(depth, outputs, Some(&bias), &matrix);
        let rows = Panels::<T>::pack_rows(depth, outputs, Some(&bias), |k, first, row| {
            for (n, v) in (first..).zip(row) {
                *v += matrix[n * depth + k];
            }
        });
        let columns =
            Panels::<T>::pack_columns(depth, outputs, 2.0, |n| &matrix[n * depth..(n + 1) * depth]);
        let by_row: Vec<f32> = (0..depth * outputs)
            .map(|i| matrix[i % outputs * depth + i / outputs])
            .collect();
        let plain = Panels::<T>::pack_plain_rows(depth, outputs, |k| {
            &by_row[k * outputs..(k + 1) * outputs]
        });
        let without = |mut packed: Panels<T>| {
            packed.bias[..outputs].copy_from_slice(&bias);
            packed
        };
        for (packed, factor) in [
            (transposed, 1.0),
            (rows, 1.0),
            (without(columns), 2.0),
            (without(plain), 1.0),
        ] {
            assert_eq!(packed.bias[..outputs], bias, "{what}");
            let mut filled = 0;
            for (vectors, start, first) in packed.iter() {
                let width = vectors * LANES;
                for k in 0..packed.whole_depth() {
                    for j in 0..width {
                        let at = (k / T::GROUP * width + j) * T::GROUP + k % T::GROUP;
                        let expected = match (k < depth, first + j < outputs) {
                            (true, true) => matrix[(first + j) * depth + k] * factor,
                            _ => 0.0,
                        };
                        assert_eq!(packed.values[start + at].into(), expected, "{what}");
                        filled += 1;
                    }
                }
            }
            assert_eq!(filled, packed.values.len(), "{what}");
        }
    }

    #[test]
    fn every_weight_is_in_its_place() {
        for (depth, outputs) in [(1, 1), (5, 3), (16, 64), (33, 100), (40, 49), (130, 70)] {
            check::<f32>(depth, outputs);
            check::<bf16>(depth, outputs);
        }
    }

    #[test]
    fn what_was_packed_is_unpacked() {
        let (depth, outputs) = (5, 70);
        let matrices = [1, 2]
            .map(|seed| -> Vec<f32> { (0..outputs * depth).map(|i| (i * seed) as f32).collect() });
        let packed = Panels::pack_all_transposed(depth, outputs, &[&matrices[0], &matrices[1]]);
        let mut found = vec![0.0; 2 * depth * outputs];
        packed.unpack(&mut found);
        for (k, row) in found.chunks_exact(outputs).enumerate() {
            for (n, value) in row.iter().enumerate() {
                assert_eq!(*value, matrices[k / depth][n * depth + k % depth]);
            }
        }
    }

    fn check_layout<T: Element + Into<f32>>(depth: usize, outputs: usize) {
        let matrix: Vec<f32> = (0..outputs * depth).map(|i| (i % 251) as f32).collect();
        let panels = Panels::<T>::pack_transposed(depth, outputs, None, &matrix);
        let widths = match panels.set.tile_vectors() {
            1 => vec![1; outputs.div_ceil(LANES)],
            _ => vec![3, 3, 4],
        };
        assert_eq!(panels.widths, widths);
        let mut expected = Vec::new();
        let mut first = 0;
        for vectors in widths {
            for group in 0..depth.div_ceil(T::GROUP) {
                for n in first..first + vectors * LANES {
                    for k in group * T::GROUP..(group + 1) * T::GROUP {
                        let exists = k < depth && n < outputs;
                        expected.push(if exists { matrix[n * depth + k] } else { 0.0 });
                    }
                }
            }
            first += vectors * LANES;
        }
        let found: Vec<f32> = panels.values.iter().map(|v| (*v).into()).collect();
        assert_eq!(found, expected, "raise LAYOUT, then mend this test");
    }

    #[test]
    fn the_layout_is_the_one_of_its_number() {
        check_layout::<f32>(7, 150);
        check_layout::<bf16>(7, 150);
        assert_eq!(LAYOUT, 2, "mend the order that this test expects");
    }

    #[test]
    fn mapped_panels_are_the_packed_ones() {
        use std::io::Write as _;
        use std::sync::Arc;
        let (depth, outputs) = (33, 100);
        let matrix: Vec<f32> = (0..outputs * depth).map(|i| i as f32).collect();
        let bias: Vec<f32> = (0..outputs).map(|i| i as f32).collect();
        let packed = Panels::<f32>::pack_transposed(depth, outputs, Some(&bias), &matrix);
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
