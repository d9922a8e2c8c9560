use safetensors::tensor::{Dtype, TensorView};

use super::*;

fn checkpoint(tensors: &[(&str, &[usize])]) -> Checkpoint {
    let bytes: Vec<Vec<u8>> = tensors
        .iter()
        .map(|(_, shape)| {
            let count: usize = shape.iter().product();
            (0..count).flat_map(|i| (i as f32).to_le_bytes()).collect()
        })
        .collect();
    let views = tensors.iter().zip(&bytes).map(|((name, shape), bytes)| {
        (
            *name,
            TensorView::new(Dtype::F32, shape.to_vec(), bytes).unwrap(),
        )
    });
    Checkpoint::from_bytes("test", safetensors::serialize(views, None).unwrap()).unwrap()
}

#[test]
fn all_faults_are_listed_together() {
    let source = checkpoint(&[
        ("a.fc.weight", &[3, 2]),
        ("a.fc.bias", &[4]),
        ("a.mask_token", &[2]),
        ("extra.weight", &[1]),
    ]);
    let loader = Loader::new(&source, &Compute::on_cpu(Kernels::Candle)).unwrap();
    let a = loader.at("a");
    a.linear_no_bias("fc", 2, 3).unwrap();
    assert_eq!(a.tensor("fc.bias", &[3]).unwrap().dims(), [3]);
    a.layer_norm("norm", 5, 1e-6).unwrap();
    a.ignore("mask");
    let Error::Tensors {
        missing,
        misshapen,
        unexpected,
        ..
    } = loader.finish().unwrap_err()
    else {
        panic!("another error");
    };
    assert_eq!(missing, ["a.norm.weight [5]", "a.norm.bias [5]"]);
    assert_eq!(misshapen.len(), 1);
    assert_eq!(misshapen[0].to_string(), "a.fc.bias [4], expected [3]");
    assert_eq!(unexpected, ["extra.weight"]);
    let text = loader.finish().unwrap_err().to_string();
    assert!(
        text.contains("missing (2):\n  a.norm.weight [5]\n  a.norm.bias [5]"),
        "{text}"
    );
}

#[test]
fn what_fits_is_no_error_and_is_counted() {
    let source = checkpoint(&[("fc.weight", &[3, 2]), ("fc.bias", &[3])]);
    let loader = Loader::new(&source, &Compute::default()).unwrap();
    assert!(loader.has("fc.weight") && !loader.has("weight"));
    assert!(loader.at("fc").has("weight"));
    let linear = loader.clone().linear("fc", 2, 3).unwrap();
    let x = Tensor::new(&[[1f32, 10.0]], &Device::Cpu).unwrap();
    let y = linear.forward(&x).unwrap().to_vec2::<f32>().unwrap();
    assert_eq!(y, [[10.0, 33.0, 56.0]]);
    loader.tensor("fc.bias", &[3]).unwrap();
    assert_eq!(loader.parameters(), 9);
    loader.finish().unwrap();
}

#[test]
fn a_skeleton_gives_whatever_is_asked_for() {
    let loader = Loader::skeleton(Kernels::Cpu);
    let norm = loader.group_norm("norm", 4, 8, 1e-6).unwrap();
    let spec = ConvSpec {
        inputs: 8,
        outputs: 16,
        kernel: 3,
        stride: 1,
        padding: crate::layers::Padding::same(3),
    };
    let conv = loader.at("block").conv2d("conv", spec).unwrap();
    assert_eq!(loader.parameters(), 16 + 8 * 16 * 9 + 16);
    let x = Tensor::zeros((1, 4, 4, 8), DType::F32, &Device::Cpu).unwrap();
    let y = conv.forward(&norm.forward_silu(&x).unwrap()).unwrap();
    assert_eq!(y.dims(), [1, 4, 4, 16]);
    loader.finish().unwrap();
}

#[test]
fn matrices_are_rounded_to_sixteen_bits_and_computed_with_in_32() {
    let source = checkpoint(&[("w", &[2, 150]), ("b", &[300])]);
    for kernels in [Kernels::Candle, Kernels::Cpu] {
        let compute = Compute::on_cpu(kernels);
        let compute = compute.with_format(NumberFormat::Bf16).unwrap();
        let loader = Loader::new(&source, &compute).unwrap();
        let values = |loader: &Loader<'_>, name: &str, shape: &[usize]| {
            let tensor = loader.tensor(name, shape).unwrap();
            assert_eq!((loader.dtype(), tensor.dtype()), (DType::F32, DType::F32));
            let values = tensor.flatten_all().unwrap().to_vec1::<f32>().unwrap();
            (values[255], values[257])
        };
        // Eight bits of mantissa: 257 lies between 256 and 258.
        assert_eq!(values(&loader, "w", &[2, 150]), (255.0, 256.0));
        assert_eq!(values(&loader, "b", &[300]), (255.0, 257.0));
        let unrounded = loader.unrounded();
        assert_eq!(values(&unrounded, "w", &[2, 150]), (255.0, 257.0));
    }
}
