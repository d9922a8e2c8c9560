//! Several camera views: side by side along the width of pictures and latents, one after the other in a batch.

use candle_core::Tensor;

use crate::Result;

/// (N, h, views w, C) to (views N, h, w, C): the first view of all, the second of all, ...
pub(super) fn apart(x: &Tensor, views: usize) -> Result<Tensor> {
    match views {
        1 => Ok(x.clone()),
        _ => Ok(Tensor::cat(&x.chunk(views, 2)?, 0)?),
    }
}

/// The inverse of [`apart`].
pub(super) fn beside(x: &Tensor, views: usize) -> Result<Tensor> {
    match views {
        1 => Ok(x.clone()),
        _ => Ok(Tensor::cat(&x.chunk(views, 0)?, 2)?),
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    #[test]
    fn views_lie_beside_each_other() {
        let x = Tensor::arange(0f32, 2.0 * 3.0 * 8.0, &Device::Cpu)
            .unwrap()
            .reshape((2, 3, 4, 2))
            .unwrap();
        let split = apart(&x, 2).unwrap();
        assert_eq!(split.dims(), [4, 3, 2, 2]);
        // The second view of the first picture is the third of the batch.
        let of_batch = split.get(2).unwrap().to_vec3::<f32>().unwrap();
        let of_picture = x.get(0).unwrap().narrow(1, 2, 2).unwrap();
        assert_eq!(of_batch, of_picture.to_vec3::<f32>().unwrap());
        let back = beside(&split, 2).unwrap();
        let values = |x: &Tensor| x.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        assert_eq!((back.dims(), values(&back)), (x.dims(), values(&x)));
    }
}
