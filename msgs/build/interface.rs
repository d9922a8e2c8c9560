//! Definition files, read with their comments.

use crate::{
    Result,
    definitions::{
        definition::{declaration, split_parts},
        field::{Field, FieldType},
    },
};
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

/// One definition file.
pub struct Interface {
    pub package: String,
    /// `msg`, `srv` or `action`.
    pub kind: &'static str,
    pub name: String,
    /// The definition, as bags and peers receive it.
    pub text: String,
    pub documentation: String,
    /// One struct of a message, two of a service, three of an action.
    pub parts: Vec<Part>,
}

/// The fields and constants of one struct.
pub struct Part {
    /// Without comments.
    pub text: String,
    pub fields: Vec<Member>,
    pub constants: Vec<Member>,
}

pub struct Member {
    pub field: Field,
    /// Of a constant, or the default of a field; empty: zero.
    pub value: String,
    pub documentation: String,
}

/// Reads all definition files; returns interfaces by their ROS names.
pub fn read_all() -> Result<BTreeMap<String, Interface>> {
    let mut interfaces = BTreeMap::new();
    read("wm_msgs", Path::new("."), &mut interfaces)?;
    for package in entries(Path::new("ros"))? {
        if package.is_dir() {
            read(&stem(&package)?, &package, &mut interfaces)?;
        }
    }
    Ok(interfaces)
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let mut paths = entries
        .map(|entry| Ok(entry?.path()))
        .collect::<Result<Vec<_>>>()?;
    paths.sort();
    Ok(paths)
}

/// A file's name without its extension.
fn stem(path: &Path) -> Result<String> {
    let stem = path.file_stem().and_then(|stem| stem.to_str());
    Ok(stem
        .ok_or_else(|| format!("{}: expected a UTF-8 name", path.display()))?
        .to_owned())
}

/// Reads the definition files of a package.
fn read(package: &str, folder: &Path, interfaces: &mut BTreeMap<String, Interface>) -> Result<()> {
    for kind in ["msg", "srv", "action"] {
        let folder = folder.join(kind);
        let files = if folder.is_dir() {
            entries(&folder)?
        } else {
            Vec::new()
        };
        for path in files {
            let name = stem(&path)?;
            let ros_name = format!("{package}/{kind}/{name}");
            let text = fs::read_to_string(&path)?;
            let parts = split_parts(&text);
            let expected = match kind {
                "msg" => 1,
                "srv" => 2,
                _ => 3,
            };
            if parts.len() != expected {
                return Err(
                    format!("{ros_name}: expected {expected} parts, got {}", parts.len()).into(),
                );
            }
            let comment = text.lines().map_while(|line| line.strip_prefix('#'));
            let interface = Interface {
                documentation: escaped(&comment.map(str::trim).collect::<Vec<_>>().join("\n")),
                parts: parts
                    .iter()
                    .map(|part| Part::read(package, &ros_name, part))
                    .collect::<Result<_>>()?,
                package: package.to_owned(),
                kind,
                name,
                // The comments in `ros/` are this package's, and no part of the others' definitions.
                text: if package == "wm_msgs" {
                    text
                } else {
                    without_comments(&text)
                },
            };
            interfaces.insert(ros_name, interface);
        }
    }
    Ok(())
}

fn without_comments(text: &str) -> String {
    let code = text
        .lines()
        .map(|line| line.split('#').next().unwrap_or(line).trim_end());
    code.filter(|code| !code.is_empty())
        .map(|code| format!("{code}\n"))
        .collect()
}

impl Part {
    fn read(package: &str, ros_name: &str, text: &str) -> Result<Self> {
        let mut part = Self {
            text: without_comments(text),
            fields: Vec::new(),
            constants: Vec::new(),
        };
        for line in text.lines() {
            let (code, comment) = line.split_once('#').unwrap_or((line, ""));
            let code = code.trim();
            if code.is_empty() {
                continue;
            }
            let declaration = declaration(ros_name, code)?;
            let field_type = FieldType::parse(package, declaration.type_name).ok_or_else(|| {
                format!(
                    "{ros_name}: expected a type of ROS, got `{}`",
                    declaration.type_name
                )
            })?;
            let constant = declaration.value.strip_prefix('=');
            let member = Member {
                field: Field {
                    name: declaration.name.to_owned(),
                    field_type,
                },
                value: constant.unwrap_or(declaration.value).trim().to_owned(),
                documentation: match comment.trim() {
                    "" => format!("`{code}`"),
                    comment => escaped(comment),
                },
            };
            if constant.is_some() {
                part.constants.push(member);
            } else {
                part.fields.push(member);
            }
        }
        if part.fields.is_empty() {
            part.fields.push(Member {
                field: Field::placeholder(),
                value: String::new(),
                documentation: "Without meaning: IDL has no empty structs.".to_owned(),
            });
        }
        Ok(part)
    }
}

/// A comment as Markdown.
fn escaped(comment: &str) -> String {
    let mut escaped = String::new();
    for c in comment.chars() {
        if matches!(c, '[' | ']' | '<' | '>' | '*') {
            escaped.push('\\');
        }
        escaped.push(c);
    }
    escaped
}
