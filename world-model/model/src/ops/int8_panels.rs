//! Matrices of 8 bits, and the rows that are multiplied with them.
//!
//! Every output of a matrix has a scale, and so has every row of the input: both are what the largest absolute value is
//! 127 times of. Zero is zero, and nothing is added to what is rounded: symmetric quantisation. Sums are whole numbers, and
//! exact, so that all processors give the same bits.
//!
//! Rows are multiplied with a factor for each input before they are rounded, and the weights of that input divided by it
//! before they are: [`Smoothing`](super::Smoothing).

use std::cell::RefCell;

use rayon::prelude::*;

use super::element::{Element, INT8_MOST};
use super::panel_product::{Rows, ahead, check, row};
use super::panel_values::MappedBytes;
use super::panels::Panels;
use super::product::{Int8, Int8Scales};
use super::simd::{Int8Unit, LANES};
use super::vectorised::vectorised;

/// Inputs of a matrix at most: so many products of two bytes are within an i32, whatever they are.
pub(super) const MOST_INPUTS: usize = (i32::MAX / (127 * 127)) as usize;

/// Values that are all smaller are taken for zeros: their scale would be no normal number, or its inverse infinite.
const LEAST: f32 = 128.0 * f32::MIN_POSITIVE;

/// Added to a number of less than 22 bits, it leaves the nearest whole number (and the even one of two) in the lowest bits.
const TO_WHOLE: f32 = 1.5 * (1 << 23) as f32;

thread_local! {
    /// Rows that were rounded, and their scales.
    static ROUNDED: RefCell<(Vec<i8>, Vec<f32>)> = const { RefCell::new((Vec::new(), Vec::new())) };
}

/// A matrix (inputs x outputs) of bytes with its bias, for one unit of a processor.
#[derive(Clone, Debug)]
pub(crate) struct Int8Panels {
    unit: Int8Unit,
    pub(super) panels: Panels<i8>,
    /// What a weight of 1 stands for, for every output, padded to whole vectors.
    pub(super) scales: Vec<f32>,
    /// What every input is multiplied with before it is rounded.
    pub(super) factors: Vec<f32>,
    /// Where the sums start, padded to whole vectors.
    starts: Vec<i32>,
}

impl Int8Panels {
    /// Packs `weight` (outputs, inputs) and `bias` for `unit`, on all threads of the pool. There is a factor for every
    /// input.
    pub(super) fn pack(
        unit: Int8Unit,
        weight: &[f32],
        bias: Option<&[f32]>,
        (outputs, inputs): (usize, usize),
        factors: Vec<f32>,
    ) -> Self {
        let mut whole = vec![0.0; weight.len()];
        let mut scales = vec![0.0; outputs.next_multiple_of(LANES)];
        let width = inputs.max(1);
        let rows = whole
            .par_chunks_mut(width)
            .zip(weight.par_chunks(width))
            .zip(&mut scales);
        rows.for_each(|((whole, weight), scale)| {
            for ((whole, weight), factor) in whole.iter_mut().zip(weight).zip(&factors) {
                *whole = weight / factor;
            }
            let mut largest = 0;
            largest_bits(whole, None, &mut largest);
            let of_one;
            (*scale, of_one) = scale_of(largest);
            for value in whole {
                *value *= of_one;
            }
        });
        let most = unit.tile_vectors();
        let panels = Panels::pack_transposed_in(most, (inputs, outputs), bias, &whole);
        Self::new(unit, panels, scales, factors)
    }

    /// A matrix (outputs, inputs) that was packed for this machine and lies in a file, as [`Self::parts`] gives it; `None`
    /// if it is another's.
    pub(super) fn mapped(
        bytes: &MappedBytes,
        bias: Option<&[f32]>,
        (outputs, inputs): (usize, usize),
    ) -> Option<Self> {
        let unit = Int8Unit::detect();
        let scales = outputs.checked_next_multiple_of(LANES)?;
        let behind = scales.checked_add(inputs)?.checked_mul(size_of::<f32>())?;
        let values = bytes.as_slice().len().checked_sub(behind)?;
        let (values, behind) = bytes.split_at(values)?;
        let panels = Panels::mapped_in(unit.tile_vectors(), (inputs, outputs), bias, values)?;
        let behind: &[f32] = bytemuck::try_cast_slice(behind.as_slice()).ok()?;
        let (scales, factors) = behind.split_at_checked(scales)?;
        Some(Self::new(unit, panels, scales.to_vec(), factors.to_vec()))
    }

    fn new(unit: Int8Unit, panels: Panels<i8>, scales: Vec<f32>, factors: Vec<f32>) -> Self {
        let starts = match unit.input_offset() {
            0 => vec![0; panels.bias.len()],
            // Wraps, as the sums do.
            offset => sums(&panels)
                .into_iter()
                .map(|sum| sum.wrapping_mul(-offset))
                .collect(),
        };
        Self {
            unit,
            panels,
            scales,
            factors,
            starts,
        }
    }

    /// All of it but the bias, one behind the other: weights, their scales, the inputs' factors.
    pub(super) fn parts(&self) -> [&[u8]; 3] {
        [
            bytemuck::cast_slice(&self.panels.values),
            bytemuck::cast_slice(&self.scales),
            bytemuck::cast_slice(&self.factors),
        ]
    }

