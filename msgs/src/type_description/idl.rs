//! The part of OMG IDL that rosidl generates of `.msg` files: modules, structs, typedefs, sequences and strings.
//! <https://design.ros2.org/articles/idl_interface_definition.html>

use super::DescriptionError;
use std::collections::BTreeMap;

/// Limit of nested typedefs, of which rosidl writes none, and of nested modules, of which it writes two.
const DEPTH_LIMIT: usize = 16;

/// Reads IDL text with one or more structs; returns name (`package/msg/Type`) and `.msg` text of each. Annotations,
/// constants, comments and preprocessor lines are skipped.
///
/// # Errors
/// Text that is not IDL, or a type that `.msg` text cannot express (unions, maps, arrays of arrays).
pub fn idl_definitions(text: &str) -> Result<Vec<(String, String)>, DescriptionError> {
    let mut parser = Parser {
        tokens: tokens(text),
        at: 0,
        scope: Vec::new(),
        typedefs: BTreeMap::new(),
        structs: Vec::new(),
    };
    while parser.peek().is_some() {
        parser.definition()?;
    }
    Ok(parser.structs)
}

/// Words, and all other characters one by one. A quoted text becomes one token: only annotations and constants have any.
fn tokens(text: &str) -> Vec<String> {
    let mut tokens = Vec::new();
    let mut rest = text;
    let mut is_line_start = true;
    while let Some(first) = rest.chars().next() {
        let is_remark = rest.starts_with("//")
            || is_line_start
                && (first == '#' || rest.starts_with("IDL: ") || rest.starts_with("===="));
        let length = if is_remark {
            rest.find('\n').unwrap_or(rest.len())
        } else if rest.starts_with("/*") {
            rest.find("*/").map_or(rest.len(), |end| end + 2)
        } else if matches!(first, '"' | '\'') {
            let length = quoted(rest, first);
            tokens.push("\"\"".to_owned());
            length
        } else if first.is_alphanumeric() || first == '_' {
            let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_' && c != '.');
            let end = end.unwrap_or(rest.len());
            tokens.extend(rest.get(..end).map(str::to_owned));
            end
        } else {
            if !first.is_whitespace() {
                tokens.push(first.to_string());
            }
            first.len_utf8()
        };
        is_line_start = first == '\n' || (is_line_start && first.is_whitespace());
        // A token ends at a character of the text; each is at least one character long.
        rest = rest.get(length..).unwrap_or("");
    }
    tokens
}

/// Length of a quoted text, with its quotes.
fn quoted(rest: &str, quote: char) -> usize {
    let mut is_escaped = false;
    for (at, c) in rest.char_indices().skip(1) {
        match c {
            '\\' if !is_escaped => is_escaped = true,
            c if c == quote && !is_escaped => return at + 1,
            _ => is_escaped = false,
        }
    }
    rest.len()
}

struct Parser {
    tokens: Vec<String>,
    at: usize,
    /// The enclosing modules.
    scope: Vec<String>,
    /// `.msg` type of each typedef, by its name with the enclosing modules.
    typedefs: BTreeMap<String, String>,
    structs: Vec<(String, String)>,
}

impl Parser {
    fn peek(&self) -> Option<&str> {
        self.tokens.get(self.at).map(String::as_str)
    }

    fn next(&mut self) -> Result<String, DescriptionError> {
        let token = self.tokens.get(self.at).cloned();
        self.at += 1;
        token.ok_or_else(|| DescriptionError::Idl {
            expected: "more".to_owned(),
            found: "the end of the text".to_owned(),
        })
    }

    fn expect(&mut self, expected: &str) -> Result<(), DescriptionError> {
        let found = self.next()?;
        if found == expected {
            return Ok(());
        }
        Err(wrong(expected, &found))
    }

    fn definition(&mut self) -> Result<(), DescriptionError> {
        match self.next()?.as_str() {
            "@" => self.annotation(),
            ";" => Ok(()),
            "}" if !self.scope.is_empty() => {
                self.scope.pop();
                Ok(())
            }
            "module" => {
                let name = self.next()?;
                if self.scope.len() >= DEPTH_LIMIT {
                    return Err(wrong("fewer modules within modules", &name));
                }
                self.scope.push(name);
                self.expect("{")
            }
            "const" => {
                while self.next()? != ";" {}
                Ok(())
            }
            "typedef" => {
                let element = self.field_type()?;
                let name = self.next()?;
                let shape = self.array()?;
                self.expect(";")?;
                let typed = joined(&element, &shape)?;
                self.typedefs.insert(scoped(&self.scope, &name), typed);
                Ok(())
            }
            "struct" => self.structure(),
            other => Err(wrong("a module, a struct or a typedef", other)),
        }
    }

