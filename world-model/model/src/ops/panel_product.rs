//! Rows times a matrix in panels, on the calling thread.

use std::cell::RefCell;
use std::mem::MaybeUninit;

use half::bf16;

use super::element::{Element, Float, widen};
use super::kernel::{Prefetch, Product, Row, l2_cache_size};
use super::panels::Panels;
use super::product::{Bf16, F32};
use super::simd::{Bf16Unit, LANES};

/// With fewer rows, a panel is read too few times for a cache to matter.
const FEW_ROWS: usize = 32;

/// Bytes of weights in a piece at most. On Zen 5, 128 KiB were slower, and larger pieces gained nothing.
const LARGEST_PIECE: usize = 256 << 10;

thread_local! {
    /// Rows that were rounded to bf16.
    static ROUNDED: RefCell<Vec<bf16>> = const { RefCell::new(Vec::new()) };
    /// A panel of bf16 as f32.
    static WIDENED: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
}

/// Rows of a product, the first at the front of `values`, that lie `step` values apart.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rows<Values> {
    pub(crate) values: Values,
    pub(crate) step: usize,
    pub(crate) count: usize,
}

impl<'x> Rows<&'x [f32]> {
    /// Rows of `x` and `y` of these widths that follow each other.
    ///
    /// # Panics
    /// If `x` is not whole rows, or `y` has another number of them.
    pub(crate) fn contiguous<'y, Y: OutputValue>(
        (x, inputs): (&'x [f32], usize),
        (y, outputs): (&'y mut [Y], usize),
    ) -> (Self, Rows<&'y mut [Y]>) {
        let count = x.len() / inputs.max(1);
        assert_eq!(x.len(), count * inputs, "input of a product");
        assert_eq!(y.len(), count * outputs, "output of a product");
        let x = Rows {
            values: x,
            step: inputs,
            count,
        };
        let y = Rows {
            values: y,
            step: outputs,
            count,
        };
        (x, y)
    }
}

/// What a product writes its outputs to.
///
/// # Safety
/// It must have the layout of f32, and every f32 must be a valid value of it.
pub(crate) unsafe trait OutputValue: Send {}

// SAFETY: it is f32.
unsafe impl OutputValue for f32 {}

// SAFETY: it has the layout of f32, and any bits are valid.
unsafe impl OutputValue for MaybeUninit<f32> {}

/// Panels of a format that rows are multiplied with.
pub(crate) trait PanelProduct: Float {
    /// `y` (rows of outputs) = `x` (as many rows of inputs) times a packed matrix, plus its bias. Writes every output of the rows,
    /// and reads none that it has not written.
    ///
    /// # Panics
    /// If the rows do not lie within the values, or their numbers differ.
    fn product_of_rows<Y: OutputValue>(panels: &Panels<Self>, x: Rows<&[f32]>, y: Rows<&mut [Y]>);

