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
use super::kernel::{Prefetch, Product, Row};
use super::panel_product::{OutputValue, Rows, Target, check, row};
use super::panel_values::MappedBytes;
use super::panels::Panels;
#[cfg(target_arch = "x86_64")]
use super::product::WidenedInt8;
use super::product::{Int8, WholeScales};
use super::simd::{Int8Unit, LANES};
use super::vectorised::vectorised;

/// Inputs of a matrix at most: so many products of two bytes are within an i32, whatever they are.
pub(super) const MOST_INPUTS: usize = (i32::MAX / (127 * 127)) as usize;

/// Values that are all smaller are taken for zeros: their scale would be no normal number, or its inverse infinite.
const LEAST: f32 = 128.0 * f32::MIN_POSITIVE;

/// Added to a number of less than 22 bits, it leaves the nearest whole number (and the even one of two) in the lowest bits.
const TO_WHOLE: f32 = 1.5 * (1 << 23) as f32;

thread_local! {
    /// Rows that were rounded.
    static ROUNDED: RefCell<Rounded> = const { RefCell::new(Rounded::new()) };
}

/// Buffers of a thread; they only ever grow.
struct Rounded {
    /// Rows for a unit that multiplies bytes.
    bytes: Vec<i8>,
    /// Rows, and a panel, for one that multiplies 16 bits.
    #[cfg(target_arch = "x86_64")]
    words: Vec<i16>,
    #[cfg(target_arch = "x86_64")]
    panel: Vec<i16>,
    /// Scales of the rows.
    scales: Vec<f32>,
}

impl Rounded {
    const fn new() -> Self {
        Self {
            bytes: Vec::new(),
            #[cfg(target_arch = "x86_64")]
            words: Vec::new(),
            #[cfg(target_arch = "x86_64")]
            panel: Vec::new(),
            scales: Vec::new(),
        }
    }
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

    /// `y` (rows of outputs) = `x` (as many rows of inputs) times the matrix, plus its bias. Writes every output of the rows, and
    /// reads none that it has not written. A row that has a value which is
    /// not finite gives no numbers.
    ///
    /// # Panics
    /// If the rows do not lie within the values, or their numbers differ.
    pub(super) fn product_of_rows(&self, x: Rows<&[f32]>, y: Rows<&mut [impl OutputValue]>) {
        let target = check((self.panels.depth, self.panels.outputs), x, y);
        ROUNDED.with_borrow_mut(|buffers| match self.unit {
            Int8Unit::Bytes(unit) => {
                let Rounded { bytes, scales, .. } = buffers;
                let offset = self.unit.input_offset();
                let rows = self.round(x, (bytes, scales), |x, of_one, out| {
                    round_row(x, &self.factors, of_one, offset, out);
                });
                self.by_panel::<Int8>(unit, rows, target, |values| values.as_ptr());
            }
            #[cfg(target_arch = "x86_64")]
            Int8Unit::Avx2 => {
                let Rounded {
                    words,
                    panel,
                    scales,
                    ..
                } = buffers;
                let rows = self.round(x, (words, scales), |x, of_one, out| {
                    round_row_apart(x, &self.factors, of_one, out);
                });
                self.by_panel::<WidenedInt8>((), rows, target, |values| {
                    grow(panel, values.len());
                    widen_apart(values, panel);
                    panel.as_ptr()
                });
            }
        });
    }

