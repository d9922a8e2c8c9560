//! Targets for models: tensor files and their descriptions.

use crate::scratch;
use candle_core::DType;
use std::io::{Cursor, Write as _};
use wm_model::Weights;
use wm_motion::actions::ActionEncoding;
use wm_zoo::{Checkpoint, folder::DescribedFolder};
use zip::{CompressionMethod, ZipWriter, write::SimpleFileOptions};

/// Reads a tensor file (safetensors or torch) with all values.
pub fn checkpoint(data: &[u8]) {
    let Ok(checkpoint) = Checkpoint::from_bytes("fuzz", data.to_vec()) else {
        return;
    };
    for name in checkpoint.names() {
        checkpoint.tensor(name, DType::F32).ok();
    }
    for part in checkpoint.parts() {
        checkpoint.part(&part);
    }
}

/// Reads a torch file with this pickle.
pub fn pickle(data: &[u8]) {
    checkpoint(&torch_file(data));
}

/// A torch file with this pickle and sixteen floats.
///
/// # Panics
/// Never: writing to memory cannot fail.
#[allow(clippy::expect_used, reason = "writing to memory cannot fail")]
#[must_use]
pub fn torch_file(pickle: &[u8]) -> Vec<u8> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    // Like torch: uncompressed, with values aligned to 64 bytes.
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .with_alignment(64);
    let files: [(&str, &[u8]); 4] = [
        ("archive/data.pkl", pickle),
        ("archive/byteorder", b"little"),
        ("archive/data/0", &[0; 64]),
        ("archive/version", b"3\n"),
    ];
    for (name, content) in files {
        archive.start_file(name, options).expect("a new name");
        archive.write_all(content).expect("room in memory");
    }
    archive.finish().expect("room in memory").into_inner()
}

/// Reads a bundled model's weights.
pub fn weights(data: &[u8]) {
    Weights::from_bytes("fuzz", data.to_vec()).ok();
}

/// Opens a model folder with only this `model.json`.
pub fn model(data: &[u8]) {
    let file = scratch::file("model", wm_zoo::folder::FILE, data);
    if let Some(folder) = file.parent() {
        DescribedFolder::open(folder).ok();
    }
}

/// Reads an action encoding, and encodes a step with it.
pub fn actions(data: &[u8]) {
    let Ok(encoding) = serde_json::from_slice::<ActionEncoding>(data) else {
        return;
    };
    let actions = vec![vec![0.1_f32; encoding.space().len()]; encoding.frame_skip()];
    if let Ok(model) = encoding.encode_step(&actions) {
        encoding.decode_step(&model.values).ok();
    }
}
