//! A reader of `.msg` text: as much of the grammar as the suite's definitions use.

/// How often a field has its type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Count {
    One,
    /// As often as it says itself.
    Sequence,
    /// So many times.
    Array(usize),
}

/// One field: its type (`pkg/msg/Type` or a primitive as the wire has it), how often it has it, its name.
#[derive(Debug, PartialEq, Eq)]
pub struct Field {
    pub type_name: String,
    pub count: Count,
    pub name: String,
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
        let line = line.split('#').next().unwrap_or_default().trim();
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
        let (type_name, count) = match type_name.strip_suffix(']').map(|text| text.split_once('['))
        {
            None => (type_name, Count::One),
            Some(Some((element, ""))) => (element, Count::Sequence),
            Some(Some((element, length))) => (element, Count::Array(length.parse().unwrap())),
            Some(None) => panic!("expected a type, got `{type_name}`"),
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
        // What follows the name is a default value, which serde's view of a type does not have.
        let name = rest.split_whitespace().next().unwrap().to_owned();
        interface.fields.push(Field {
            type_name,
            count,
            name,
        });
    }
    interface
}
