//! Weights in the order in which the kernels read them.

use crate::ops::element::Element;
use crate::ops::simd::{InstructionSet, LANES};

/// A matrix (inputs x outputs), cut into panels of a few vectors of outputs, each panel contiguous.
#[derive(Clone, Debug)]
pub(crate) struct Panels<T = f32> {
    /// Instruction set that the panels are cut for.
    pub set: InstructionSet,
    /// Vectors in each panel.
    pub widths: Vec<usize>,
    /// Rows of the matrix.
    pub depth: usize,
    /// Outputs of the matrix.
    pub outputs: usize,
    /// The panels one after the other, padded with zeros to whole vectors.
    pub values: Vec<T>,
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
            values: vec![T::ZERO; depth * vectors * LANES],
            bias: vec![0.0; vectors * LANES],
        }
    }

    /// Packs the matrix whose rows `row(k)` gives, with `bias` (or zeros).
    pub(crate) fn pack(
        depth: usize,
        outputs: usize,
        bias: Option<&[f32]>,
        mut value: impl FnMut(usize, usize) -> f32,
    ) -> Self {
        let mut panels = Self::zeros(depth, outputs);
        if let Some(bias) = bias {
            for (target, b) in panels.bias.iter_mut().zip(bias) {
                *target = *b;
            }
        }
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
