//! Foreign text in messages.

/// Characters of foreign text in a message.
pub(crate) const EXCERPT_CHARS: usize = 300;

/// The start of a text; characters that a terminal may obey or reorder by are escaped.
pub(crate) fn excerpt(text: &str) -> String {
    let mut out = String::new();
    let mut chars = text.trim().chars();
    for c in chars.by_ref().take(EXCERPT_CHARS) {
        if c.is_control() || is_bidi(c) {
            out.extend(c.escape_default());
        } else {
            out.push(c);
        }
    }
    if chars.next().is_some() {
        out.push('…');
    }
    out
}

/// The end of a text, escaped: where an answer should have its score.
pub(crate) fn excerpt_of_end(text: &str) -> String {
    let text = text.trim();
    let skipped = text.chars().count().saturating_sub(EXCERPT_CHARS);
    let start = text.char_indices().nth(skipped).map_or(0, |(at, _)| at);
    let end = excerpt(text.get(start..).unwrap_or(text));
    if skipped > 0 {
        format!("…{end}")
    } else {
        end
    }
}

/// Unicode marks, embeddings, overrides and isolates of direction, and line separators.
fn is_bidi(c: char) -> bool {
    matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn excerpt_is_bounded_and_escaped() {
        assert_eq!(excerpt(" a\x1b[2Jb\u{202e}c\n "), "a\\u{1b}[2Jb\\u{202e}c");
        let long = "ä".repeat(EXCERPT_CHARS + 1);
        assert_eq!(excerpt(&long).chars().count(), EXCERPT_CHARS + 1);
        let end = excerpt_of_end(&format!("x{long}end"));
        assert!(end.starts_with('…') && end.ends_with("end"), "{end}");
        assert_eq!(excerpt_of_end("short"), "short");
    }
}
