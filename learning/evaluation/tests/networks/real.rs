//! Real networks, if available: `WM_ONNX_DIR` is a folder with, for each network, `<name>.onnx`, `<name>.shapes` (a line per
//! input: its sides), `<name>.in0`, `.in1`, ... and `<name>.out` (the first output), the latter little-endian f32.
//! `fixtures/real.py` writes such a folder.

use std::path::Path;
use std::time::Instant;
use std::{env, fs};

use wm_evaluation::onnx::{Networks, Role, Tensor};

fn numbers(file: &Path) -> Vec<f32> {
    let bytes = fs::read(file).unwrap();
    bytes
        .as_chunks::<4>()
        .0
        .iter()
        .map(|bytes| f32::from_le_bytes(*bytes))
        .collect()
}

#[test]
fn real_networks_match_their_outputs() {
    let Some(folder) = env::var_os("WM_ONNX_DIR") else {
        println!("skipped: WM_ONNX_DIR names no folder with real networks");
        return;
    };
    let folder = Path::new(&folder);
    let mut count = 0;
    for entry in fs::read_dir(folder).unwrap() {
        let file = entry.unwrap().path();
        if file.extension().is_none_or(|extension| extension != "onnx") {
            continue;
        }
        let shapes = fs::read_to_string(file.with_extension("shapes")).unwrap();
        let inputs = shapes.lines().enumerate().map(|(index, line)| {
            let shape = line.split(' ').map(|side| side.parse().unwrap()).collect();
            Tensor::new(shape, numbers(&file.with_extension(format!("in{index}")))).unwrap()
        });
        let inputs: Vec<Tensor> = inputs.collect();
        let name = file.file_name().unwrap().to_str().unwrap();
        let text = format!("fid: {{ file: {name}, input: {{ resize: none, range: [0, 1] }} }}");
        let networks = Networks::parse(&text, folder.join("networks.yaml")).unwrap();
        let start = Instant::now();
        let network = networks.open(Role::Fid).unwrap();
        let mut found = network.run(&inputs).unwrap();
        let first = start.elapsed();
        let start = Instant::now();
        let again = network.run(&inputs).unwrap();
        let run = start.elapsed();
        assert_eq!(again, found, "{name}: another answer the second time");
        let expected = numbers(&file.with_extension("out"));
        let largest = expected
            .iter()
            .fold(0.0, |largest: f32, value| largest.max(value.abs()));
        assert!(
            largest > 0.0,
            "{name}: an answer of zeros would show nothing"
        );
        let apart = found
            .remove(0)
            .into_data()
            .into_iter()
            .zip(&expected)
            .map(|(a, b)| (a - b).abs());
        let far = apart.fold(0.0, f32::max) / largest;
        println!(
            "{name}: opened and run in {first:.2?}, run again in {run:.2?}, {far:.1e} of the largest value off"
        );
        assert!(far < 1e-4, "{name}");
        count += 1;
    }
    assert!(count > 0, "no .onnx in {}", folder.display());
}