    /// As [`Self::product_of_rows`] for `x` (rows, inputs) and `y` (rows, outputs).
    ///
    /// # Panics
    /// If `x` is not whole rows, or `y` has another number of them.
    fn product<Y: OutputValue>(panels: &Panels<Self>, x: &[f32], y: &mut [Y]) {
        let (x, y) = Rows::contiguous((x, panels.depth), (y, panels.outputs));
        Self::product_of_rows(panels, x, y);
    }
}

impl PanelProduct for f32 {
    fn product_of_rows<Y: OutputValue>(panels: &Panels<f32>, x: Rows<&[f32]>, y: Rows<&mut [Y]>) {
        product_as_is::<F32>(panels.set, panels, x, y);
    }
}

impl PanelProduct for bf16 {
    fn product_of_rows<Y: OutputValue>(panels: &Panels<bf16>, x: Rows<&[f32]>, y: Rows<&mut [Y]>) {
        match Bf16Unit::detect() {
            Some(unit) => rounded(unit, panels, x, y),
            None => widened(panels, x, y),
        }
    }
}

/// With inputs rounded to bf16, by the processor's products of bf16.
fn rounded(
    unit: Bf16Unit,
    panels: &Panels<bf16>,
    x: Rows<&[f32]>,
    y: Rows<&mut [impl OutputValue]>,
) {
    let target = check((panels.depth, panels.outputs), x, y);
    let rows = x.count;
    let (depth, whole) = (panels.depth.max(1), panels.whole_depth().max(1));
    ROUNDED.with_borrow_mut(|buffer| {
        if buffer.len() < rows * whole {
            buffer.resize(rows * whole, bf16::ZERO);
        }
        if depth == whole && x.step == depth {
            bf16::round(x.values, buffer);
        } else {
            let sources = x.values.chunks(x.step.max(1));
            for (x, out) in sources.zip(buffer.chunks_exact_mut(whole)).take(rows) {
                if let (Some(x), Some((inside, rest))) =
                    (x.get(..depth), out.split_at_mut_checked(depth))
                {
                    bf16::round(x, inside);
                    // What fills the group up may be left from an earlier product, and no number.
                    rest.fill(bf16::ZERO);
                }
            }
        }
        // SAFETY: the buffer has `rows` rows of `whole` values, and the target as many of the outputs.
        unsafe { by_panel::<Bf16>(unit, panels, (buffer.as_ptr(), whole), target) };
    });
}

/// `y` (rows of outputs) = `x` (as many rows of [`Panels::whole_depth`] inputs, as `unit` takes them) times a packed matrix,
/// plus its bias.
///
/// # Panics
/// If the rows do not lie within the values, or their numbers differ.
pub(crate) fn product_as_is<P: Product<Scales = ()>>(
    unit: P::Unit,
    panels: &Panels<P::Weight>,
    x: Rows<&[P::Input]>,
    y: Rows<&mut [impl OutputValue]>,
) {
    let whole = panels.whole_depth();
    let target = check((whole, panels.outputs), x, y);
    // SAFETY: the lengths were checked, and units are made of what the processor was found to have.
    unsafe { by_panel::<P>(unit, panels, (x.values.as_ptr(), x.step), target) };
}

/// The products of rows, the first at `input.0` and `input.1` values apart, with all panels.
///
/// # Safety
/// At `input` must be as many rows as `target` has, of [`Panels::whole_depth`] values, and the processor must have `unit`.
unsafe fn by_panel<P: Product<Scales = ()>>(
    unit: P::Unit,
    panels: &Panels<P::Weight>,
    input: (*const P::Input, usize),
    target: Target,
) {
    let mut pieces = panels.pieces(target.count).peekable();
    while let Some(piece) = pieces.next() {
        let prefetch = pieces.peek().map_or(Prefetch::NOTHING, |next| {
            Prefetch::of(panels.values_of(*next))
        });
        let from = input.0.wrapping_add(piece.from);
        let weights = panels.values_of(piece).as_ptr();
        let row = Row {
            accumulates: piece.from > 0,
            prefetch,
            ..row::<P>(
                (from, input.1, piece.inputs),
                weights,
                panels,
                piece.place,
                target,
                (),
            )
        };
        // SAFETY: as for this function; the lengths of the panels hold by construction, and they were cut for the unit.
        unsafe { row.run(unit) };
    }
}

/// Some inputs of a panel.
#[derive(Clone, Copy)]
struct Piece {
    /// The panel, as [`Panels::iter`] has it.
    place: (usize, usize, usize),
    /// The first input.
    from: usize,
    inputs: usize,
}

impl<T: Element> Panels<T> {
    /// The pieces that `rows` rows are multiplied with, in order. The weights of a piece and of the next take at most half of the L2
    /// cache.
    fn pieces(&self, rows: usize) -> impl Iterator<Item = Piece> {
        let whole = self.whole_depth();
        let panel = T::tile_vectors() * LANES * size_of::<T>();
        // Whole panels, unless they are too large. AMX cannot accumulate onto outputs, so bf16 and int8 take whole panels.
        let inputs = match (l2_cache_size() / 4).min(LARGEST_PIECE) / panel {
            most @ 1.. if T::GROUP == 1 && rows >= FEW_ROWS => {
                whole.div_ceil(whole.div_ceil(most).max(1))
            }
            _ => whole,
        };
        let starts = (0..whole.max(1)).step_by(inputs.max(1));
        starts.flat_map(move |from| {
            self.iter().filter_map(move |place| {
                let (vectors, _, first) = place;
                let (is_first, is_full) = (from == 0, first + vectors * LANES <= self.outputs);
                let inputs = match is_full {
                    true => inputs.min(whole - from),
                    // Padding has no outputs to accumulate onto.
                    false => whole,
                };
                (is_first || is_full).then_some(Piece {
                    place,
                    from,
                    inputs,
                })
            })
        })
    }

