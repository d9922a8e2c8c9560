//! HTML that is balanced and escaped by construction.

/// A document.
#[derive(Default)]
pub(super) struct Markup {
    text: String,
}

/// Attributes by name.
pub(super) type Attributes<'a> = &'a [(&'static str, &'a str)];

impl Markup {
    /// An element and what is inside it.
    pub(super) fn element(
        &mut self,
        tag: &'static str,
        attributes: Attributes<'_>,
        inside: impl FnOnce(&mut Self),
    ) {
        self.open(tag, attributes);
        self.text.push('>');
        inside(self);
        self.text.push_str("</");
        self.text.push_str(tag);
        self.text.push('>');
        if BLOCKS.contains(&tag) {
            self.text.push('\n');
        }
    }

    /// An element with text only.
    pub(super) fn leaf(&mut self, tag: &'static str, attributes: Attributes<'_>, text: &str) {
        self.element(tag, attributes, |markup| markup.text(text));
    }

    /// An element without content: `meta`, `img`, or a shape of SVG.
    pub(super) fn void(&mut self, tag: &'static str, attributes: Attributes<'_>) {
        self.open(tag, attributes);
        self.text.push_str("/>");
    }

    pub(super) fn text(&mut self, text: &str) {
        escape(text, &mut self.text);
    }

    /// Trusted text that is not escaped: a doctype, a style sheet.
    pub(super) fn raw(&mut self, text: &'static str) {
        self.text.push_str(text);
    }

    /// Text for screen readers only.
    pub(super) fn spoken(&mut self, text: &str) {
        self.leaf("span", &[("class", "spoken")], text);
    }

    pub(super) fn finish(self) -> String {
        self.text
    }

    fn open(&mut self, tag: &'static str, attributes: Attributes<'_>) {
        self.text.push('<');
        self.text.push_str(tag);
        for (name, value) in attributes {
            self.text.push(' ');
            self.text.push_str(name);
            self.text.push_str("=\"");
            escape(value, &mut self.text);
            self.text.push('"');
        }
    }
}

/// Elements followed by a line break, so that the source is readable.
const BLOCKS: [&str; 16] = [
    "dd", "details", "div", "figure", "h1", "h2", "h3", "header", "li", "p", "section", "style",
    "svg", "table", "tr", "ul",
];

/// Escapes text for content and attributes. Control characters, which HTML forbids, and characters that change the text
/// direction, which could disguise a name, become the replacement character.
pub(super) fn escape(text: &str, into: &mut String) {
    for character in text.chars() {
        match character {
            '&' => into.push_str("&amp;"),
            '<' => into.push_str("&lt;"),
            '>' => into.push_str("&gt;"),
            '"' => into.push_str("&quot;"),
            '\'' => into.push_str("&#39;"),
            '\n' | '\t' => into.push(character),
            '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' => into.push('\u{fffd}'),
            _ if character.is_control() => into.push('\u{fffd}'),
            _ => into.push(character),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn unescape(text: &str) -> String {
        text.replace("&lt;", "<")
            .replace("&gt;", ">")
            .replace("&quot;", "\"")
            .replace("&#39;", "'")
            .replace("&amp;", "&")
    }

    proptest! {
        #[test]
        fn any_text_is_escaped(text: String) {
            let mut escaped = String::new();
            escape(&text, &mut escaped);
            prop_assert!(!escaped.contains(['<', '>', '"', '\'', '\0']));
            let kept: String = text.chars().filter(|c| !c.is_control()).collect();
            let told: String = unescape(&escaped).chars().filter(|c| !c.is_control()).collect();
            if !text.chars().any(|c| matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')) {
                prop_assert_eq!(kept.replace('\u{fffd}', ""), told.replace('\u{fffd}', ""));
            }
        }
    }

    #[test]
    fn attributes_are_escaped() {
        let mut markup = Markup::default();
        markup.element("b", &[("title", "\"><script>")], |markup| {
            markup.text("a<b");
        });
        assert_eq!(
            markup.finish(),
            "<b title=\"&quot;&gt;&lt;script&gt;\">a&lt;b</b>"
        );
    }
}
