//! y = x W^T + b with weights that are packed once: the matrix product of inference.

use std::mem::MaybeUninit;
use std::sync::Arc;

use half::bf16;
use rayon::prelude::*;

use super::input_range::InputRange;
use super::int8_panels::{Int8Panels, MOST_INPUTS};
use super::length::check_length;
use super::panel_product::{OutputValue, PanelProduct, Rows};
use super::panel_values::MappedBytes;
use super::panels::{LAYOUT, Panels};
use super::simd::{InstructionSet, Int8Unit};
use super::smoothing::Smoothing;
use super::uncleared::uncleared;
use crate::NumberFormat;
use crate::{Error, Result};

/// Rows that one task handles at most: enough for a panel to be used often once it is there, few enough for them to stay
/// in a second-level cache.
const ROWS: usize = 160;

/// In which order matrices are packed here. Packed values that were kept are of use where it is the same.
pub fn packed_layout() -> String {
    let architecture = std::env::consts::ARCH;
    let (set, int8) = (InstructionSet::detect().name(), Int8Unit::detect().name());
    format!("{LAYOUT} {architecture} {set} {int8}")
}

/// A matrix and a bias in the order in which the kernel reads them. Clones share them.
#[derive(Clone, Debug)]
pub struct PackedLinear {
    format: Format,
    /// What notes its inputs, if they are to be known.
    range: Option<InputRange>,
}

#[derive(Clone, Debug)]
enum Format {
    F32(Arc<Panels<f32>>),
    Bf16(Arc<Panels<bf16>>),
    Int8(Arc<Int8Panels>),
}

impl PackedLinear {
    /// Packs `weight` (outputs, inputs), row by row, and `bias` (outputs).
    ///
    /// # Errors
    /// If a slice has another length.
    pub fn new(
        weight: &[f32],
        bias: Option<&[f32]>,
        (outputs, inputs): (usize, usize),
        format: NumberFormat,
    ) -> Result<Self> {
        check_matrix(weight, bias, (outputs, inputs))?;
        let format = match format {
            NumberFormat::F32 => {
                let panels = Panels::pack_transposed(inputs, outputs, bias, weight);
                Format::F32(Arc::new(panels))
            }
            NumberFormat::Bf16 => {
                let panels = Panels::pack_transposed(inputs, outputs, bias, weight);
                Format::Bf16(Arc::new(panels))
            }
            NumberFormat::Int8 => return Self::quantised(weight, bias, (outputs, inputs), None),
        };
        Ok(Self::of(format))
    }

    /// As [`Self::new`] in [`NumberFormat::Int8`], with what is known of the inputs.
    ///
    /// # Errors
    /// If a slice has another length, there are more inputs than sums are exact for, or `smoothing` is not valid.
    pub fn quantised(
        weight: &[f32],
        bias: Option<&[f32]>,
        (outputs, inputs): (usize, usize),
        smoothing: Option<Smoothing<'_>>,
    ) -> Result<Self> {
        check_matrix(weight, bias, (outputs, inputs))?;
        if inputs > MOST_INPUTS {
            let reason = format!("{inputs} inputs, at most {MOST_INPUTS} have exact sums");
            return Err(Error::config("quantised weights", reason));
        }
        let factors = match smoothing {
            Some(smoothing) => smoothing.factors(weight, inputs)?,
            None => vec![1.0; inputs],
        };
        let unit = Int8Unit::detect();
        let panels = Int8Panels::pack(unit, weight, bias, (outputs, inputs), factors);
        Ok(Self::of(Format::Int8(Arc::new(panels))))
    }

    /// A matrix (outputs, inputs) whose packed values ([`PackedLinear::packed_parts`]) lie in a file, and `bias` (outputs).
    ///
    /// # Errors
    /// If there are not as many values as that matrix has packed, they are not aligned, or the bias has another length.
    pub fn from_mapped(
        values: MappedBytes,
        bias: Option<&[f32]>,
        (outputs, inputs): (usize, usize),
        format: NumberFormat,
    ) -> Result<Self> {
        if let Some(bias) = bias {
            check_length("the bias of packed weights", bias, outputs)?;
        }
        let found = values.as_slice().len();
        let packed = match format {
            NumberFormat::F32 => Panels::mapped(inputs, outputs, bias, values)
                .map(|panels| Format::F32(Arc::new(panels))),
            NumberFormat::Bf16 => Panels::mapped(inputs, outputs, bias, values)
                .map(|panels| Format::Bf16(Arc::new(panels))),
            NumberFormat::Int8 => Int8Panels::mapped(&values, bias, (outputs, inputs))
                .map(|panels| Format::Int8(Arc::new(panels))),
        };
        packed.map(Self::of).ok_or_else(|| {
            let reason = format!("{found} bytes, not those of ({outputs}, {inputs}) in {format:?}");
            Error::config("packed weights", reason)
        })
    }

