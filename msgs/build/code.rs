//! The Rust code of interfaces.

use crate::{
    Result,
    definitions::field::FieldType,
    interface::{Interface, Member, Part},
};
use std::{collections::BTreeMap, fmt::Write as _};

/// Halves of services that share one Rust type: package, fields, name of the type, documentation.
const SHARED: [(&str, &str, &str, &str); 5] = [
    (
        "lifecycle_msgs",
        "",
        "EmptyRequest",
        "A request without fields.",
    ),
    (
        "rosbag2_interfaces",
        "",
        "Empty",
        "A request or response without fields.",
    ),
    (
        "rosbag2_interfaces",
        "float64 rate\n",
        "Rate",
        "The rate of a player.",
    ),
    (
        "rosbag2_interfaces",
        "bool success\n",
        "Success",
        "Whether a request succeeded.",
    ),
    (
        "std_srvs",
        "bool success\nstring message\n",
        "Outcome",
        "The response of [`Trigger`] and [`SetBool`].",
    ),
];

/// Attributes of types that are ordered, are keys of maps, or are checked when they are decoded.
const ATTRIBUTES: [(&str, &str); 3] = [
    (
        "builtin_interfaces/msg/Duration",
        "#[derive(PartialOrd, Ord, Hash)]\n#[serde(try_from = \"crate::time::UncheckedDuration\")]\n",
    ),
    (
        "builtin_interfaces/msg/Time",
        "#[derive(PartialOrd, Ord, Hash)]\n#[serde(try_from = \"crate::time::UncheckedTime\")]\n",
    ),
    (
        "unique_identifier_msgs/msg/UUID",
        "#[derive(PartialOrd, Ord, Hash)]\n",
    ),
];

/// All interfaces, by their ROS names.
pub struct Interfaces(pub BTreeMap<String, Interface>);

impl Interfaces {
    /// The modules of all packages.
    pub fn packages(&self) -> Result<String> {
        let mut packages: BTreeMap<&str, [String; 2]> = BTreeMap::new();
        for (ros_name, interface) in &self.0 {
            let [types, actions] = packages.entry(&interface.package).or_default();
            match interface.kind {
                "msg" => self.message(ros_name, interface, types)?,
                "srv" => self.parts("Service", &["Request", "Response"], interface, types)?,
                _ => self.parts(
                    "Action",
                    &["Goal", "Result", "Feedback"],
                    interface,
                    actions,
                )?,
            }
        }
        let mut code = String::new();
        for (package, [types, actions]) in packages {
            writeln!(
                code,
                "/// Interfaces of the ROS package `{package}`.\npub mod {package} {{\n{types}"
            )?;
            if !actions.is_empty() {
                writeln!(
                    code,
                    "/// The actions: an action and a message may have the same name.\npub mod action {{\n{actions}}}"
                )?;
            }
            writeln!(code, "}}")?;
        }
        writeln!(
            code,
            "/// All message types, sorted by name.\nconst MESSAGE_TYPES: &[MessageType] = &["
        )?;
        for (ros_name, interface) in &self.0 {
            if interface.kind == "msg" {
                let path = rust_path(ros_name);
                writeln!(code, "MessageType::new::<{path}>({ros_name:?}),")?;
            }
        }
        writeln!(code, "];")?;
        Ok(code)
    }

    /// Names and definitions of all interfaces, and macros that call a generic function for each message, service or action
    /// of the crate.
    pub fn lists(&self) -> Result<String> {
        let definitions = self
            .0
            .iter()
            .map(|(ros_name, interface)| (ros_name, &interface.text));
        let mut code = String::new();
        writeln!(
            code,
            "const DEFINITIONS: &[(&str, &str)] = &{:?};",
            definitions.collect::<Vec<_>>()
        )?;
        for (kind, list, module) in [
            ("msg", "message", ""),
            ("srv", "service", ""),
            ("action", "action", "action::"),
        ] {
            writeln!(
                code,
                "macro_rules! every_{list} {{ ($check:ident $(, $argument:expr)*) => {{"
            )?;
            for interface in self.0.values().filter(|interface| interface.kind == kind) {
                let Interface { package, name, .. } = interface;
                writeln!(
                    code,
                    "$check::<::wm_msgs::{package}::{module}{name}>($($argument),*);"
                )?;
            }
            writeln!(code, "}} }}")?;
        }
        Ok(code)
    }

