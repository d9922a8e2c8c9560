//! Tensor names without what wrappers of the network put into them.

use std::collections::BTreeMap;

/// What `torch.compile` puts before the names of what it compiled, which may be a part of the network.
const COMPILED: &str = "_orig_mod";
/// What distributed training and wrappers around an encoder put before all names.
const LEADING: [&str; 2] = ["module.", "backbone."];

/// Renames all entries. Where two would get the same name, both keep their own.
pub(super) fn clean<T: Clone>(entries: BTreeMap<String, T>) -> BTreeMap<String, T> {
    let mut cleaned = BTreeMap::new();
    for (name, entry) in &entries {
        if cleaned.insert(clean_name(name), entry.clone()).is_some() {
            return entries;
        }
    }
    cleaned
}

fn clean_name(name: &str) -> String {
    let components = name.split('.').filter(|part| *part != COMPILED);
    let name = components.collect::<Vec<_>>().join(".");
    let mut rest = name.as_str();
    while let Some(shorter) = LEADING.iter().find_map(|prefix| rest.strip_prefix(prefix)) {
        rest = shorter;
    }
    rest.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrappers_go_and_the_rest_stays() {
        for (name, expected) in [
            ("_orig_mod.blocks.0.weight", "blocks.0.weight"),
            ("module._orig_mod.x_proj.bias", "x_proj.bias"),
            ("module.backbone.norm.weight", "norm.weight"),
            ("blocks.1._orig_mod.attn.bias", "blocks.1.attn.bias"),
            ("encoder.module.weight", "encoder.module.weight"),
            ("backbones.0.weight", "backbones.0.weight"),
        ] {
            assert_eq!(clean_name(name), expected);
        }
    }

    #[test]
    fn names_that_would_become_equal_are_kept() {
        let both: BTreeMap<String, u8> = [("module.a".to_owned(), 1), ("a".to_owned(), 2)].into();
        assert_eq!(clean(both.clone()), both);
    }
}