    fn of(format: Format) -> Self {
        Self {
            format,
            range: None,
        }
    }

    /// The same, which notes in `range` what it is multiplied with.
    ///
    /// # Errors
    /// If that is of another number of inputs.
    pub fn noting(self, range: InputRange) -> Result<Self> {
        check_length("the range of a matrix", &range.largest(), self.inputs())?;
        Ok(Self {
            range: Some(range),
            ..self
        })
    }

    /// The weights as they are packed, and what belongs to them, without the bias: parts that are to lie one behind the
    /// other. Of use in the same [`packed_layout`].
    pub fn packed_parts(&self) -> [&[u8]; 3] {
        match &self.format {
            Format::F32(panels) => [bytemuck::cast_slice(&panels.values), &[], &[]],
            Format::Bf16(panels) => [bytemuck::cast_slice(&panels.values), &[], &[]],
            Format::Int8(panels) => panels.parts(),
        }
    }

    /// Bytes of [`Self::packed_parts`].
    pub fn packed_length(&self) -> usize {
        self.packed_parts().iter().map(|part| part.len()).sum()
    }

    /// What the weights are kept in.
    pub fn format(&self) -> NumberFormat {
        match &self.format {
            Format::F32(_) => NumberFormat::F32,
            Format::Bf16(_) => NumberFormat::Bf16,
            Format::Int8(_) => NumberFormat::Int8,
        }
    }

    /// Values of a row of the input.
    pub fn inputs(&self) -> usize {
        match &self.format {
            Format::F32(panels) => panels.depth,
            Format::Bf16(panels) => panels.depth,
            Format::Int8(packed) => packed.panels.depth,
        }
    }

    /// Values of a row of the output.
    pub fn outputs(&self) -> usize {
        match &self.format {
            Format::F32(panels) => panels.outputs,
            Format::Bf16(panels) => panels.outputs,
            Format::Int8(packed) => packed.panels.outputs,
        }
    }

    /// As [`Self::forward`], on all threads of the pool.
    ///
    /// # Panics
    /// As [`Self::forward`].
    pub fn forward_on_pool(&self, x: &[f32], y: &mut [f32]) {
        self.share_out(x, y, |_, x, y| self.write(x, y));
    }

    /// The product of `x` (rows, inputs): (rows, outputs), on all threads of the pool. Each thread calls `then` with the rows that
    /// it has just computed, which are still in its cache, and the number of their first row.
    ///
    /// # Panics
    /// If `x` is not whole rows.
    pub fn product_on_pool_then(
        &self,
        x: &[f32],
        then: impl Fn(&mut [f32], usize) + Sync,
    ) -> Vec<f32> {
        let length = x.len() / self.inputs().max(1) * self.outputs();
        let write = |y: &mut [MaybeUninit<f32>]| {
            self.share_out(x, y, |first, x, y| {
                self.write(x, y);
                // SAFETY: `Self::write` has written every output of these rows (`PanelProduct::product_of_rows`).
                then(unsafe { y.assume_init_mut() }, first);
            });
        };
        // SAFETY: the shares cover all `length` outputs, and each is written.
        unsafe { uncleared(length, write) }
    }

    /// Calls `compute` with equal shares of the rows, on all threads of the pool: the number of a share's first row, its
    /// inputs, and its outputs.
    fn share_out<Y: OutputValue>(
        &self,
        x: &[f32],
        y: &mut [Y],
        compute: impl Fn(usize, &[f32], &mut [Y]) + Sync,
    ) {
        let (inputs, outputs) = (self.inputs().max(1), self.outputs().max(1));
        let rows = y.len() / outputs;
        assert_eq!(x.len(), rows * inputs, "input of a product");
        assert_eq!(y.len(), rows * outputs, "output of a product");
        // Equal shares: one task of a few rows more would read all weights for these alone.
        let threads = rayon::current_num_threads();
        let tasks = threads * rows.div_ceil(threads * ROWS);
        let share = rows.div_ceil(tasks.max(1)).max(1);
        y.par_chunks_mut(share * outputs)
            .zip(x.par_chunks(share * inputs))
            .enumerate()
            .for_each(|(task, (y, x))| compute(task * share, x, y));
    }

    /// Writes the product of `x` (rows, inputs) to `y` (rows, outputs), on the calling thread.
    ///
    /// # Panics
    /// If `x` is not whole rows, or `y` has another number of them.
    pub fn forward(&self, x: &[f32], y: &mut [f32]) {
        self.write(x, y);
    }

