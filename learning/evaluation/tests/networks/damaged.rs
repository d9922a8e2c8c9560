//! Files that are cut short or changed: an error or another answer, never a panic.

use std::fs;

use wm_evaluation::onnx::{Error, Networks, Role};

use super::pictures::picture;

/// A small generator of numbers, so that the same places are hit each time (Steele et al., SplitMix64).
struct Places(u64);

impl Places {
    fn below(&mut self, limit: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % limit as u64) as usize
    }
}

fn run(bytes: &[u8]) -> Result<Vec<Vec<f32>>, Error> {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.onnx"), bytes).unwrap();
    let text = "fid: { file: a.onnx, input: { resize: none, range: [0, 1] }, pooling: space }";
    let networks = Networks::parse(text, folder.path().join("networks.yaml")).unwrap();
    let network = networks.features(Role::Fid)?;
    network.of(&[picture((35, 33), 0, (0, 0))])
}

#[test]
fn cut_short() {
    let whole = include_bytes!("../../fixtures/convolutions.onnx");
    assert!(run(whole).is_ok());
    let mut places = Places(1);
    for len in (0..25)
        .map(|_| places.below(whole.len()))
        .chain([0, 1, whole.len() - 1])
    {
        assert!(
            run(&whole[..len]).is_err(),
            "{len} bytes of {}",
            whole.len()
        );
    }
}

#[test]
fn changed() {
    let mut places = Places(2);
    for file in [
        &include_bytes!("../../fixtures/convolutions.onnx")[..],
        &include_bytes!("../../fixtures/transformer.onnx")[..],
    ] {
        for _ in 0..60 {
            let mut bytes = file.to_vec();
            for _ in 0..=places.below(3) {
                let place = places.below(bytes.len());
                bytes[place] ^= 1 << places.below(8);
            }
            // Either will do: a bit of a weight makes another network.
            run(&bytes).ok();
        }
    }
}

/// Its pictures would be prepared before anything is run.
#[test]
fn batch_beyond_all_measure() {
    // The lengths 1 and 3 of the input's first two axes, as protobuf writes them.
    let axes = [10, 2, 8, 1, 10, 2, 8, 3];
    let mut bytes = include_bytes!("../../fixtures/depth.onnx").to_vec();
    let place = bytes.windows(8).position(|window| window == axes).unwrap();
    bytes[place + 3] = 127;
    let error = run(&bytes).unwrap_err().to_string();
    assert!(
        error.ends_with("a run takes 127 inputs; expected at most 64"),
        "{error}"
    );
}

/// tract looks an output's name up and panics where no node gives it: this is what its panics are caught for.
#[test]
fn panic_of_the_runtime() {
    let mut bytes = include_bytes!("../../fixtures/convolutions.onnx").to_vec();
    let last = bytes.windows(3).rposition(|name| name == b"out").unwrap();
    bytes[last] = b'x';
    let error = run(&bytes).unwrap_err();
    assert!(matches!(error, Error::Unusable { .. }));
    assert!(
        error.to_string().contains("the runtime panicked"),
        "{error}"
    );
}
