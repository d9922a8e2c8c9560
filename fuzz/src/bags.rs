//! Bags: MCAP files and `metadata.yaml`.

use crate::scratch;
use std::{fs, path::Path};
use wm_bag::{BagReader, QosProfile};

/// An MCAP file with one message, which [`metadata`] describes.
const MCAP: &[u8] = include_bytes!("../corpus/bag/one_message.mcap");

/// Opens a bag of one MCAP file and reads all its messages.
pub fn bag(data: &[u8]) {
    read(&scratch::file("bag", "bag_0.mcap", data));
}

/// Recovers a bag of one MCAP file, and reads what came of it.
///
/// # Panics
/// If a recovered bag cannot be read.
pub fn recover(data: &[u8]) {
    let input = scratch::file("recover", "bag_0.mcap", data);
    let output = input.with_file_name("recovered");
    if wm_bag::recover(&input, &output).is_ok() {
        let recovered = BagReader::open(&output);
        assert!(
            recovered.is_ok(),
            "a recovered bag cannot be read: {:?}",
            recovered.err()
        );
    }
    // Where nothing was recovered there may be no folder.
    fs::remove_dir_all(&output).ok();
}

/// Reads a `metadata.yaml` beside a sound MCAP file, and the same text as a topic's QoS profiles.
pub fn metadata(data: &[u8]) {
    scratch::file("metadata", "bag_0.mcap", MCAP);
    let metadata = scratch::file("metadata", "metadata.yaml", data);
    if let Some(folder) = metadata.parent() {
        read(folder);
    }
    if let Ok(text) = std::str::from_utf8(data) {
        QosProfile::parse_yaml(text).ok();
    }
}

fn read(path: &Path) {
    let Ok(reader) = BagReader::open(path) else {
        return;
    };
    let _ = reader.summary().to_string();
    // Damage is reported within the sequence; each error takes the reader further.
    for message in reader.messages() {
        let _ = message;
    }
}
