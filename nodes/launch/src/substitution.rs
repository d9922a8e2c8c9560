//! `$(…)` substitutions in launch files, with the grammar of ROS 2's launch frontends.
//!
//! A text is parsed once into a [`Template`]. It is resolved with a [`Lookup`] at its action, because actions change
//! variables and environment.

use thiserror::Error;

/// The deepest nesting of substitutions; the parser is recursive.
const DEPTH_LIMIT: usize = 16;

/// The known names, for error messages.
const KNOWN: &str = "var, env, dirname, filename, find-pkg-share, find-pkg-prefix, equals, not-equals, not, and, or";

#[derive(Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum SubstitutionError {
    /// A `$(` without `)`, or an unclosed quote.
    #[error("unterminated {what} in {text:?}")]
    Unterminated {
        /// `substitution` or `quote`.
        what: &'static str,
        text: String,
    },
    /// A `$` outside a substitution.
    #[error("expected $(name …) after '$' in {text:?}; a plain dollar sign is written \\$")]
    Dollar { text: String },
    #[error("substitutions nested more than {DEPTH_LIMIT} deep in {text:?}")]
    Depth { text: String },
    #[error("unknown substitution $({name}); known here: {KNOWN}")]
    Unknown { name: String },
    #[error("$({name}) takes {expected} argument(s), got {found}")]
    Arguments {
        name: String,
        expected: &'static str,
        found: usize,
    },
    /// `$(var x)` without an earlier `arg` or `let` named x.
    #[error(
        "launch variable {name:?} is not set here; declare it with `arg` or `let` before its use"
    )]
    Variable { name: String },
    /// `$(env X)` without a default although X is not set.
    #[error("environment variable {name:?} is not set and $(env {name}) has no default")]
    Environment { name: String },
    /// A package is not installed.
    #[error("package {name:?} was not found in AMENT_PREFIX_PATH")]
    Package { name: String },
    /// A value is not a boolean.
    #[error("expected true, false, 1 or 0, got {value:?}")]
    Boolean { value: String },
}

/// The values of substitutions.
pub trait Lookup {
    /// The launch variable `name`.
    fn variable(&self, name: &str) -> Option<String>;
    /// The environment variable `name` of the launched processes.
    fn environment(&self, name: &str) -> Option<String>;
    /// The folder of the launch file.
    fn dirname(&self) -> String;
    /// The name of the launch file.
    fn filename(&self) -> String;
    /// `<prefix>/share/<package>`.
    fn package_share(&self, package: &str) -> Option<String>;
    /// `<prefix>`.
    fn package_prefix(&self, package: &str) -> Option<String>;
}

/// A text with substitutions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Template(Vec<Fragment>);

#[derive(Clone, Debug, PartialEq, Eq)]
enum Fragment {
    Text(String),
    Call {
        name: String,
        arguments: Vec<Template>,
    },
}

impl Template {
    /// Parses `text`.
    ///
    /// # Errors
    /// A substitution is unterminated or malformed. [`Self::resolve`] detects unknown names.
    pub fn parse(text: &str) -> Result<Self, SubstitutionError> {
        let characters: Vec<char> = text.chars().collect();
        let mut parser = Parser {
            characters: &characters,
            at: 0,
            text,
        };
        let template = parser.template(End::Text, 0)?;
        Ok(template)
    }

    /// A text without substitutions.
    #[must_use]
    pub fn plain(text: String) -> Self {
        Self(vec![Fragment::Text(text)])
    }

    /// Whether it has no substitutions.
    #[must_use]
    pub fn is_plain(&self) -> bool {
        self.0
            .iter()
            .all(|fragment| matches!(fragment, Fragment::Text(_)))
    }

    /// The text with every substitution replaced.
    ///
    /// # Errors
    /// A substitution is unknown, has the wrong number of arguments, or has no value.
    pub fn resolve(&self, lookup: &dyn Lookup) -> Result<String, SubstitutionError> {
        let mut resolved = String::new();
        for fragment in &self.0 {
            match fragment {
                Fragment::Text(text) => resolved.push_str(text),
                Fragment::Call { name, arguments } => {
                    resolved.push_str(&call(name, arguments, lookup)?);
                }
            }
        }
        Ok(resolved)
    }

