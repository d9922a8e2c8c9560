//! Code in the documentation: spans, and the lines of blocks.

use pulldown_cmark::{Event, Tag, TagEnd};

use super::parser;

/// The code spans of a page, and the lines of its code blocks without their indentation. A line that ends with a backslash
/// continues in the next one.
pub fn code(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut block: Option<String> = None;
    for event in parser(text) {
        match event {
            Event::Start(Tag::CodeBlock(_)) => block = Some(String::new()),
            Event::End(TagEnd::CodeBlock) => {
                let block = block.take().unwrap_or_default().replace("\\\n", " ");
                found.extend(block.lines().map(|line| line.trim().to_owned()));
            }
            Event::Text(part) => {
                if let Some(block) = &mut block {
                    block.push_str(&part);
                }
            }
            Event::Code(span) => found.push(span.into_string()),
            _ => {}
        }
    }
    found
}

/// The code spans of a line of Markdown.
pub fn spans(line: &str) -> Vec<&str> {
    line.split('`').skip(1).step_by(2).collect()
}

/// The cells of the tables of a page from the heading `from` to the heading `to`, row by row.
///
/// # Panics
/// If a heading is missing.
pub fn rows<'a>(text: &'a str, from: &str, to: &str) -> Vec<Vec<&'a str>> {
    let (_, section) = text.split_once(from).expect(from);
    let (section, _) = section.split_once(to).expect(to);
    let rows = section.lines().filter_map(|line| line.strip_prefix("| "));
    rows.map(|row| {
        row.trim_end_matches('|')
            .split(" | ")
            .map(str::trim)
            .collect()
    })
    .collect()
}

#[test]
fn code_is_found_in_spans_and_blocks() {
    let text = "Use `wm nodes`.\n\n    wm a \\\n        --flag\n    wm b\n\nText `x`.\n";
    assert_eq!(code(text), ["wm nodes", "wm a      --flag", "wm b", "x"]);
    assert_eq!(spans("| `a`, `b` | c"), ["a", "b"]);
    assert_eq!(
        rows("## A\n\n| `a` | b |\n|---|---|\n\n## B\n", "## A", "## B"),
        [["`a`", "b"]]
    );
}
