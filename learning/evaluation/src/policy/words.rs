//! Splits a command line into words.

use anyhow::{Result, ensure};

/// The words of a command, as split by a shell: quotes keep spaces, and outside single quotes a backslash keeps the
/// next character. Nothing is expanded.
pub(super) fn words(command: &str) -> Result<Vec<String>> {
    let mut words = Vec::new();
    let mut word: Option<String> = None;
    let mut quote = None;
    let mut characters = command.chars();
    while let Some(character) = characters.next() {
        match (quote, character) {
            (Some(open), close) if open == close => quote = None,
            (Some('\''), other) => word.get_or_insert_default().push(other),
            (_, '\\') => {
                let kept = characters.next();
                ensure!(kept.is_some(), "{command}: ends with a backslash");
                word.get_or_insert_default().extend(kept);
            }
            (Some(_), other) => word.get_or_insert_default().push(other),
            (None, '"' | '\'') => {
                quote = Some(character);
                word.get_or_insert_default();
            }
            (None, space) if space.is_whitespace() => words.extend(word.take()),
            (None, other) => word.get_or_insert_default().push(other),
        }
    }
    ensure!(quote.is_none(), "{command}: unclosed quote");
    words.extend(word);
    ensure!(!words.is_empty(), "the command of the policy is empty");
    Ok(words)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn words_are_split_as_by_a_shell() {
        for (command, expected) in [
            ("python3 policy.py", vec!["python3", "policy.py"]),
            ("  a\t b ", vec!["a", "b"]),
            ("a 'b \"c' \"d 'e\"", vec!["a", "b \"c", "d 'e"]),
            (r#"a\ b "c\"d" 'e\f'"#, vec!["a b", "c\"d", "e\\f"]),
            ("a '' b", vec!["a", "", "b"]),
            ("x=$HOME/*", vec!["x=$HOME/*"]),
        ] {
            assert_eq!(words(command).unwrap(), expected, "{command}");
        }
        for (command, named) in [("", "empty"), ("a 'b", "unclosed"), ("a\\", "backslash")] {
            let error = words(command).unwrap_err().to_string();
            assert!(error.contains(named), "{error}");
        }
    }

    proptest! {
        #[test]
        fn quoted_words_round_trip(all in prop::collection::vec("[^']{0,12}", 1..6)) {
            let quoted: Vec<String> = all.iter().map(|word| format!("'{word}'")).collect();
            prop_assert_eq!(words(&quoted.join(" ")).unwrap(), all);
        }

        #[test]
        fn no_command_panics(command in "(?s).{0,60}") {
            words(&command).ok();
        }
    }
}
