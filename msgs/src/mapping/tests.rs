use super::*;
use crate::{Message as _, cdr, std_msgs, wm_msgs::Action};
use proptest::prelude::*;
use std::fmt::Write as _;

/// The type of a generated field.
#[derive(Clone, Debug)]
enum Kind {
    Number(&'static str),
    Text,
    Struct(Vec<Named>),
}

#[derive(Clone, Debug)]
enum Shape {
    One,
    Array(usize),
    Sequence,
}

/// A field with its value: one per element, and of a struct one per member.
#[derive(Clone, Debug)]
struct Named {
    name: String,
    kind: Kind,
    shape: Shape,
    values: Vec<Value>,
}

#[derive(Clone, Debug)]
enum Value {
    Number(u8),
    Text(String),
    Struct(Vec<Named>),
}

const NUMBERS: [(&str, usize); 11] = [
    ("bool", 1),
    ("byte", 1),
    ("int8", 1),
    ("uint8", 1),
    ("int16", 2),
    ("uint16", 2),
    ("int32", 4),
    ("uint32", 4),
    ("float32", 4),
    ("int64", 8),
    ("float64", 8),
];

/// A number's bytes, little endian: small values of every type.
fn number(name: &str, value: u8) -> Vec<u8> {
    match name {
        "bool" => vec![value % 2],
        "float32" => (f32::from(value) - 99.0).to_le_bytes().to_vec(),
        "float64" => (f64::from(value) - 99.0).to_le_bytes().to_vec(),
        "int16" => (i16::from(value) - 99).to_le_bytes().to_vec(),
        "uint16" => u16::from(value).to_le_bytes().to_vec(),
        "int32" => (i32::from(value) - 99).to_le_bytes().to_vec(),
        "uint32" => u32::from(value).to_le_bytes().to_vec(),
        "int64" => (i64::from(value) - 99).to_le_bytes().to_vec(),
        _ => vec![value],
    }
}

/// Encodes by the standard, in one pass.
struct Writer {
    body: Vec<u8>,
    is_little: bool,
    largest: usize,
}

impl Writer {
    fn put(&mut self, mut bytes: Vec<u8>) {
        let alignment = bytes.len().min(self.largest);
        self.body
            .resize(self.body.len().next_multiple_of(alignment), 0);
        if !self.is_little {
            bytes.reverse();
        }
        self.body.extend(bytes);
    }

