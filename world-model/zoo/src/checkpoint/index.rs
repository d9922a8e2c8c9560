//! Which tensors are in a file.

use std::collections::BTreeMap;

use super::entry::Entry;
use super::{safetensors_index, torch_index};

/// First bytes of a zip archive, which a torch file is since version 1.6.
const ZIP: &[u8] = b"PK\x03\x04";

/// All tensors of a file, or what is wrong with it.
pub(super) fn index(bytes: &[u8]) -> Result<BTreeMap<String, Entry>, String> {
    if bytes.starts_with(ZIP) {
        return torch_index::index(bytes);
    }
    // A pickle of protocol 2 or more starts with this and the protocol's number.
    if let [0x80, 2..=5, ..] = bytes {
        return Err(
            "a torch file in the format before version 1.6: save it again with a newer torch.save"
                .to_owned(),
        );
    }
    safetensors_index::index(bytes)
}