    /// Rounds rows into buffers: they, and their scales.
    fn round<'a, T: Element + Default>(
        &self,
        x: Rows<&[f32]>,
        (rounded, scales): (&'a mut Vec<T>, &'a mut Vec<f32>),
        round: impl Fn(&[f32], f32, &mut [T]),
    ) -> (&'a [T], &'a [f32]) {
        let (depth, whole) = (self.panels.depth, self.panels.whole_depth());
        grow(rounded, x.count * whole);
        grow(scales, x.count);
        let sources = x.values.chunks(x.step.max(1)).zip(scales.iter_mut());
        let targets = rounded.chunks_exact_mut(whole.max(1));
        for ((x, scale), rounded) in sources.zip(targets).take(x.count) {
            if let Some(x) = x.get(..depth) {
                let mut largest = 0;
                largest_bits(x, Some(&self.factors), &mut largest);
                let of_one;
                (*scale, of_one) = scale_of(largest);
                // What fills the last group up stays as it was: its weights are zeros.
                round(x, of_one, rounded);
            }
        }
        (rounded, scales)
    }

    /// The products of rounded rows with all panels, each of which `weights` gives as the product takes it.
    fn by_panel<P: Product<Scales = WholeScales>>(
        &self,
        unit: P::Unit,
        (rounded, scales): (&[P::Input], &[f32]),
        target: Target,
        mut weights: impl FnMut(&[i8]) -> *const P::Weight,
    ) {
        let panels = &self.panels;
        let whole = panels.whole_depth();
        let values = |(vectors, start, _): (usize, usize, usize)| {
            let values = panels.values.get(start..start + whole * vectors * LANES);
            values.unwrap_or_default()
        };
        let mut places = panels.iter().peekable();
        while let Some(place) = places.next() {
            let (_, _, first) = place;
            let weights = weights(values(place));
            let scales = WholeScales {
                inputs: scales.as_ptr(),
                weights: self.scales.as_ptr().wrapping_add(first),
                starts: self.starts.as_ptr().wrapping_add(first),
            };
            let input = (rounded.as_ptr(), whole, whole);
            let row = Row {
                prefetch: places
                    .peek()
                    .map_or(Prefetch::NOTHING, |next| Prefetch::of(values(*next))),
                ..row::<P>(input, weights, panels, place, target, scales)
            };
            // SAFETY: the lengths were checked by the caller, and those of the panels, scales and starts hold by
            // construction; there is a rounded row, and its scale, for every row; the panels were cut for the unit, which
            // the processor was found to have.
            unsafe { row.run(unit) };
        }
    }
}

fn grow<T: Copy + Default>(buffer: &mut Vec<T>, length: usize) {
    if buffer.len() < length {
        buffer.resize(length, T::default());
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

/// A value of which 1 is `of_one` times, as the lowest bits of a whole number. The largest of a row becomes 127, but for errors
/// of less than half; what is not finite becomes anything.
#[inline(always)]
fn rounded(value: f32, factor: f32, of_one: f32) -> u32 {
    (value * factor * of_one + TO_WHOLE).to_bits()
}

vectorised! {
    /// Rounds `values` times `factors` times `of_one`, and adds `offset`.
    fn round_row(values: &[f32], factors: &[f32], of_one: f32, offset: i32, out: &mut [i8]) {
        for ((value, factor), out) in values.iter().zip(factors).zip(out) {
            *out = rounded(*value, *factor, of_one).wrapping_add(offset.cast_unsigned()) as i8;
        }
    }
}

#[cfg(target_arch = "x86_64")]
vectorised! {
    /// Rounds `values` times `factors` times `of_one`. Of every four the first and the third lie side by side, and the second
    /// and the fourth: in that order bytes are widened fastest.
    fn round_row_apart(values: &[f32], factors: &[f32], of_one: f32, out: &mut [i16]) {
        let (fours, rest) = values.as_chunks::<4>();
        let (of_fours, of_rest) = factors.as_chunks::<4>();
        let (out, _) = out.as_chunks_mut::<4>();
        for ((v, f), out) in fours.iter().zip(of_fours).zip(out.iter_mut()) {
            let at = |k: usize| i16::from(rounded(v[k], f[k], of_one) as i8);
            *out = [at(0), at(2), at(1), at(3)];
        }
        if let Some(out) = out.get_mut(fours.len()) {
            for (((v, f), place), _) in rest.iter().zip(of_rest).zip([0, 2, 1, 3]).zip(0..4) {
                out[place] = i16::from(rounded(*v, *f, of_one) as i8);
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
vectorised! {
    /// Writes the groups of a panel (four bytes for each of [`LANES`] outputs) as 16-bit numbers: for each output the first
    /// and the third, and behind them for each the second and the fourth.
    fn widen_apart(bytes: &[i8], words: &mut [i16]) {
        let groups = bytes.chunks_exact(4 * LANES);
        for (group, words) in groups.zip(words.chunks_exact_mut(4 * LANES)) {
            let (even, odd) = words.split_at_mut(2 * LANES);
            let pairs = group.as_chunks::<2>().0.iter();
            for ((pair, even), odd) in pairs.zip(even).zip(odd) {
                // By shifts, which the compiler vectorises.
                let pair = i16::from_le_bytes(pair.map(i8::cast_unsigned));
                *even = (pair << 8) >> 8;
                *odd = pair >> 8;
            }
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
