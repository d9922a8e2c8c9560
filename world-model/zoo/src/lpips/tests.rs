//! That it is PyTorch's is tested where it trains: in the step of the adapter (`wm_training`).

#![allow(clippy::unwrap_used)]

use safetensors::{Dtype, serialize, tensor::TensorView};

use super::*;

/// A file of tensors with values from -0.5 to 0.5, or from 0 to 1 for heads.
fn file(name: &str, shapes: &[(String, Vec<usize>)], offset: f32) -> Checkpoint {
    let values = |shape: &[usize]| -> Vec<u8> {
        let count = shape.iter().product::<usize>();
        let values = (0..count).map(|i| (i * 37 % 101) as f32 / 101.0 - offset);
        values.flat_map(f32::to_le_bytes).collect()
    };
    let bytes: Vec<Vec<u8>> = shapes.iter().map(|(_, shape)| values(shape)).collect();
    let views = shapes.iter().zip(&bytes).map(|((name, shape), bytes)| {
        let view = TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap();
        (name.clone(), view)
    });
    Checkpoint::from_bytes(name, serialize(views, None).unwrap()).unwrap()
}

/// AlexNet of four channels a layer.
fn trunk() -> Vec<(String, Vec<usize>)> {
    let mut shapes = Vec::new();
    for (order, (index, kernel, _, _)) in CONVOLUTIONS.into_iter().enumerate() {
        let inputs = if order == 0 { 3 } else { 4 };
        shapes.push((
            format!("features.{index}.weight"),
            vec![4, inputs, kernel, kernel],
        ));
        shapes.push((format!("features.{index}.bias"), vec![4]));
    }
    shapes.push(("classifier.1.weight".to_owned(), vec![2, 2]));
    shapes
}

fn heads() -> Checkpoint {
    let shapes: Vec<(String, Vec<usize>)> = (0..5)
        .map(|order| (format!("lin{order}.model.1.weight"), vec![1, 4, 1, 1]))
        .collect();
    file("heads", &shapes, 0.0)
}

fn pictures(seed: usize, shape: (usize, usize, usize, usize)) -> Tensor {
    let (n, height, width, channels) = shape;
    let values =
        (0..n * height * width * channels).map(|i| ((i * (seed + 7)) % 251) as f32 / 250.0);
    Tensor::from_vec(values.collect(), shape, &Device::Cpu).unwrap()
}

#[test]
fn is_a_distance_and_the_mean_over_pictures() {
    let lpips = Lpips::load(&file("trunk", &trunk(), 0.5), &heads()).unwrap();
    let distance = |a: &Tensor, b: &Tensor| {
        let distance = lpips.distance(a, b).unwrap();
        distance.to_scalar::<f32>().unwrap()
    };
    let (a, b) = (pictures(1, (2, 35, 40, 3)), pictures(2, (2, 35, 40, 3)));
    assert_eq!(distance(&a, &a), 0.0);
    assert!(distance(&a, &b) > 1e-3);
    assert_eq!(distance(&a, &b), distance(&b, &a));
    let of = |at: usize| distance(&a.narrow(0, at, 1).unwrap(), &b.narrow(0, at, 1).unwrap());
    assert!(((of(0) + of(1)) / 2.0 - distance(&a, &b)).abs() < 1e-6);
}

#[test]
fn what_does_not_fit_is_named() {
    let mut shapes = trunk();
    shapes.retain(|(name, _)| name != "features.6.bias");
    let error = Lpips::load(&file("trunk", &shapes, 0.5), &heads()).unwrap_err();
    let error = error.to_string();
    assert!(
        error.contains("trunk") && error.contains("features.6.bias"),
        "{error}"
    );
    let mut shapes = trunk();
    for (name, shape) in &mut shapes {
        if name == "features.0.weight" {
            shape[2] = 7;
        }
    }
    let error = Lpips::load(&file("trunk", &shapes, 0.5), &heads()).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("[4, 3, 7, 11], expected [4, 3, 11, 11]"),
        "{error}"
    );

    let lpips = Lpips::load(&file("trunk", &trunk(), 0.5), &heads()).unwrap();
    let small = pictures(1, (1, 16, 16, 3));
    let error = lpips.distance(&small, &small).unwrap_err().to_string();
    assert!(error.contains("too small"), "{error}");
}