    fn message(&self, ros_name: &str, interface: &Interface, code: &mut String) -> Result<()> {
        let attributes = ATTRIBUTES.iter().find(|(name, _)| *name == ros_name);
        let attributes = attributes.map_or("", |(_, attributes)| attributes);
        for part in &interface.parts {
            self.structure(
                &interface.name,
                part,
                &interface.documentation,
                attributes,
                code,
            )?;
        }
        self.implementation("Message", interface, &[], code)
    }

    /// A service or an action: a type that stands for it, and one struct for each of its parts.
    fn parts(
        &self,
        of: &str,
        suffixes: &'static [&'static str],
        interface: &Interface,
        code: &mut String,
    ) -> Result<()> {
        let Interface {
            name,
            documentation,
            ..
        } = interface;
        writeln!(
            code,
            "#[doc = {documentation:?}]\n#[derive(Clone, Copy, Debug)]\npub struct {name};"
        )?;
        let mut types = Vec::new();
        for (suffix, part) in suffixes.iter().zip(&interface.parts) {
            let is_shared = |(package, text, ..): &&(&str, &str, &str, &str)| {
                *package == interface.package && *text == part.text
            };
            let (type_name, documentation) = match SHARED.iter().find(is_shared) {
                Some((_, _, type_name, documentation)) => {
                    ((*type_name).to_owned(), (*documentation).to_owned())
                }
                None => (
                    format!("{name}{suffix}"),
                    format!("{suffix} of [`{name}`]."),
                ),
            };
            if !code.contains(&format!("pub struct {type_name} {{")) {
                self.structure(&type_name, part, &documentation, "", code)?;
            }
            types.push((*suffix, type_name));
        }
        self.implementation(of, interface, &types, code)
    }

    fn structure(
        &self,
        name: &str,
        part: &Part,
        documentation: &str,
        attributes: &str,
        code: &mut String,
    ) -> Result<()> {
        let is_zero = |value: &str| matches!(value, "" | "false") || value.parse() == Ok(0.0);
        let is_default_zero = part.fields.iter().all(|member| is_zero(&member.value));
        let derives = [
            (true, "Clone"),
            (self.all(part, &is_copy), "Copy"),
            (true, "Debug"),
            (is_default_zero, "Default"),
            (true, "PartialEq"),
            (self.all(part, &is_eq), "Eq"),
            (true, "::serde::Serialize"),
            (true, "::serde::Deserialize"),
        ];
        let derives: Vec<_> = derives
            .into_iter()
            .filter_map(|(holds, derive)| holds.then_some(derive))
            .collect();
        writeln!(
            code,
            "#[doc = {documentation:?}]\n#[derive({})]\n{attributes}pub struct {name} {{",
            derives.join(", ")
        )?;
        for member in &part.fields {
            writeln!(code, "#[doc = {:?}]", member.documentation)?;
            if is_bytes(&member.field.field_type) {
                // 40 times faster than element by element.
                writeln!(code, "#[serde(with = \"serde_bytes\")]")?;
            }
            let field_name = rust_name(&member.field.name);
            writeln!(
                code,
                "pub {field_name}: {},",
                rust_type(&member.field.field_type)?
            )?;
        }
        writeln!(code, "}}")?;
        if !is_default_zero {
            writeln!(
                code,
                "impl Default for {name} {{ fn default() -> Self {{ Self {{"
            )?;
            for Member { field, value, .. } in &part.fields {
                let value = match value.as_str() {
                    "" => "Default::default()".to_owned(),
                    value => literal(&field.field_type, value)?,
                };
                writeln!(code, "{}: {value},", rust_name(&field.name))?;
            }
            writeln!(code, "}} }} }}")?;
        }
        if !part.constants.is_empty() {
            writeln!(code, "impl {name} {{")?;
            for Member {
                field,
                value,
                documentation,
            } in &part.constants
            {
                let constant_type = match field.field_type.type_id {
                    STRING => "&'static str".to_owned(),
                    _ => rust_type(&field.field_type)?,
                };
                let value = literal(&field.field_type, value)?;
                writeln!(
                    code,
                    "#[doc = {documentation:?}]\npub const {}: {constant_type} = {value};",
                    field.name
                )?;
            }
            writeln!(code, "}}")?;
        }
        Ok(())
    }

    /// Implements one of the crate's traits; `types` are its associated types.
    fn implementation(
        &self,
        of: &str,
        interface: &Interface,
        types: &[(&str, String)],
        code: &mut String,
    ) -> Result<()> {
        let Interface {
            package,
            name,
            text,
            ..
        } = interface;
        writeln!(
            code,
            "impl crate::{of} for {name} {{\nconst PACKAGE: &'static str = {package:?};\n\
             const NAME: &'static str = {name:?};\nconst DEFINITION: &'static str = {text:?};"
        )?;
        for (associated, type_name) in types {
            writeln!(code, "type {associated} = {type_name};")?;
        }
        let mut dependencies = Vec::new();
        for part in &interface.parts {
            self.dependencies(part, &mut dependencies)?;
        }
        let pairs = dependencies.iter().map(|ros_name| {
            let path = rust_path(ros_name);
            format!("({ros_name:?}, <{path} as crate::Message>::DEFINITION)")
        });
        let pairs = pairs.collect::<Vec<_>>().join(", ");
        writeln!(
            code,
            "fn dependencies() -> Vec<(&'static str, &'static str)> {{ vec![{pairs}] }}\n}}"
        )?;
        Ok(())
    }

    /// Adds the names of the types that a struct names, transitively, each once.
    fn dependencies<'a>(&'a self, part: &'a Part, all: &mut Vec<&'a str>) -> Result<()> {
        for nested in part
            .fields
            .iter()
            .filter_map(|member| member.field.field_type.nested.as_deref())
        {
            if all.contains(&nested) {
                continue;
            }
            let named = self
                .0
                .get(nested)
                .ok_or_else(|| format!("expected the definition of {nested}, found none"))?;
            all.push(nested);
            for part in &named.parts {
                self.dependencies(part, all)?;
            }
        }
        Ok(())
    }

    /// Whether a property holds for all fields, and for all fields of the types that they name.
    fn all(&self, part: &Part, holds: &dyn Fn(&FieldType) -> bool) -> bool {
        part.fields.iter().all(|Member { field, .. }| {
            let named = field
                .field_type
                .nested
                .as_ref()
                .and_then(|name| self.0.get(name));
            holds(&field.field_type)
                && named.is_none_or(|named| named.parts.iter().all(|part| self.all(part, holds)))
        })
    }
}