    /// The words of a command line: split at unquoted white space of the literal parts, never within the value of a
    /// substitution.
    ///
    /// # Errors
    /// See [`Self::resolve`]; or a quote is not closed.
    pub fn resolve_words(&self, lookup: &dyn Lookup) -> Result<Vec<String>, SubstitutionError> {
        let mut words = Vec::new();
        let mut word: Option<String> = None;
        let mut quote: Option<char> = None;
        for fragment in &self.0 {
            match fragment {
                Fragment::Call { name, arguments } => {
                    word.get_or_insert_default()
                        .push_str(&call(name, arguments, lookup)?);
                }
                Fragment::Text(text) => {
                    for character in text.chars() {
                        match (quote, character) {
                            (Some(open), _) if open == character => quote = None,
                            (Some(_), _) => word.get_or_insert_default().push(character),
                            (None, '\'' | '"') => {
                                quote = Some(character);
                                word.get_or_insert_default();
                            }
                            (None, _) if character.is_whitespace() => words.extend(word.take()),
                            (None, _) => word.get_or_insert_default().push(character),
                        }
                    }
                }
            }
        }
        if quote.is_some() {
            return Err(SubstitutionError::Unterminated {
                what: "quote",
                text: self.resolve(lookup)?,
            });
        }
        words.extend(word);
        Ok(words)
    }
}

/// `true`/`1` or `false`/`0` in any case, like the conditions of ROS 2's launch.
pub(super) fn parse_boolean(value: &str) -> Result<bool, SubstitutionError> {
    match value.trim().to_ascii_lowercase().as_str() {
        "true" | "1" => Ok(true),
        "false" | "0" => Ok(false),
        _ => Err(SubstitutionError::Boolean {
            value: value.to_owned(),
        }),
    }
}

fn call(
    name: &str,
    arguments: &[Template],
    lookup: &dyn Lookup,
) -> Result<String, SubstitutionError> {
    let values = arguments
        .iter()
        .map(|argument| argument.resolve(lookup))
        .collect::<Result<Vec<_>, _>>()?;
    let wrong = |expected| SubstitutionError::Arguments {
        name: name.to_owned(),
        expected,
        found: values.len(),
    };
    match (name, values.as_slice()) {
        ("var", [variable]) => {
            lookup
                .variable(variable)
                .ok_or_else(|| SubstitutionError::Variable {
                    name: variable.clone(),
                })
        }
        ("var", _) => Err(wrong("1")),
        ("env", [variable]) => {
            lookup
                .environment(variable)
                .ok_or_else(|| SubstitutionError::Environment {
                    name: variable.clone(),
                })
        }
        ("env", [variable, default]) => Ok(lookup
            .environment(variable)
            .unwrap_or_else(|| default.clone())),
        ("env", _) => Err(wrong("1 or 2")),
        ("dirname", []) => Ok(lookup.dirname()),
        ("filename", []) => Ok(lookup.filename()),
        ("dirname" | "filename", _) => Err(wrong("no")),
        ("find-pkg-share", [package]) => {
            lookup
                .package_share(package)
                .ok_or_else(|| SubstitutionError::Package {
                    name: package.clone(),
                })
        }
        ("find-pkg-prefix", [package]) => {
            lookup
                .package_prefix(package)
                .ok_or_else(|| SubstitutionError::Package {
                    name: package.clone(),
                })
        }
        ("find-pkg-share" | "find-pkg-prefix", _) => Err(wrong("1")),
        ("equals", [left, right]) => Ok(are_equal(left, right).to_string()),
        ("not-equals", [left, right]) => Ok((!are_equal(left, right)).to_string()),
        ("not", [value]) => Ok((!parse_boolean(value)?).to_string()),
        ("and", [left, right]) => Ok((parse_boolean(left)? & parse_boolean(right)?).to_string()),
        ("or", [left, right]) => Ok((parse_boolean(left)? | parse_boolean(right)?).to_string()),
        ("equals" | "not-equals" | "and" | "or", _) => Err(wrong("2")),
        ("not", _) => Err(wrong("1")),
        _ => Err(SubstitutionError::Unknown {
            name: name.to_owned(),
        }),
    }
}