    fn write(&self, x: &[f32], y: &mut [impl OutputValue]) {
        if let Some(range) = &self.range {
            range.note(x);
        }
        match &self.format {
            Format::F32(panels) => f32::product(panels, x, y),
            Format::Bf16(panels) => bf16::product(panels, x, y),
            Format::Int8(packed) => {
                let (x, y) = Rows::contiguous((x, self.inputs()), (y, self.outputs()));
                packed.product_of_rows(x, y);
            }
        }
    }
}

fn check_matrix(
    weight: &[f32],
    bias: Option<&[f32]>,
    (outputs, inputs): (usize, usize),
) -> Result<()> {
    check_length(
        "the weight to be packed",
        weight,
        outputs.saturating_mul(inputs),
    )?;
    match bias {
        Some(bias) => check_length("the bias to be packed", bias, outputs),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inputs_are_noted_by_every_task() {
        let range = InputRange::new(2);
        let linear = PackedLinear::new(&[1.0; 6], None, (3, 2), NumberFormat::F32).unwrap();
        let linear = linear.noting(range.clone()).unwrap();
        let x: Vec<f32> = (0..1000).map(|i| i as f32).collect();
        linear.forward_on_pool(&x, &mut vec![0.0; 1500]);
        assert_eq!(range.largest(), [998.0, 999.0]);
        assert!(linear.noting(InputRange::new(3)).is_err());
    }

    #[test]
    fn product_on_pool_passes_every_row_once() {
        let (inputs, outputs) = (33, 70);
        let value = |i: usize| ((i * 7919) % 2003) as f32 / 1001.0 - 1.0;
        let weight: Vec<f32> = (0..inputs * outputs).map(value).collect();
        for format in [NumberFormat::F32, NumberFormat::Bf16, NumberFormat::Int8] {
            let linear = PackedLinear::new(&weight, None, (outputs, inputs), format).unwrap();
            for rows in [0, 1, 2 * ROWS + 3] {
                let x: Vec<f32> = (0..rows * inputs).map(value).collect();
                let add = |part: &mut [f32], first: usize| {
                    for (i, row) in part.chunks_exact_mut(outputs).enumerate() {
                        row[0] += (first + i) as f32;
                    }
                };
                let mut expected = vec![f32::NAN; rows * outputs];
                linear.forward(&x, &mut expected);
                add(&mut expected, 0);
                let found = linear.product_on_pool_then(&x, add);
                assert_eq!(found, expected, "{format:?}, {rows} rows");
            }
        }
    }

    /// An input that is a hundred times larger than the others, as transformers have them.
    #[test]
    fn smoothing_leaves_room_beside_a_large_input() {
        let (rows, inputs, outputs) = (32, 64, 48);
        let value = |i: usize| ((i * 7919) % 2003) as f32 / 1001.0 - 1.0;
        let weight: Vec<f32> = (0..inputs * outputs).map(|i| value(i + 5) / 8.0).collect();
        let x: Vec<f32> = (0..rows * inputs)
            .map(|i| value(i) * if i % inputs == 3 { 100.0 } else { 1.0 })
            .collect();
        let mut largest = vec![0f32; inputs];
        for row in x.chunks_exact(inputs) {
            for (most, v) in largest.iter_mut().zip(row) {
                *most = most.max(v.abs());
            }
        }
        let run = |linear: PackedLinear| {
            let mut y = vec![0.0; rows * outputs];
            linear.forward(&x, &mut y);
            y
        };
        let shape = (outputs, inputs);
        let exact = run(PackedLinear::new(&weight, None, shape, NumberFormat::F32).unwrap());
        let error = |smoothing| {
            let found = run(PackedLinear::quantised(&weight, None, shape, smoothing).unwrap());
            let squares = found.iter().zip(&exact).map(|(a, b)| (a - b).powi(2));
            squares.sum::<f32>().sqrt()
        };
        let smoothing = Smoothing {
            largest: &largest,
            strength: 0.5,
        };
        let (plain, smoothed) = (error(None), error(Some(smoothing)));
        assert!(smoothed < plain / 3.0, "{smoothed}, without {plain}");
    }

    #[test]
    fn too_many_inputs_for_exact_sums_are_refused() {
        let inputs = MOST_INPUTS + 1;
        let weight = vec![0.0; inputs];
        let error = PackedLinear::quantised(&weight, None, (1, inputs), None).unwrap_err();
        assert!(error.to_string().contains(&inputs.to_string()), "{error}");
    }

    #[test]
    fn a_weight_of_another_size_is_refused() {
        let error = PackedLinear::new(&[0.0; 5], None, (2, 3), NumberFormat::F32).unwrap_err();
        assert!(error.to_string().contains("[6]"), "{error}");
    }
}