    fn values_of(&self, piece: Piece) -> &[T] {
        let (vectors, start, _) = piece.place;
        let width = vectors * LANES;
        let values = self.values.get(start + piece.from * width..);
        let values = values.and_then(|values| values.get(..piece.inputs * width));
        values.unwrap_or_default()
    }
}

/// With weights widened to f32, a panel at a time, which all rows are multiplied with.
fn widened(panels: &Panels<bf16>, x: Rows<&[f32]>, y: Rows<&mut [impl OutputValue]>) {
    let target = check((panels.depth, panels.outputs), x, y);
    WIDENED.with_borrow_mut(|buffer| {
        for place in panels.iter() {
            let (vectors, start, _) = place;
            let count = panels.whole_depth() * vectors * LANES;
            if buffer.len() < count {
                buffer.resize(count, 0.0);
            }
            if let Some(pairs) = panels.values.get(start..start + count) {
                widen(pairs, vectors * LANES, buffer);
            }
            let input = (x.values.as_ptr(), x.step, panels.depth);
            let row = row::<F32>(input, buffer.as_ptr(), panels, place, target, ());
            // SAFETY: as above; the buffer has a row of weights for every input.
            unsafe { row.run(panels.set) };
        }
    });
}

/// Rows of outputs that were found to be long enough.
#[derive(Clone, Copy)]
pub(super) struct Target {
    values: *mut f32,
    step: usize,
    count: usize,
}

/// Where a product of rows of these widths is to be written. The kernel trusts the lengths.
pub(super) fn check<X>(
    (inputs, outputs): (usize, usize),
    x: Rows<&[X]>,
    y: Rows<&mut [impl OutputValue]>,
) -> Target {
    let holds = |length: usize, step: usize, width: usize| {
        x.count == 0 || (step >= width && (x.count - 1) * step + width <= length)
    };
    assert!(holds(x.values.len(), x.step, inputs), "input of a product");
    assert!(
        y.count == x.count && holds(y.values.len(), y.step, outputs),
        "output of a product"
    );
    Target {
        values: y.values.as_mut_ptr().cast(),
        step: y.step,
        count: y.count,
    }
}

/// The product of rows of `run` values, `step` apart, with one panel.
pub(super) fn row<P: Product>(
    (input, step, run): (*const P::Input, usize, usize),
    panel: *const P::Weight,
    panels: &Panels<impl Element>,
    (vectors, _, first): (usize, usize, usize),
    target: Target,
    scales: P::Scales,
) -> Row<P> {
    Row {
        input,
        input_step: step,
        tap_pitch: 0,
        tap_rows: 1,
        run,
        panel,
        vectors,
        bias: panels.bias.as_ptr().wrapping_add(first),
        scales,
        pixels: target.count,
        output: target.values.wrapping_add(first),
        residual: std::ptr::null(),
        mask: std::ptr::null(),
        output_step: target.step,
        channels: (panels.outputs - first).min(vectors * LANES),
        relu: false,
        accumulates: false,
        prefetch: Prefetch::NOTHING,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(count: usize, seed: usize) -> Vec<f32> {
        (0..count)
            .map(|i| ((i * 7919 + seed) % 2003) as f32 / 1001.0 - 1.0)
            .collect()
    }

    fn check_product(
        what: &str,
        (rows, inputs, outputs): (usize, usize, usize),
        (rounds_inputs, rounds_weights): (bool, bool),
        product: impl Fn((&[f32], &[f32]), Rows<&[f32]>, Rows<&mut [f32]>),
    ) {
        // Rows that lie apart; between them is what must not be read or written.
        let (x_step, y_step) = (inputs + 3, outputs + 2);
        let mut x = numbers(rows * x_step, 1);
        for row in x.chunks_exact_mut(x_step) {
            row[inputs..].fill(f32::NAN);
        }
        let (w, bias) = (numbers(outputs * inputs, 2), numbers(outputs, 3));
        let mut y = vec![7.0; rows * y_step];
        let of = |values, step| Rows {
            values,
            step,
            count: rows,
        };
        let target = Rows {
            values: y.as_mut_slice(),
            step: y_step,
            count: rows,
        };
        product((&w, &bias), of(x.as_slice(), x_step), target);
        let as_used = |value: f32, is_rounded: bool| -> f64 {
            let rounded = bf16::from_f32(value).to_f32();
            f64::from(if is_rounded { rounded } else { value })
        };
        for (row, y) in y.chunks_exact(y_step).enumerate() {
            assert_eq!(y[outputs..], [7.0; 2], "{what}: wrote too far");
            for (n, y) in y[..outputs].iter().enumerate() {
                let sum: f64 = (0..inputs)
                    .map(|k| {
                        as_used(x[row * x_step + k], rounds_inputs)
                            * as_used(w[n * inputs + k], rounds_weights)
                    })
                    .sum();
                let error = (sum + f64::from(bias[n]) - f64::from(*y)).abs();
                assert!(
                    error < 1e-4,
                    "{what} {rows} x {inputs} x {outputs}: {error}"
                );
            }
        }
    }

    #[test]
    fn products_are_those_of_the_definition() {
        for shape in [
            (1, 5, 3),
            (7, 16, 64),
            (64, 33, 100),
            (19, 128, 48),
            (33, 70, 130),
        ] {
            let (_, inputs, outputs) = shape;
            check_product("f32", shape, (false, false), |(w, bias), x, y| {
                let panels = Panels::pack_transposed(inputs, outputs, Some(bias), w);
                f32::product_of_rows(&panels, x, y);
            });
            check_product("bf16, widened", shape, (false, true), |(w, bias), x, y| {
                let panels = Panels::pack_transposed(inputs, outputs, Some(bias), w);
                widened(&panels, x, y);
            });
            let units = Bf16Unit::ALL.iter().copied();
            for unit in units.filter(|unit| unit.can_be_tested()) {
                check_product(unit.name(), shape, (true, true), |(w, bias), x, y| {
                    let panels = Panels::pack_transposed(inputs, outputs, Some(bias), w);
                    // What an earlier, larger product leaves must not matter.
                    ROUNDED.with_borrow_mut(|buffer| {
                        buffer.clear();
                        buffer.resize(100_000, bf16::NAN);
                    });
                    rounded(unit, &panels, x, y);
                });
            }
        }
    }
    /// Many rows take pieces of deep panels, few rows whole panels.
    #[test]
    fn pieces_change_no_bit() {
        // The last panel has padding, and the last piece is shorter.
        let (rows, inputs, outputs) = (2 * FEW_ROWS - 2, 3001, 130);
        let (x, w) = (numbers(rows * inputs, 1), numbers(outputs * inputs, 2));
        let bias = numbers(outputs, 3);
        let panels = Panels::pack_transposed(inputs, outputs, Some(&bias), &w);
        let mut together = vec![0.0; rows * outputs];
        f32::product(&panels, &x, &mut together);
        let mut apart = vec![0.0; rows * outputs];
        let half = FEW_ROWS - 1;
        for (x, y) in x
            .chunks(half * inputs)
            .zip(apart.chunks_mut(half * outputs))
        {
            f32::product(&panels, x, y);
        }
        assert_eq!(together, apart);
    }
}
