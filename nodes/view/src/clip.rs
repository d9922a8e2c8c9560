//! Cuts texts and lists from outside before they are kept, so that the state is bounded.

/// The first `limit` bytes of a text, cut between characters; an ellipsis marks the cut.
pub(crate) fn text(text: &str, limit: usize) -> String {
    if text.len() <= limit {
        return text.to_owned();
    }
    let (start, _) = text.split_at(text.floor_char_boundary(limit));
    format!("{start}…")
}

pub(crate) fn list<T: Clone>(list: &[T], limit: usize) -> Vec<T> {
    list.iter().take(limit).cloned().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_text_is_cut_between_characters(whole in ".{0,40}", limit in 0usize..50) {
            let cut = text(&whole, limit);
            prop_assert!(cut.len() <= limit + '…'.len_utf8());
            prop_assert!(cut == whole || whole.starts_with(cut.trim_end_matches('…')));
        }
    }
}
