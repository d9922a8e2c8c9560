//! Rows times a matrix in panels, on the calling thread.

use std::cell::RefCell;

use half::bf16;

use super::element::{Element, widen};
use super::kernel::Row;
use super::panels::Panels;
use super::product::{Bf16, F32, Product};
use super::simd::{Bf16Unit, LANES, prefetch};

thread_local! {
    /// Rows that were rounded to bf16.
    static ROUNDED: RefCell<Vec<bf16>> = const { RefCell::new(Vec::new()) };
    /// A panel of bf16 as f32.
    static WIDENED: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
}

/// Panels of a format that rows are multiplied with.
pub(crate) trait PanelProduct: Element {
    /// `y` (rows, outputs) = `x` (rows, depth) times a packed matrix, plus its bias.
    ///
    /// # Panics
    /// If `x` is not whole rows, or `y` has another number of them.
    fn product(panels: &Panels<Self>, x: &[f32], y: &mut [f32]);
}

impl PanelProduct for f32 {
    fn product(panels: &Panels<f32>, x: &[f32], y: &mut [f32]) {
        let rows = check(panels, x, y);
        for place in panels.iter() {
            ahead(panels, place);
            let weights = panels.values.as_ptr().wrapping_add(place.1);
            let row = row::<F32>((panels.depth, rows), x.as_ptr(), weights, panels, place, y);
            // SAFETY: the lengths were checked above, and those of the panels hold by construction; the
            // panels were cut for an instruction set that was detected.
            unsafe { row.run(panels.set) };
        }
    }
}

impl PanelProduct for bf16 {
    fn product(panels: &Panels<bf16>, x: &[f32], y: &mut [f32]) {
        match Bf16Unit::detect() {
            Some(unit) => rounded(unit, panels, x, y),
            None => widened(panels, x, y),
        }
    }
}

/// With inputs rounded to bf16, by the processor's products of bf16.
fn rounded(unit: Bf16Unit, panels: &Panels<bf16>, x: &[f32], y: &mut [f32]) {
    let rows = check(panels, x, y);
    let (depth, whole) = (panels.depth.max(1), panels.whole_depth().max(1));
    ROUNDED.with_borrow_mut(|buffer| {
        if buffer.len() < rows * whole {
            buffer.resize(rows * whole, bf16::ZERO);
        }
        if depth == whole {
            bf16::round(x, buffer);
        } else {
            for (x, out) in x.chunks_exact(depth).zip(buffer.chunks_exact_mut(whole)) {
                bf16::round(x, out);
                // What fills the group up may be left from an earlier product, and no number.
                out[depth..].fill(bf16::ZERO);
            }
        }
        for place in panels.iter() {
            ahead(panels, place);
            let weights = panels.values.as_ptr().wrapping_add(place.1);
            let row = row::<Bf16>((whole, rows), buffer.as_ptr(), weights, panels, place, y);
            // SAFETY: as above; the buffer has `rows` rows of `whole` values.
            unsafe { row.run(unit) };
        }
    });
}

/// With weights widened to f32, a panel at a time, which all rows are multiplied with.
fn widened(panels: &Panels<bf16>, x: &[f32], y: &mut [f32]) {
    let rows = check(panels, x, y);
    WIDENED.with_borrow_mut(|buffer| {
        for place in panels.iter() {
            ahead(panels, place);
            let (vectors, start, _) = place;
            let count = panels.whole_depth() * vectors * LANES;
            if buffer.len() < count {
                buffer.resize(count, 0.0);
            }
            if let Some(pairs) = panels.values.get(start..start + count) {
                widen(pairs, vectors * LANES, buffer);
            }
            let (x, weights) = (x.as_ptr(), buffer.as_ptr());
            let row = row::<F32>((panels.depth, rows), x, weights, panels, place, y);
            // SAFETY: as above; the buffer has a row of weights for every input.
            unsafe { row.run(panels.set) };
        }
    });
}

/// Rows of `x`. The kernel trusts the lengths.
fn check<T: Element>(panels: &Panels<T>, x: &[f32], y: &[f32]) -> usize {
    let rows = x.len() / panels.depth.max(1);
    assert_eq!(x.len(), rows * panels.depth, "input of a product");
    assert_eq!(y.len(), rows * panels.outputs, "output of a product");
    rows
}

/// All weights of a model do not fit into the caches that are near: the next panel comes while this one is computed with.
fn ahead<T: Element>(panels: &Panels<T>, (vectors, start, _): (usize, usize, usize)) {
    let count = panels.whole_depth() * vectors * LANES;
    if let Some(next) = panels.values.get(start + count..start + 2 * count) {
        prefetch(next);
    }
}

/// The product of `rows` inputs of `run` values with one panel.
fn row<P: Product>(
    (run, rows): (usize, usize),
    input: *const P::Input,
    panel: *const P::Weight,
    panels: &Panels<impl Element>,
    (vectors, _, first): (usize, usize, usize),
    y: &mut [f32],
) -> Row<P> {
    Row {
        input,
        input_step: run,
        tap_pitch: 0,
        tap_rows: 1,
        run,
        panel,
        vectors,
        bias: panels.bias.as_ptr().wrapping_add(first),
        pixels: rows,
        output: y.as_mut_ptr().wrapping_add(first),
        residual: std::ptr::null(),
        mask: std::ptr::null(),
        output_step: panels.outputs,
        channels: (panels.outputs - first).min(vectors * LANES),
        relu: false,
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
        product: impl Fn(&[f32], &[f32], &[f32], &mut [f32]),
    ) {
        let (x, w) = (numbers(rows * inputs, 1), numbers(outputs * inputs, 2));
        let bias = numbers(outputs, 3);
        let mut y = vec![f32::NAN; rows * outputs];
        product(&x, &w, &bias, &mut y);
        let as_used = |value: f32, is_rounded: bool| -> f64 {
            let rounded = bf16::from_f32(value).to_f32();
            f64::from(if is_rounded { rounded } else { value })
        };
        for (row, y) in y.chunks_exact(outputs).enumerate() {
            for (n, y) in y.iter().enumerate() {
                let sum: f64 = (0..inputs)
                    .map(|k| {
                        as_used(x[row * inputs + k], rounds_inputs)
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
            check_product("f32", shape, (false, false), |x, w, bias, y| {
                let panels = Panels::pack_transposed(inputs, outputs, Some(bias), w);
                f32::product(&panels, x, y);
            });
            check_product("bf16, widened", shape, (false, true), |x, w, bias, y| {
                let panels = Panels::pack_transposed(inputs, outputs, Some(bias), w);
                widened(&panels, x, y);
            });
            let Some(unit) = Bf16Unit::detect() else {
                println!("skipped: this processor has no products of bf16");
                continue;
            };
            check_product("bf16, rounded", shape, (true, true), |x, w, bias, y| {
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
