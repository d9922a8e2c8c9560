//! Pools an output to one vector per picture.

use crate::onnx::{Network, Pooling, Result, Tensor};

/// Pools output `index` to `count` feature vectors by the network's `pooling`.
pub(crate) fn pooled(
    network: &Network,
    outputs: &[Tensor],
    index: usize,
    count: usize,
) -> Result<Vec<Vec<f32>>> {
    let pooling = network.spec().pooling;
    let found = outputs.get(index);
    let shape = found.map_or(&[][..], Tensor::shape);
    found
        .filter(|_| shape.first() == Some(&count))
        .and_then(|tensor| vectors(tensor, pooling))
        .ok_or_else(|| {
            let expected = match pooling {
                Pooling::None => format!("[{count}, features], or a `pooling`"),
                Pooling::Tokens | Pooling::FirstToken => format!("[{count}, tokens, features]"),
                Pooling::Space => format!("[{count}, features, height, width]"),
            };
            network.shape_error("output", expected, format!("{shape:?}"))
        })
}

/// `None` if the shape does not suit `pooling`.
fn vectors(tensor: &Tensor, pooling: Pooling) -> Option<Vec<Vec<f32>>> {
    let (_, shape) = tensor.shape().split_first()?;
    let rows = tensor.rows();
    Some(match (pooling, shape) {
        (Pooling::None, [features, rest @ ..])
            if *features > 0 && rest.iter().all(|side| *side == 1) =>
        {
            rows.map(<[f32]>::to_vec).collect()
        }
        (Pooling::Tokens, [tokens, features]) if *tokens > 0 && *features > 0 => rows
            .map(|row| mean_of_tokens(row, *tokens, *features))
            .collect(),
        (Pooling::FirstToken, [tokens, features]) if *tokens > 0 && *features > 0 => rows
            .map(|row| row.iter().take(*features).copied().collect())
            .collect(),
        (Pooling::Space, [features, _, ..]) if !shape.contains(&0) => rows
            .map(|row| row.chunks_exact(row.len() / features).map(mean).collect())
            .collect(),
        _ => return None,
    })
}

fn mean_of_tokens(row: &[f32], tokens: usize, features: usize) -> Vec<f32> {
    let mut sums = vec![0.0_f64; features];
    for token in row.chunks_exact(features) {
        for (sum, value) in sums.iter_mut().zip(token) {
            *sum += f64::from(*value);
        }
    }
    sums.into_iter()
        .map(|sum| (sum / tokens as f64) as f32)
        .collect()
}

/// Summed in f64, so that rounding does not depend on the order.
fn mean(values: &[f32]) -> f32 {
    let sum: f64 = values.iter().copied().map(f64::from).sum();
    (sum / values.len() as f64) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pooled(shape: &[usize], pooling: Pooling) -> Option<Vec<Vec<f32>>> {
        let count: usize = shape.iter().product();
        let data = (0..count).map(|i| i as f32).collect();
        vectors(&Tensor::new(shape.to_vec(), data).unwrap(), pooling)
    }

    #[test]
    fn every_pooling_gives_vectors() {
        use Pooling::{FirstToken, None, Space, Tokens};
        assert_eq!(
            pooled(&[2, 2], None),
            Some(vec![vec![0.0, 1.0], vec![2.0, 3.0]])
        );
        assert_eq!(pooled(&[1, 2, 1, 1], None), Some(vec![vec![0.0, 1.0]]));
        assert_eq!(pooled(&[1, 2, 2], Tokens), Some(vec![vec![1.0, 2.0]]));
        assert_eq!(pooled(&[1, 2, 2], FirstToken), Some(vec![vec![0.0, 1.0]]));
        assert_eq!(pooled(&[1, 2, 1, 2], Space), Some(vec![vec![0.5, 2.5]]));
        for (shape, pooling) in [
            (&[2, 2, 3][..], None),
            (&[2][..], None),
            (&[2, 2][..], Tokens),
            (&[2, 2][..], Space),
            (&[1, 0, 2, 2][..], Space),
        ] {
            assert_eq!(
                pooled(shape, pooling),
                Option::None,
                "{shape:?} {pooling:?}"
            );
        }
    }
}