/// Numbers of `type_description_interfaces/msg/FieldType`: a string, and what an array or a sequence adds to its element's.
const STRING: u8 = 17;
const ARRAY: u8 = 48;

fn is_copy(field_type: &FieldType) -> bool {
    // neither a sequence nor a string, bounded or not
    field_type.type_id < 2 * ARRAY && !matches!(field_type.type_id % ARRAY, 17 | 18 | 21 | 22)
}

fn is_eq(field_type: &FieldType) -> bool {
    !matches!(field_type.type_id % ARRAY, 10 | 11)
}

/// A sequence of bytes.
fn is_bytes(field_type: &FieldType) -> bool {
    field_type.type_id >= 2 * ARRAY && matches!(field_type.type_id % ARRAY, 3 | 16)
}

fn rust_path(ros_name: &str) -> String {
    format!("crate::{}", ros_name.replace("/msg/", "::"))
}

fn rust_type(field_type: &FieldType) -> Result<String> {
    let element = match (field_type.type_id % ARRAY, &field_type.nested) {
        (_, Some(ros_name)) => rust_path(ros_name),
        (2, _) => "i8".to_owned(),
        (3 | 16, _) => "u8".to_owned(),
        (4, _) => "i16".to_owned(),
        (5, _) => "u16".to_owned(),
        (6, _) => "i32".to_owned(),
        (7, _) => "u32".to_owned(),
        (8, _) => "i64".to_owned(),
        (9, _) => "u64".to_owned(),
        (10, _) => "f32".to_owned(),
        (11, _) => "f64".to_owned(),
        (15, _) => "bool".to_owned(),
        // `std_msgs` has a message `String`.
        (17 | 21, _) => "::std::string::String".to_owned(),
        _ => {
            return Err(
                format!("expected a type that CDR encodes in one way, got {field_type}").into(),
            );
        }
    };
    Ok(match field_type.type_id / ARRAY {
        0 => element,
        1 => format!("[{element}; {}]", field_type.capacity),
        _ => format!("Vec<{element}>"),
    })
}

/// The name of a field, which may be a keyword of Rust.
fn rust_name(name: &str) -> String {
    match name {
        "type" | "match" | "move" | "ref" | "loop" | "use" | "mod" | "where" | "in" => {
            format!("r#{name}")
        }
        name => name.to_owned(),
    }
}

/// The value of a constant or of a default.
fn literal(field_type: &FieldType, value: &str) -> Result<String> {
    Ok(match field_type.type_id {
        10 | 11 => format!("{:?}", value.parse::<f64>()?),
        STRING => format!("{:?}", value.trim_matches(['"', '\''])),
        _ => value.to_owned(),
    })
}