    fn fields(&mut self, fields: &[Named]) {
        for field in fields {
            if matches!(field.shape, Shape::Sequence) {
                self.put((field.values.len() as u32).to_le_bytes().to_vec());
            }
            for value in &field.values {
                match (value, &field.kind) {
                    (Value::Number(value), Kind::Number(name)) => self.put(number(name, *value)),
                    (Value::Text(text), _) => {
                        self.put((text.len() as u32 + 1).to_le_bytes().to_vec());
                        self.body.extend(text.as_bytes());
                        self.body.push(0);
                    }
                    (Value::Struct(fields), _) => self.fields(fields),
                    other => panic!("{other:?}"),
                }
            }
        }
    }
}

fn encode(fields: &[Named], representation: u8) -> Vec<u8> {
    let mut writer = Writer {
        body: Vec::new(),
        is_little: representation % 2 == 1,
        largest: if representation < 6 { 8 } else { 4 },
    };
    writer.fields(fields);
    [vec![0, representation, 0, 0], writer.body].concat()
}

/// The `.msg` texts; the first text is the message itself.
fn texts(fields: &[Named], name: &str, texts: &mut Vec<(String, String)>) {
    let place = texts.len();
    texts.push((format!("p/msg/{name}"), String::new()));
    let mut own = String::new();
    for field in fields {
        let base = match &field.kind {
            Kind::Number(name) => (*name).to_owned(),
            Kind::Text => "string".to_owned(),
            Kind::Struct(fields) => {
                let nested = format!("{name}{}", field.name);
                self::texts(fields, &nested, texts);
                nested
            }
        };
        let shape = match field.shape {
            Shape::One => String::new(),
            Shape::Array(length) => format!("[{length}]"),
            Shape::Sequence => "[]".to_owned(),
        };
        writeln!(own, "{base}{shape} {}", field.name).unwrap();
    }
    texts[place].1 = own;
}

fn description(fields: &[Named]) -> TypeDescription {
    let mut all = Vec::new();
    texts(fields, "T", &mut all);
    let dependencies = all
        .iter()
        .skip(1)
        .map(|(name, text)| (name.as_str(), text.as_str()));
    TypeDescription::message("p/msg/T", &all[0].1, dependencies).unwrap()
}

/// The field of a message that was written without it.
fn default(field: &Named) -> Named {
    let count = match field.shape {
        Shape::One => 1,
        Shape::Array(length) => length,
        Shape::Sequence => 0,
    };
    let value = match &field.kind {
        Kind::Number(name) => Value::Number(match *name {
            "int16" | "int32" | "int64" | "float32" | "float64" => 99,
            _ => 0,
        }),
        Kind::Text => Value::Text(String::new()),
        Kind::Struct(fields) => Value::Struct(fields.iter().map(default).collect()),
    };
    Named {
        values: vec![value; count],
        ..field.clone()
    }
}

fn shape() -> impl Strategy<Value = Shape> {
    prop_oneof![
        Just(Shape::One),
        (1usize..4).prop_map(Shape::Array),
        Just(Shape::Sequence)
    ]
}

fn kind() -> impl Strategy<Value = Kind> {
    let leaf = prop_oneof![
        4 => prop::sample::select(&NUMBERS[..]).prop_map(|(name, _)| Kind::Number(name)),
        1 => Just(Kind::Text),
    ];
    leaf.prop_recursive(2, 12, 4, |inner| {
        prop::collection::vec((inner, shape()), 1..4).prop_map(|fields| {
            let named = fields
                .into_iter()
                .enumerate()
                .map(|(number, (kind, shape))| Named {
                    name: format!("f{number}"),
                    kind,
                    shape,
                    values: Vec::new(),
                });
            Kind::Struct(named.collect())
        })
    })
}

/// Fills a field with values drawn from these bytes.
fn filled(field: &Named, bytes: &mut impl Iterator<Item = u8>) -> Named {
    let mut next = || bytes.next().unwrap_or(7);
    let count = match field.shape {
        Shape::One => 1,
        Shape::Array(length) => length,
        Shape::Sequence => usize::from(next() % 4),
    };
    let values = (0..count).map(|_| match &field.kind {
        Kind::Number(_) => Value::Number(bytes.next().unwrap_or(3)),
        Kind::Text => Value::Text("x".repeat(usize::from(bytes.next().unwrap_or(2) % 6))),
        Kind::Struct(fields) => Value::Struct(fields.iter().map(|f| filled(f, bytes)).collect()),
    });
    Named {
        values: values.collect(),
        ..field.clone()
    }
}

/// Fields with values, of any type of ROS.
fn fields() -> impl Strategy<Value = Vec<Named>> {
    let fields = prop::collection::vec((kind(), shape()), 1..6);
    (fields, prop::collection::vec(any::<u8>(), 64)).prop_map(|(fields, bytes)| {
        let mut bytes = bytes.into_iter().cycle();
        let named = fields
            .into_iter()
            .enumerate()
            .map(|(number, (kind, shape))| {
                let name = format!("g{number}");
                let values = Vec::new();
                filled(
                    &Named {
                        name,
                        kind,
                        shape,
                        values,
                    },
                    &mut bytes,
                )
            });
        named.collect()
    })
}

proptest! {
    /// The layout finds the end of every message, in either byte order and version.
    #[test]
    fn own_messages_convert_to_themselves(fields in fields(), padding in 0usize..4) {
        let description = description(&fields);
        let mapping = Mapping::new(&description, &description).unwrap();
        let layout = Layout::of(&description).unwrap();
        let plain = encode(&fields, 1);
        for representation in [0, 1, 6, 7] {
            let mut bytes = encode(&fields, representation);
            bytes.extend(vec![0; padding]);
            layout.check(&bytes).unwrap();
            prop_assert_eq!(&mapping.convert(&bytes).unwrap(), &plain);
            bytes.extend([0; 4]);
            prop_assert!(layout.check(&bytes).is_err());
        }
        prop_assert!(layout.check(&plain[..plain.len() - 1]).is_err());
    }

    /// Fields in another order, more and fewer of them, at the top and in nested types.
    #[test]
    fn fields_are_matched_by_name(
        fields in fields(), more in fields(), turn in 0usize..6, lacking in any::<prop::sample::Index>(),
    ) {
        let lacking = lacking.index(fields.len());
        let mut theirs: Vec<Named> = fields.clone();
        if fields.len() > 1 {
            theirs.remove(lacking);
        }
        let extra = more.into_iter().map(|field| Named { name: format!("x{}", field.name), ..field });
        let extra: Vec<Named> = extra.collect();
        theirs.extend(extra.clone());
        let turn = turn % theirs.len();
        theirs.rotate_left(turn);
        let mapping = Mapping::new(&description(&theirs), &description(&fields)).unwrap();
        let expected: Vec<Named> = fields.iter().enumerate().map(|(number, field)| {
            if number == lacking && fields.len() > 1 { default(field) } else { field.clone() }
        }).collect();
        prop_assert_eq!(mapping.dropped().len(), extra.len());
        prop_assert_eq!(mapping.missing().len(), usize::from(fields.len() > 1));
        for representation in [0, 1, 7] {
            let converted = mapping.convert(&encode(&theirs, representation)).unwrap();
            prop_assert_eq!(converted, encode(&expected, 1));
        }
    }

    /// Any definitions and bytes give a message or an error, never a panic.
    #[test]
    fn any_bytes_give_a_message_or_an_error(
        theirs in fields(), ours in fields(), mut bytes in prop::collection::vec(any::<u8>(), 0..120), valid in any::<bool>(),
    ) {
        if valid && bytes.len() > 4 {
            bytes[..4].copy_from_slice(&[0, 1, 0, 0]);
        }
        if let Ok(mapping) = Mapping::new(&description(&theirs), &description(&ours)) {
            mapping.convert(&bytes).ok();
        }
        Layout::of(&description(&theirs)).unwrap().check(&bytes).ok();
    }
}

fn of_text(name: &str, text: &str) -> TypeDescription {
    let mut given = Action::dependencies();
    given.push(("p/msg/Loop", "Loop[] inner\n"));
    given.push(("p/msg/Endless", "Endless inner\n"));
    TypeDescription::message(name, text, given).unwrap()
}

fn of_action(text: &str) -> Result<Mapping, MappingError> {
    let ours = TypeDescription::of::<Action>().unwrap();
    Mapping::new(&of_text("wm_msgs/msg/Action", text), &ours)
}

#[test]
fn extra_field_before_values_is_dropped() {
    let mapping = of_action("std_msgs/Header header\nuint32 mode\nfloat32[] values\n").unwrap();
    assert_eq!(
        (mapping.missing(), mapping.dropped()),
        (&[][..], &["mode".to_owned()][..])
    );
    let mut bytes = vec![0, 1, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 5, 0, 0, 0];
    bytes.extend(b"base\0\0\0\0");
    bytes.extend([7, 0, 0, 0, 1, 0, 0, 0]);
    bytes.extend(0.25f32.to_le_bytes());
    let action: Action = cdr::from_bytes(&mapping.convert(&bytes).unwrap()).unwrap();
    assert_eq!(
        (action.header.frame_id.as_str(), &action.values[..]),
        ("base", &[0.25][..])
    );
}

#[test]
fn numbers_become_wider_and_never_narrower() {
    let convert = |theirs: &str, ours: &str, body: &[u8]| {
        let mapping = Mapping::new(&of_text("p/msg/T", theirs), &of_text("p/msg/T", ours))?;
        Ok::<_, MappingError>(
            mapping.convert(&[&[0, 1, 0, 0], body].concat()).unwrap()[4..].to_vec(),
        )
    };
    assert_eq!(
        convert("int8 x", "int64 x", &[0xfe]).unwrap(),
        (-2i64).to_le_bytes()
    );
    assert_eq!(
        convert("uint16 x", "float32 x", &[1, 1]).unwrap(),
        257f32.to_le_bytes()
    );
    assert_eq!(convert("uint8 x", "byte x", &[9]).unwrap(), [9]);
    assert_eq!(
        convert("int8[2] x", "int8[] x", &[1, 2]).unwrap(),
        [2, 0, 0, 0, 1, 2]
    );
    for (theirs, ours) in [
        ("float64 x", "float32 x"),
        ("int32 x", "float32 x"),
        ("int8 x", "uint16 x"),
        ("uint8 x", "int8 x"),
        ("string x", "uint8[] x"),
        ("uint8 x", "uint8[] x"),
        ("uint8[3] x", "uint8[2] x"),
        ("uint8[] x", "uint8[2] x"),
        ("uint8[3] x", "uint8[<=2] x"),
    ] {
        let error = convert(theirs, ours, &[0; 16]).unwrap_err().to_string();
        let [theirs, ours] = [theirs, ours].map(|text| text.split(' ').next().unwrap());
        assert!(error.contains(theirs) && error.contains(ours), "{error}");
    }
}

#[test]
fn errors_name_fields_that_do_not_fit() {
    let error = |text: &str| of_action(text).unwrap_err().to_string();
    assert!(
        error("std_msgs/Header header\nfloat64[] values\n")
            .contains("values has the type float64[]")
    );
    assert!(
        error("builtin_interfaces/Time header\nfloat32[] values\n")
            .contains("builtin_interfaces/msg/Time")
    );
    assert!(error("float32[] other\n").contains("no field of wm_msgs/msg/Action"));
    assert!(error("wstring name\nfloat32[] values\n").contains("wstring"));
    assert!(error("uint8[0] none\nfloat32[] values\n").contains("uint8[0]"));
    let bounded = of_text("p/msg/T", "uint8[<=2] x\nstring<=3 s\n");
    let mapping = Mapping::new(&of_text("p/msg/T", "uint8[] x\nstring s\n"), &bounded).unwrap();
    let long = mapping.convert(&[0, 1, 0, 0, 3, 0, 0, 0, 1, 1, 1, 0, 1, 0, 0, 0, 0]);
    assert!(
        long.unwrap_err()
            .to_string()
            .contains("field x: expected at most 2, got 3")
    );
    let long = mapping.convert(&[0, 1, 0, 0, 0, 0, 0, 0, 5, 0, 0, 0, 97, 97, 97, 97, 0]);
    assert!(long.unwrap_err().to_string().contains("field s"));
    for (bytes, part) in [
        (&[0, 3, 0, 0, 0][..], "0x0003"),
        (&[0, 9, 0, 0, 0], "0x0009"),
        (&[0, 1], "2 bytes"),
    ] {
        assert!(
            mapping
                .convert(bytes)
                .unwrap_err()
                .to_string()
                .contains(part)
        );
    }
}

#[test]
fn hostile_definitions_and_lengths_are_refused() {
    let text = TypeDescription::of::<std_msgs::String>().unwrap();
    let theirs = of_text("std_msgs/msg/String", "string data\np/Loop extra\n");
    let mapping = Mapping::new(&theirs, &text).unwrap();
    let nested = [
        &[0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0][..],
        &[1, 0, 0, 0].repeat(100),
    ]
    .concat();
    assert_eq!(mapping.convert(&nested), Err(ConvertError::TooDeep));
    let huge = [0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 255, 255, 255, 255, 0, 0];
    assert!(matches!(
        mapping.convert(&huge),
        Err(ConvertError::TooShort { .. })
    ));
    let endless = of_text("std_msgs/msg/String", "string data\np/Endless extra\n");
    let mapping = Mapping::new(&endless, &text).unwrap();
    assert_eq!(mapping.convert(&huge), Err(ConvertError::TooDeep));
}
