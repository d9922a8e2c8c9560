//! The rotary embedding of V-JEPA 2.1: time, row and column each turn a part of the channels.

use candle_core::{DType, Device, Tensor};

use crate::Result;

/// Base of the geometric series of frequencies.
const BASE: f64 = 10_000.0;

/// Rotations of the tokens of one picture, the same in all heads and layers.
///
/// Of `d` head channels three equal parts of 2 * (d / 3 / 2) turn with time, row and column, the
/// rest stands still: 64 = 20 + 20 + 20 + 4. Pairs are adjacent channels (2j, 2j + 1); pair i of a
/// part of n pairs turns by position * 10000^(-i / n). (facebookresearch/vjepa2,
/// `app/vjepa_2_1`; V-JEPA 2.0 tiles the angles instead and is not this.)
#[derive(Clone, Debug)]
pub(crate) struct Rotary {
    /// Cosine for every channel, (L, d).
    cosines: Tensor,
    /// Sine for every channel, negative for the first of a pair, (L, d).
    sines: Tensor,
    /// The permutation (d, d) that swaps the channels of each pair. A product with it is exact,
    /// and much faster than picking every second channel out of memory.
    swap: Tensor,
}

impl Rotary {
    /// For a single frame, at time 0, of `grid` (rows, columns) tokens, row by row, each step in
    /// the grid being `step` positions.
    pub(crate) fn picture(
        grid: (usize, usize),
        head_dim: usize,
        step: (f64, f64),
        (dtype, device): (DType, &Device),
    ) -> Result<Self> {
        let (rows, columns) = grid;
        let pairs = head_dim / 3 / 2;
        let (mut cosines, mut sines) = (Vec::new(), Vec::new());
        for row in 0..rows {
            for column in 0..columns {
                let positions = [0.0, row as f64 * step.0, column as f64 * step.1];
                for position in positions {
                    for pair in 0..pairs {
                        let angle = position * BASE.powf(-(pair as f64) / pairs as f64);
                        let (sine, cosine) = angle.sin_cos();
                        cosines.extend([cosine as f32; 2]);
                        sines.extend([-sine as f32, sine as f32]);
                    }
                }
                let still = head_dim - 3 * 2 * pairs;
                cosines.extend(std::iter::repeat_n(1.0, still));
                sines.extend(std::iter::repeat_n(0.0, still));
            }
        }
        let mut swap = vec![0.0_f32; head_dim * head_dim];
        for (channel, row) in swap.chunks_exact_mut(head_dim.max(1)).enumerate() {
            // The last channel of an odd number has no partner, and stands still anyway.
            if let Some(partner) = row.get_mut(channel ^ 1) {
                *partner = 1.0;
            }
        }
        let tokens = rows * columns;
        let tensor = |values: Vec<f32>, rows: usize| -> Result<Tensor> {
            let tensor = Tensor::from_vec(values, (rows, head_dim), device)?;
            Ok(tensor.to_dtype(dtype)?)
        };
        Ok(Self {
            cosines: tensor(cosines, tokens)?,
            sines: tensor(sines, tokens)?,
            swap: tensor(swap, head_dim)?,
        })
    }

    /// Turns queries or keys (B, heads, L, d).
    pub(crate) fn apply(&self, x: &Tensor) -> Result<Tensor> {
        let (b, heads, l, d) = x.dims4()?;
        let x = x.contiguous()?;
        let swapped = x
            .reshape((b * heads * l, d))?
            .matmul(&self.swap)?
            .reshape((b, heads, l, d))?;
        let turned = swapped.broadcast_mul(&self.sines)?;
        Ok((x.broadcast_mul(&self.cosines)? + turned)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD_DIM: usize = 64;

    /// What becomes of the unit vector of `channel` at the last token of a picture of `grid`.
    fn turn_unit(channel: usize, grid: (usize, usize)) -> Vec<f32> {
        let on = (DType::F32, &Device::Cpu);
        let rotary = Rotary::picture(grid, HEAD_DIM, (1.0, 1.0), on).unwrap();
        let tokens = grid.0 * grid.1;
        let mut values = vec![0.0_f32; tokens * HEAD_DIM];
        values[(tokens - 1) * HEAD_DIM + channel] = 1.0;
        let x = Tensor::from_vec(values, (1, 1, tokens, HEAD_DIM), &Device::Cpu).unwrap();
        let turned = rotary.apply(&x).unwrap();
        let last = turned.narrow(2, tokens - 1, 1).unwrap();
        last.flatten_all().unwrap().to_vec1().unwrap()
    }

    fn assert_turned(channel: usize, grid: (usize, usize), angle: f32) {
        let turned = turn_unit(channel, grid);
        let first_of_pair = channel.is_multiple_of(2);
        let partner = channel ^ 1;
        let sine = if first_of_pair {
            angle.sin()
        } else {
            -angle.sin()
        };
        for (at, value) in turned.iter().enumerate() {
            let expected = match at {
                at if at == channel => angle.cos(),
                at if at == partner => sine,
                _ => 0.0,
            };
            assert!(
                (value - expected).abs() < 3e-6,
                "channel {channel}: {turned:?}"
            );
        }
    }

    #[test]
    fn unit_vectors_turn_with_row_and_column() {
        // The last token of 8 rows and 6 columns is at row 7, column 5.
        let frequency = |pair: i32| 10_000_f32.powf(-(pair as f32) / 10.0);
        for pair in [0, 1, 4, 9] {
            let channel = 2 * pair as usize;
            assert_turned(channel, (8, 6), 0.0);
            assert_turned(channel + 1, (8, 6), 0.0);
            assert_turned(20 + channel, (8, 6), 7.0 * frequency(pair));
            assert_turned(21 + channel, (8, 6), 7.0 * frequency(pair));
            assert_turned(40 + channel, (8, 6), 5.0 * frequency(pair));
            assert_turned(41 + channel, (8, 6), 5.0 * frequency(pair));
        }
        for channel in 60..64 {
            assert_turned(channel, (8, 6), 0.0);
        }
    }

    #[test]
    fn small_heads_have_three_equal_parts() {
        // 16 channels: 4 + 4 + 4 + 4; 32: 10 + 10 + 10 + 2.
        for (head_dim, still) in [(16, 4), (32, 2), (12, 0)] {
            let on = (DType::F32, &Device::Cpu);
            let rotary = Rotary::picture((2, 2), head_dim, (1.0, 1.0), on).unwrap();
            let sines = rotary.sines.to_vec2::<f32>().unwrap();
            let last = &sines[3];
            let part = (head_dim - still) / 3;
            assert!(last[..part].iter().all(|s| *s == 0.0));
            assert!(last[part..3 * part].iter().all(|s| *s != 0.0));
            assert!(last[3 * part..].iter().all(|s| *s == 0.0));
        }
    }

    #[test]
    fn products_depend_on_distance_only() {
        let on = (DType::F32, &Device::Cpu);
        let rotary = Rotary::picture((1, 8), HEAD_DIM, (1.0, 1.0), on).unwrap();
        let one = wm_model::random::normal(&[1, 1, 1, HEAD_DIM], 1).unwrap();
        let same = one.broadcast_as((1, 1, 8, HEAD_DIM)).unwrap();
        let turned = rotary.apply(&same).unwrap().reshape((8, HEAD_DIM)).unwrap();
        let products = turned.matmul(&turned.t().unwrap()).unwrap();
        let products = products.to_vec2::<f32>().unwrap();
        assert!((products[0][3] - products[4][7]).abs() < 1e-4);
        assert!((products[2][2] - products[5][5]).abs() < 1e-4);
    }
}
