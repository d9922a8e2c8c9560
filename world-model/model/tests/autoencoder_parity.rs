//! The autoencoder computes what PyTorch computes; `fixtures/generate_autoencoder.py` made the expected values.

use std::path::Path;

use candle_core::Tensor;
use wm_model::{Autoencoder, Decoder as _, Encoder as _, Weights};

fn fixture(name: &str) -> Weights {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures");
    Weights::open(folder.join(name)).unwrap()
}

fn tensor(weights: &Weights, name: &str) -> Tensor {
    let shape = weights.shape(name).unwrap().to_vec();
    weights.tensor(name, &shape).unwrap()
}

fn assert_close(what: &str, found: &Tensor, expected: &Tensor) {
    assert_eq!(found.dims(), expected.dims(), "{what}");
    let difference = (found - expected).unwrap().abs().unwrap();
    let largest = difference.max_all().unwrap().to_scalar::<f32>().unwrap();
    let spread = expected
        .abs()
        .unwrap()
        .max_all()
        .unwrap()
        .to_scalar::<f32>()
        .unwrap();
    assert!(spread > 0.5, "{what}: the fixture says nothing");
    assert!(largest < 1e-4, "{what}: differs by {largest}");
}

#[test]
fn both_halves_equal_pytorch() {
    let autoencoder = Autoencoder::from_weights(fixture("autoencoder.safetensors")).unwrap();
    let io = fixture("autoencoder_io.safetensors");
    let latents = autoencoder.encode(&tensor(&io, "images")).unwrap();
    assert_close("latents", &latents, &tensor(&io, "latents"));
    let decoded = autoencoder.decode(&tensor(&io, "given")).unwrap();
    assert_close("pictures", &decoded, &tensor(&io, "decoded"));
    io.finish().unwrap();
}
