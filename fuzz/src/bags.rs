//! Targets for bags: MCAP files and `metadata.yaml`.

use crate::scratch;
use std::{fs, path::Path};
use wm_bag::{BagReader, QosProfile, Schema, SchemaEncoding};
use wm_msgs::{Layout, Mapping, Message as _, TypeDescription, cdr, wm_msgs::Action};

/// An MCAP file with one message, for [`metadata`].
const MCAP: &[u8] = include_bytes!("../corpus/bag/one_message.mcap");

/// Reads all messages of a bag with one MCAP file.
pub fn bag(data: &[u8]) {
    read(&scratch::file("bag", "bag_0.mcap", data));
}

/// Recovers a bag with one MCAP file, and opens the result.
///
/// # Panics
/// A recovered bag cannot be opened.
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
    // Without a recovered bag, the folder may be missing.
    fs::remove_dir_all(&output).ok();
}

/// Reads a `metadata.yaml` with a valid MCAP file, and the same text as a topic's QoS profiles.
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

/// Parses the bytes up to the first zero as a definition in `.msg` text and IDL, and decodes the rest as messages.
///
/// # Panics
/// The length of a converted message differs from an action's.
pub fn definition(data: &[u8]) {
    let mut parts = data.splitn(2, |byte| *byte == 0);
    // `splitn` gives one or two parts.
    let text = String::from_utf8_lossy(parts.next().unwrap_or_default()).into_owned();
    let body = parts.next().unwrap_or_default();
    let Ok(action) = TypeDescription::of::<Action>() else {
        return;
    };
    for encoding in [SchemaEncoding::Ros2Msg, SchemaEncoding::Ros2Idl] {
        let text = text.clone();
        let schema = Schema { encoding, text };
        let Ok(Some(description)) = schema.description(&Action::ros_name()) else {
            continue;
        };
        let layout = Layout::of(&description);
        let mapping = Mapping::new(&description, &action);
        for representation in [0, 1, 6, 7] {
            let message = [&[0, representation, 0, 0], body].concat();
            if let Ok(layout) = &layout {
                layout.check(&message).ok();
            }
            if let Ok(converted) = mapping.as_ref().map(|mapping| mapping.convert(&message))
                && let Ok(converted) = converted
                && let Err(error) = cdr::from_bytes::<Action>(&converted)
            {
                let is_shape = matches!(error, cdr::CdrError::Trailing { .. });
                assert!(!is_shape, "a converted action does not fit: {error}");
            }
        }
    }
}

fn read(path: &Path) {
    let Ok(reader) = BagReader::open(path) else {
        return;
    };
    let _ = reader.summary().to_string();
    // Damage is an error in the sequence, which continues after it.
    for message in reader.messages() {
        let _ = message;
    }
}
