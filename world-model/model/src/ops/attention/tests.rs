use super::super::comparison::{check_gradients, check_refused, check_same, random};
use super::*;
use crate::ops::{RopeLayout, RotaryTable};

/// Root-mean-square normalisation and rotation of one head's channels, as they are defined; `angle(pair)`.
fn prepared(x: &[f32], angle: impl Fn(usize) -> f64) -> Vec<f64> {
    let mean = x.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>() / x.len() as f64;
    let r = 1.0 / (mean + f64::from(f32::EPSILON)).sqrt();
    let mut out = Vec::new();
    for (pair, x) in x.chunks(2).enumerate() {
        let (a, b) = (f64::from(x[0]) * r, f64::from(x[1]) * r);
        let (sin, cos) = angle(pair).sin_cos();
        out.extend([a * cos - b * sin, a * sin + b * cos]);
    }
    out
}

/// One head over a grid, in the order of the definition.
fn defined(
    qkv: &[Vec<f32>],
    (head, heads, dim): (usize, usize, usize),
    width: usize,
) -> Vec<Vec<f64>> {
    let d = heads * dim;
    let frequency = |i: usize| 10_000f64.powf(-(i as f64) / (dim / 4) as f64);
    let part = |token: usize, start: usize| {
        let (row, column) = (token / width, token % width);
        let angle = |pair: usize| match pair.checked_sub(dim / 4) {
            None => row as f64 * frequency(pair),
            Some(pair) => column as f64 * frequency(pair),
        };
        prepared(&qkv[token][start + head * dim..][..dim], angle)
    };
    (0..qkv.len())
        .map(|query| {
            let q = part(query, 0);
            let scores: Vec<f64> = (0..qkv.len())
                .map(|key| {
                    let dot: f64 = q.iter().zip(part(key, d)).map(|(q, k)| q * k).sum();
                    (dot / (dim as f64).sqrt()).exp()
                })
                .collect();
            let sum: f64 = scores.iter().sum();
            (0..dim)
                .map(|c| {
                    let value = |token: usize| f64::from(qkv[token][2 * d + head * dim + c]);
                    (0..qkv.len())
                        .map(|key| scores[key] / sum * value(key))
                        .sum()
                })
                .collect()
        })
        .collect()
}

#[test]
fn heads_of_any_width_are_those_of_the_definition() {
    let (rows, columns, heads) = (3, 4, 2);
    for dim in [4, 8, 12, 16, 20, 64] {
        let d = heads * dim;
        let rotary = RotaryTable::grid(rows, columns, dim);
        let pattern = AttentionPattern::new(Axis::Space, heads, rotary, |_, _| true).unwrap();
        let qkv = random(&[1, 1, rows * columns, 3 * d], 1);
        let out = attention(Kernels::Cpu, &qkv, &Arc::new(pattern)).unwrap();
        let rows = |x: &Tensor| x.squeeze(0).unwrap().squeeze(0).unwrap().to_vec2().unwrap();
        let (qkv, out): (Vec<Vec<f32>>, Vec<Vec<f32>>) = (rows(&qkv), rows(&out));
        for head in 0..heads {
            for (out, expected) in out.iter().zip(defined(&qkv, (head, heads, dim), columns)) {
                for (out, expected) in out[head * dim..].iter().zip(&expected) {
                    assert!(
                        (f64::from(*out) - expected).abs() < 1e-5,
                        "dim {dim}, head {head}"
                    );
                }
            }
        }
    }
}

#[test]
fn the_kernel_is_the_plain_form() {
    let heads = 2;
    let all = |_: usize, _: usize| true;
    let causal = |query: usize, key: usize| key <= query;
    // Clean frames 0 and 1, then 1 and 2 once more: each sees itself and the clean ones before it.
    let forcing = |query: usize, key: usize| key == query || key < [1, 2, 1, 2][query];
    for dim in [4, 12, 16, 64] {
        let space = |rotary, visible| AttentionPattern::new(Axis::Space, heads, rotary, visible);
        let views = |layout| RotaryTable::views(2, 3, 2, layout, dim);
        let time = |positions: &[usize], visible: fn(usize, usize) -> bool| {
            let rotary = RotaryTable::sequence(positions, dim);
            AttentionPattern::new(Axis::Time, heads, rotary, visible)
        };
        for (what, pattern, t, n) in [
            ("grid", space(RotaryTable::grid(3, 4, dim), all), 2, 12),
            ("views", space(views(RopeLayout::ByView), all), 2, 12),
            (
                "views as in the reference",
                space(views(RopeLayout::Reference), all),
                2,
                12,
            ),
            ("causal", time(&[0, 1, 2, 3, 4], causal), 5, 3),
            ("forcing", time(&[0, 1, 1, 2], forcing), 4, 3),
            ("one frame", time(&[3], all), 1, 3),
        ] {
            let pattern = Arc::new(pattern.unwrap());
            let qkv = random(&[2, t, n, 3 * heads * dim], 1);
            check_same(&format!("{what}, heads of {dim}"), |kernels| {
                attention(kernels, &qkv, &pattern)
            });
            let wrong = random(&[2, t + 1, n + 1, 3 * heads * dim], 2);
            check_refused("attention: ", |kernels| {
                attention(kernels, &wrong, &pattern)
            });
        }
    }
}

#[test]
fn the_gradient_is_that_of_finite_differences() {
    let heads = 2;
    // Clean frames 0 and 1, then 1 and 2 once more: each sees itself and the clean ones before it.
    let forcing = |query: usize, key: usize| key == query || key < [1, 2, 1, 2][query];
    for dim in [8, 12] {
        let grid = RotaryTable::grid(2, 3, dim);
        let time = RotaryTable::sequence(&[0, 1, 1, 2], dim);
        for (what, pattern, t, n) in [
            (
                "attention within a frame",
                AttentionPattern::new(Axis::Space, heads, grid, |_, _| true),
                2,
                6,
            ),
            (
                "attention over time",
                AttentionPattern::new(Axis::Time, heads, time, forcing),
                4,
                2,
            ),
        ] {
            let pattern = Arc::new(pattern.unwrap());
            let qkv = random(&[2, t, n, 3 * heads * dim], 1);
            check_gradients(what, &[qkv], |kernels, inputs| {
                attention(kernels, &inputs[0], &pattern)
            });
        }
    }
}
