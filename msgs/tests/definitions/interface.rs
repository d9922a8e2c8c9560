//! A reader of `.msg` text: as much of the grammar as the suite's definitions use.

/// One field: its type (`pkg/msg/Type` or a primitive as the wire has it), how many of it, its name.
#[derive(Debug, PartialEq, Eq)]
pub struct Field {
    pub type_name: String,
    pub number: Number,
    pub name: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Number {
    One,
    Array(usize),
    Sequence,
}

/// Fields in order, and constants as (name, value).
#[derive(Debug, PartialEq, Eq)]
pub struct Interface {
    pub fields: Vec<Field>,
    pub constants: Vec<(String, String)>,
}

const PRIMITIVES: [&str; 12] = [
    "bool", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32",
    "float64", "string",
];

/// Parses the text of one definition of `package`; types without a package are of the same one.
pub fn parse(package: &str, text: &str) -> Interface {
    let mut interface = Interface {
        fields: Vec::new(),
        constants: Vec::new(),
    };
    for line in text.lines() {
        let line = line.split('#').next().unwrap().trim();
        let Some((type_name, rest)) = line.split_once(char::is_whitespace) else {
            assert!(line.is_empty(), "expected `type name`, got `{line}`");
            continue;
        };
        if let Some((name, value)) = rest.split_once('=') {
            interface
                .constants
                .push((name.trim().to_owned(), value.trim().to_owned()));
            continue;
        }
        let (type_name, number) = match type_name.trim_end_matches(']').split_once('[') {
            None => (type_name, Number::One),
            Some((element, limit)) if limit.is_empty() || limit.starts_with("<=") => {
                (element, Number::Sequence)
            }
            Some((element, length)) => (element, Number::Array(length.parse().unwrap())),
        };
        let type_name = match type_name {
            "byte" | "char" => "uint8".to_owned(),
            primitive if PRIMITIVES.contains(&primitive) => primitive.to_owned(),
            other => match other.split('/').collect::<Vec<_>>()[..] {
                [name] => format!("{package}/msg/{name}"),
                [package, name] | [package, "msg", name] => format!("{package}/msg/{name}"),
                _ => panic!("expected a type name, got `{other}`"),
            },
        };
        // A default value may follow the name; serde's view of a type has none.
        let name = rest.split_whitespace().next().unwrap().to_owned();
        interface.fields.push(Field {
            type_name,
            number,
            name,
        });
    }
    interface
}
