//! Where the tensors of a safetensors file lie.

use std::collections::BTreeMap;

use safetensors::SafeTensors;

use super::Element;
use super::entry::Entry;

/// All tensors of a kind that is known; others are passed over.
pub(super) fn index(bytes: &[u8]) -> Result<BTreeMap<String, Entry>, String> {
    let describe =
        |error: safetensors::SafeTensorError| format!("not safetensors, nor a torch file: {error}");
    // `deserialize` also checks that the tensors cover the data exactly.
    SafeTensors::deserialize(bytes).map_err(describe)?;
    let (header_len, header) = SafeTensors::read_metadata(bytes).map_err(describe)?;
    let data_start = header_len + size_of::<u64>();
    let mut entries = BTreeMap::new();
    for (name, info) in header.tensors() {
        let Some(element) = Element::of_safetensors(info.dtype) else {
            continue;
        };
        let (start, end) = info.data_offsets;
        let (start, end) = (data_start + start, data_start + end);
        let entry = Entry::checked(element, info.shape.clone(), None, start, end)
            .map_err(|reason| format!("tensor `{name}`: {reason}"))?;
        entries.insert(name, entry);
    }
    Ok(entries)
}
