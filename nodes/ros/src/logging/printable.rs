//! Makes text of peers safe to print: it must not move the cursor, forge a line of the log or fill the screen.

use std::fmt::Write as _;

/// The longest printed text of a peer or a file \[character\].
pub(crate) const OF_OTHERS: usize = 512;

/// The longest printed record \[character\]. Larger than our own records with any text of peers.
pub(super) const RECORD: usize = 4096;

/// Makes a peer's text safe to print on a terminal: control characters become escape sequences, and at most 512
/// characters are kept.
#[must_use]
pub fn of_others(text: &str) -> String {
    printable(text, OF_OTHERS)
}

/// The text with control characters as escape sequences (`\n`, `\u{1b}`), cut off after `most` characters.
pub(crate) fn printable(text: &str, most: usize) -> String {
    let mut shown = String::with_capacity(text.len().min(most));
    let mut characters = text.chars();
    for character in characters.by_ref().take(most) {
        if is_unsafe(character) {
            shown.extend(character.escape_default());
        } else {
            shown.push(character);
        }
    }
    let rest = characters.count();
    if rest > 0 {
        // writing into a String cannot fail
        write!(shown, "... ({rest} more characters)").ok();
    }
    shown
}

/// Control characters, ends of lines and paragraphs, and marks that reverse the direction of what follows
/// (CVE-2021-42574).
fn is_unsafe(character: char) -> bool {
    character.is_control() || matches!(character, '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_escaped_and_the_rest_stays() {
        let forged = "cam\u{1b}[2J\r\n[ERROR] [1.0] [wm.planner]: stop\u{202e}\u{9b}";
        assert_eq!(
            printable(forged, OF_OTHERS),
            "cam\\u{1b}[2J\\r\\n[ERROR] [1.0] [wm.planner]: stop\\u{202e}\\u{9b}"
        );
        assert_eq!(printable("Tür \u{2192} 'x'", OF_OTHERS), "Tür \u{2192} 'x'");
    }

    #[test]
    fn long_text_is_cut_and_says_so() {
        let shown = printable(&"é".repeat(600), OF_OTHERS);
        assert!(shown.ends_with("é... (88 more characters)"), "{shown}");
        assert_eq!(shown.matches('é').count(), 512);
    }
}