/// Equality as in ROS 2's launch: of booleans (`true` equals `1`), then of numbers, then of texts.
fn are_equal(left: &str, right: &str) -> bool {
    if let (Ok(left), Ok(right)) = (parse_boolean(left), parse_boolean(right)) {
        return left == right;
    }
    if let (Ok(left), Ok(right)) = (left.trim().parse::<f64>(), right.trim().parse::<f64>()) {
        // as Python's math.isclose
        let scale = left.abs().max(right.abs());
        return left == right || (left - right).abs() <= 1e-9 * scale;
    }
    left == right
}

/// The end of a template.
#[derive(Clone, Copy, PartialEq, Eq)]
enum End {
    /// The end of the text.
    Text,
    /// A space or the closing parenthesis: an unquoted argument.
    Argument,
    /// This quote.
    Quote(char),
}

struct Parser<'a> {
    characters: &'a [char],
    at: usize,
    text: &'a str,
}

impl Parser<'_> {
    fn peek(&self) -> Option<char> {
        self.characters.get(self.at).copied()
    }

    fn template(&mut self, end: End, depth: usize) -> Result<Template, SubstitutionError> {
        if depth > DEPTH_LIMIT {
            return Err(SubstitutionError::Depth {
                text: self.text.to_owned(),
            });
        }
        let mut fragments = Vec::new();
        let mut text = String::new();
        loop {
            let Some(character) = self.peek() else {
                if let End::Quote(_) = end {
                    return Err(self.unterminated("quote"));
                }
                break;
            };
            match (end, character) {
                (End::Argument, ' ' | ')') => break,
                (End::Quote(quote), _) if quote == character => {
                    self.at += 1;
                    break;
                }
                (_, '\\') => {
                    self.at += 1;
                    // a backslash escapes the next character; at the end of the text it is literal
                    text.push(self.peek().unwrap_or('\\'));
                    self.at += 1;
                }
                (_, '$') => {
                    if !text.is_empty() {
                        fragments.push(Fragment::Text(std::mem::take(&mut text)));
                    }
                    fragments.push(self.call(depth)?);
                }
                _ => {
                    text.push(character);
                    self.at += 1;
                }
            }
        }
        if !text.is_empty() {
            fragments.push(Fragment::Text(text));
        }
        Ok(Template(fragments))
    }

    fn call(&mut self, depth: usize) -> Result<Fragment, SubstitutionError> {
        self.at += 1;
        if self.peek() != Some('(') {
            return Err(SubstitutionError::Dollar {
                text: self.text.to_owned(),
            });
        }
        self.at += 1;
        let mut name = String::new();
        while let Some(character) = self
            .peek()
            .filter(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_'))
        {
            name.push(character);
            self.at += 1;
        }
        if name.is_empty() {
            return Err(SubstitutionError::Dollar {
                text: self.text.to_owned(),
            });
        }
        let mut arguments = Vec::new();
        loop {
            match self.peek() {
                Some(')') => {
                    self.at += 1;
                    return Ok(Fragment::Call { name, arguments });
                }
                Some(' ') => self.at += 1,
                Some(quote @ ('\'' | '"')) => {
                    self.at += 1;
                    arguments.push(self.template(End::Quote(quote), depth + 1)?);
                }
                Some(_) => arguments.push(self.template(End::Argument, depth + 1)?),
                None => return Err(self.unterminated("substitution")),
            }
        }
    }

    fn unterminated(&self, what: &'static str) -> SubstitutionError {
        SubstitutionError::Unterminated {
            what,
            text: self.text.to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    struct Fixed;

    impl Lookup for Fixed {
        fn variable(&self, name: &str) -> Option<String> {
            (name == "bag").then(|| "my bag".to_owned())
        }
        fn environment(&self, name: &str) -> Option<String> {
            (name == "HOME").then(|| "/home/me".to_owned())
        }
        fn dirname(&self) -> String {
            "/launch".to_owned()
        }
        fn filename(&self) -> String {
            "x.launch.yaml".to_owned()
        }
        fn package_share(&self, package: &str) -> Option<String> {
            (package == "wm_nodes").then(|| "/opt/share/wm_nodes".to_owned())
        }
        fn package_prefix(&self, _: &str) -> Option<String> {
            None
        }
    }

    fn resolve(text: &str) -> Result<String, SubstitutionError> {
        Template::parse(text)?.resolve(&Fixed)
    }

    #[test]
    fn texts_and_substitutions_mix() {
        assert_eq!(resolve("out/$(var bag)/x").unwrap(), "out/my bag/x");
        assert_eq!(resolve("$(env HOME)").unwrap(), "/home/me");
        assert_eq!(resolve("$(env NONE 'a b')").unwrap(), "a b");
        assert_eq!(
            resolve("$(env NONE \"$(dirname)/y\")").unwrap(),
            "/launch/y"
        );
        assert_eq!(
            resolve("$(find-pkg-share wm_nodes)/bags").unwrap(),
            "/opt/share/wm_nodes/bags"
        );
        assert_eq!(resolve("$(not $(equals $(var bag) x))").unwrap(), "true");
        assert_eq!(resolve(r"costs 5\$").unwrap(), "costs 5$");
    }

    #[test]
    fn equality_compares_values_before_texts() {
        for (text, expected) in [
            ("$(equals True 1)", "true"),
            ("$(equals 1.0 1)", "true"),
            ("$(equals 2.50 2.5)", "true"),
            ("$(not-equals false 0)", "false"),
            ("$(equals a A)", "false"),
        ] {
            assert_eq!(resolve(text).unwrap(), expected, "{text}");
        }
    }

    #[test]
    fn faults_are_named() {
        assert_eq!(
            resolve("$(var other)").unwrap_err(),
            SubstitutionError::Variable {
                name: "other".into()
            }
        );
        assert_eq!(
            resolve("$(eval 1+1)").unwrap_err(),
            SubstitutionError::Unknown {
                name: "eval".into()
            }
        );
        assert!(matches!(
            resolve("$(var bag").unwrap_err(),
            SubstitutionError::Unterminated { .. }
        ));
        assert!(matches!(
            resolve("$(env X 'a").unwrap_err(),
            SubstitutionError::Unterminated { .. }
        ));
        assert!(matches!(
            resolve("a$b").unwrap_err(),
            SubstitutionError::Dollar { .. }
        ));
        assert!(matches!(
            resolve("$(var a b)").unwrap_err(),
            SubstitutionError::Arguments { found: 2, .. }
        ));
        let deep = "$(not ".repeat(40) + "true" + &")".repeat(40);
        assert!(matches!(
            resolve(&deep).unwrap_err(),
            SubstitutionError::Depth { .. }
        ));
    }

    #[test]
    fn substituted_value_is_one_word() {
        let words = Template::parse("play $(var bag) --x 'a b'  last")
            .unwrap()
            .resolve_words(&Fixed)
            .unwrap();
        assert_eq!(words, ["play", "my bag", "--x", "a b", "last"]);
        assert!(
            Template::parse("it's")
                .unwrap()
                .resolve_words(&Fixed)
                .is_err()
        );
    }

    proptest! {
        #[test]
        fn no_text_panics_the_parser(text in "[$()'\"\\\\ a-z]{0,40}") {
            if let Ok(template) = Template::parse(&text) {
                template.resolve(&Fixed).ok();
                template.resolve_words(&Fixed).ok();
            }
        }

        #[test]
        fn plain_text_stays(text in "[a-zA-Z0-9/_. ]{0,40}") {
            prop_assert_eq!(resolve(&text).unwrap(), text);
        }
    }
}