    /// `y` (rows of outputs) = `x` (as many rows of inputs) times the matrix, plus its bias. A row that has a value which is
    /// not finite gives no numbers.
    ///
    /// # Panics
    /// If the rows do not lie within the values, or their numbers differ.
    pub(super) fn product_of_rows(&self, x: Rows<&[f32]>, y: Rows<&mut [f32]>) {
        let panels = &self.panels;
        let target = check(panels, x, y);
        let (depth, whole) = (panels.depth, panels.whole_depth());
        ROUNDED.with_borrow_mut(|(rounded, scales)| {
            if rounded.len() < x.count * whole {
                rounded.resize(x.count * whole, 0);
            }
            if scales.len() < x.count {
                scales.resize(x.count, 0.0);
            }
            let sources = x.values.chunks(x.step.max(1)).zip(scales.iter_mut());
            let targets = rounded.chunks_exact_mut(whole.max(1));
            for ((x, scale), rounded) in sources.zip(targets).take(x.count) {
                if let (Some(x), Some(rounded)) = (x.get(..depth), rounded.get_mut(..depth)) {
                    *scale = self.round(x, rounded);
                }
            }
            for place in panels.iter() {
                ahead(panels, place);
                let weights = panels.values.as_ptr().wrapping_add(place.1);
                let input = (rounded.as_ptr(), whole, whole);
                let scales = Int8Scales {
                    inputs: scales.as_ptr(),
                    weights: self.scales.as_ptr().wrapping_add(place.2),
                    starts: self.starts.as_ptr().wrapping_add(place.2),
                };
                let row = row::<Int8>(input, weights, panels, place, target, scales);
                // SAFETY: the lengths were checked above, and those of the panels, scales and starts hold by
                // construction; there is a rounded row, and its scale, for every row; the panels were cut for the unit,
                // which the processor was found to have.
                unsafe { row.run(self.unit) };
            }
        });
    }

    /// Rounds a row for the unit; gives its scale.
    fn round(&self, x: &[f32], rounded: &mut [i8]) -> f32 {
        let mut largest = 0;
        largest_bits(x, Some(&self.factors), &mut largest);
        let (scale, of_one) = scale_of(largest);
        round_row(x, &self.factors, of_one, self.unit.input_offset(), rounded);
        scale
    }
}

/// The scale of values of which the largest absolute one has these bits, and what they are to be multiplied with to be
/// rounded: no number and 0 if one is not finite.
fn scale_of(largest_bits: u32) -> (f32, f32) {
    let largest = f32::from_bits(largest_bits);
    if !largest.is_finite() {
        (f32::NAN, 0.0)
    } else if largest < LEAST {
        (0.0, 0.0)
    } else {
        (largest / INT8_MOST, INT8_MOST / largest)
    }
}

vectorised! {
    /// The bits of the largest absolute value of `values` (times `factors`): as whole numbers they are in the order of the
    /// values, what is not finite above everything.
    fn largest_bits(values: &[f32], factors: Option<&[f32]>, largest: &mut u32) {
        const SIGN: u32 = 1 << 31;
        let mut most = 0;
        match factors {
            Some(factors) => {
                for (value, factor) in values.iter().zip(factors) {
                    most = most.max((value * factor).to_bits() & !SIGN);
                }
            }
            None => {
                for value in values {
                    most = most.max(value.to_bits() & !SIGN);
                }
            }
        }
        *largest = most;
    }
}

vectorised! {
    /// Rounds `values` times `factors` times `of_one`, and adds `offset`.
    fn round_row(values: &[f32], factors: &[f32], of_one: f32, offset: i32, out: &mut [i8]) {
        for ((value, factor), out) in values.iter().zip(factors).zip(out) {
            // The largest becomes 127, but for errors of less than half; what is not finite becomes anything.
            let bits = (value * factor * of_one + TO_WHOLE).to_bits();
            *out = bits.wrapping_add(offset.cast_unsigned()) as i8;
        }
    }
}

/// Sum of the weights of every output, padded to whole vectors.
fn sums(panels: &Panels<i8>) -> Vec<i32> {
    let mut sums = vec![0; panels.bias.len()];
    let places: Vec<(usize, usize, usize)> = panels.iter().collect();
    let depth = panels.whole_depth();
    let mut rest = sums.as_mut_slice();
    let mut parts = Vec::with_capacity(places.len());
    for (vectors, start, _) in places {
        let width = vectors * LANES;
        let (part, after) = rest.split_at_mut(width);
        rest = after;
        let panel = panels.values.get(start..start + depth * width);
        parts.push((part, panel.unwrap_or_default()));
    }
    parts.into_par_iter().for_each(|(sums, panel)| {
        for rows in panel.chunks_exact(i8::GROUP * sums.len()) {
            for (sum, group) in sums.iter_mut().zip(rows.as_chunks::<{ i8::GROUP }>().0) {
                *sum += group.iter().map(|w| i32::from(*w)).sum::<i32>();
            }
        }
    });
    sums
}

#[cfg(test)]
pub(super) mod tests;