    /// The name of an annotation, and its arguments.
    fn annotation(&mut self) -> Result<(), DescriptionError> {
        self.next()?;
        let mut depth = 0_usize;
        while depth > 0 || self.peek() == Some("(") {
            match self.next()?.as_str() {
                "(" => depth += 1,
                ")" => depth = depth.saturating_sub(1),
                _ => {}
            }
            if depth == 0 {
                break;
            }
        }
        Ok(())
    }

    fn structure(&mut self) -> Result<(), DescriptionError> {
        let name = self.next()?;
        self.expect("{")?;
        let mut text = String::new();
        loop {
            match self.peek() {
                Some("}") => break,
                Some("@") => {
                    self.next()?;
                    self.annotation()?;
                    continue;
                }
                _ => {}
            }
            let element = self.field_type()?;
            let field = self.next()?;
            let shape = self.array()?;
            self.expect(";")?;
            text.push_str(&format!("{} {field}\n", joined(&element, &shape)?));
        }
        self.next()?;
        let name = scoped(&self.scope, &name).replace("::", "/");
        self.structs.push((name, text));
        Ok(())
    }

    /// The length of an array after a name; empty for other types.
    fn array(&mut self) -> Result<String, DescriptionError> {
        if self.peek() != Some("[") {
            return Ok(String::new());
        }
        self.next()?;
        let length = self.next()?;
        self.expect("]")?;
        Ok(format!("[{length}]"))
    }

    /// A type in the syntax of `.msg` text.
    fn field_type(&mut self) -> Result<String, DescriptionError> {
        let word = self.next()?;
        let text = match word.as_str() {
            "sequence" => {
                self.expect("<")?;
                // Without recursion: a hostile bag may nest sequences without end.
                if self.peek() == Some("sequence") {
                    return Err(wrong("an array of one dimension", "sequence<sequence>"));
                }
                let element = self.field_type()?;
                let limit = self.limit()?;
                return joined(&element, &format!("[{limit}]"));
            }
            "string" | "wstring" if self.peek() == Some("<") => {
                self.next()?;
                let limit = self.next()?;
                self.expect(">")?;
                return Ok(format!("{word}<={limit}"));
            }
            "unsigned" => return self.integer("u"),
            "short" | "long" => {
                self.at -= 1;
                return self.integer("");
            }
            "boolean" => "bool",
            "octet" => "byte",
            "float" => "float32",
            "double" => "float64",
            other => other,
        };
        let mut name = text.to_owned();
        while self.peek() == Some(":") {
            self.next()?;
            self.expect(":")?;
            name = format!("{name}::{}", self.next()?);
        }
        Ok(self.resolved(&name))
    }

    fn integer(&mut self, sign: &str) -> Result<String, DescriptionError> {
        let bits = match (self.next()?.as_str(), self.peek()) {
            ("short", _) => 16,
            ("long", Some("long")) => {
                self.next()?;
                64
            }
            ("long", Some("double")) => return Err(wrong("a type of ROS", "long double")),
            ("long", _) => 32,
            (other, _) => return Err(wrong("short or long", other)),
        };
        Ok(format!("{sign}int{bits}"))
    }

    /// The bound of a sequence, in the syntax of `.msg` text.
    fn limit(&mut self) -> Result<String, DescriptionError> {
        match self.next()?.as_str() {
            ">" => Ok(String::new()),
            "," => {
                let limit = self.next()?;
                self.expect(">")?;
                Ok(format!("<={limit}"))
            }
            other => Err(wrong("> or a bound", other)),
        }
    }

    /// The type of a typedef, searched from the innermost module outwards; else the name of a message type.
    fn resolved(&self, name: &str) -> String {
        let mut name = name.to_owned();
        for _ in 0..DEPTH_LIMIT {
            let scopes = (0..=self.scope.len()).rev();
            let found = scopes
                .filter_map(|depth| self.scope.get(..depth))
                .find_map(|scope| self.typedefs.get(&scoped(scope, &name)));
            match found {
                Some(typed) => name.clone_from(typed),
                None => break,
            }
        }
        name.replace("::", "/")
    }
}

/// A name with its enclosing modules.
fn scoped(scope: &[String], name: &str) -> String {
    let parts = scope.iter().map(String::as_str).chain([name]);
    parts.collect::<Vec<_>>().join("::")
}

/// A type with the shape of an array or sequence.
fn joined(element: &str, shape: &str) -> Result<String, DescriptionError> {
    match element.contains('[') && !shape.is_empty() {
        true => Err(wrong(
            "an array of one dimension",
            &format!("{element}{shape}"),
        )),
        false => Ok(format!("{element}{shape}")),
    }
}

fn wrong(expected: &str, found: &str) -> DescriptionError {
    DescriptionError::Idl {
        expected: expected.to_owned(),
        found: found.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{TypeDescription, sensor_msgs::CameraInfo, std_msgs};
    use proptest::prelude::*;

    /// In the form that rosidl_adapter writes and rosbag2 stores.
    const INFO: &str = r#"
================================================================================
IDL: sensor_msgs/msg/RegionOfInterest
// generated from rosidl_adapter/resource/msg.idl.em
#include "std_msgs/msg/Header.idl"

module sensor_msgs {
  module msg {
    module RegionOfInterest_Constants {
      const uint32 NONE = 0;
    };
    @verbatim (language="comment", text=
      "A (region), see \"binning\"; // no comment" "\n"
      "} more")
    struct RegionOfInterest {
      uint32 x_offset;
      uint32 y_offset;
      uint32 height;
      uint32 width;
      @default (value=FALSE)
      boolean do_rectify;
    };
  };
};
================================================================================
IDL: sensor_msgs/msg/CameraInfo
module sensor_msgs {
  module msg {
    typedef double double__9[9];
    typedef double double__12[12];
    struct CameraInfo {
      std_msgs::msg::Header header;
      unsigned long height;
      uint32 width;
      string distortion_model;
      sequence<double> d;
      double__9 k;
      double__9 r;
      double__12 p;
      /* both */ uint32 binning_x;
      uint32 binning_y;
      sensor_msgs::msg::RegionOfInterest roi;
    };
  };
};
"#;

    #[test]
    fn idl_describes_the_same_type_as_its_msg() {
        let definitions = idl_definitions(INFO).unwrap();
        let (name, text) = definitions.last().unwrap();
        let header = <std_msgs::Header as crate::Message>::dependencies();
        let given = definitions
            .iter()
            .map(|(name, text)| (name.as_str(), text.as_str()));
        let given = given.chain(header).chain([(
            "std_msgs/msg/Header",
            <std_msgs::Header as crate::Message>::DEFINITION,
        )]);
        let described = TypeDescription::message(name, text, given).unwrap();
        assert_eq!(described, TypeDescription::of::<CameraInfo>().unwrap());
    }

    #[test]
    fn bounds_and_old_names_of_integers_are_read() {
        let text = "module p { module msg { typedef string<5> word; struct T { sequence<word, 3> a; long long b; \
                    unsigned short c; octet d; float e[2]; p::msg::Other f; }; }; };";
        let expected = "string<=5[<=3] a\nint64 b\nuint16 c\nbyte d\nfloat32[2] e\np/msg/Other f\n";
        assert_eq!(
            idl_definitions(text).unwrap(),
            [("p/msg/T".to_owned(), expected.to_owned())]
        );
        for wrong in [
            "struct",
            "union U {};",
            "module p { struct T { sequence<sequence<octet>> x; }; };",
            "}",
        ] {
            assert!(idl_definitions(wrong).is_err(), "{wrong}");
        }
    }

    /// These texts once overflowed the stack, or took hours.
    #[test]
    fn deeply_nested_types_and_modules_are_refused() {
        let sequences = format!("struct T {{ {}octet x; }};", "sequence<".repeat(200_000));
        let modules = "module a { ".repeat(200_000);
        for text in [sequences, modules] {
            assert!(idl_definitions(&text).is_err());
        }
    }

    proptest! {
        /// Any text gives definitions or an error, never a panic.
        #[test]
        fn any_text_gives_definitions_or_an_error(
            text in "(module |struct |typedef |[a-z]{1,3} |[{};<>,:@()\\[\\]\"'#/*\n ]|1 |\u{e4}){0,40}",
        ) {
            idl_definitions(&text).ok();
        }
    }
}
