use super::{
    ConvertError, DEPTH_LIMIT, MappingError, input::Input, output::Output, scalar::Scalar,
};
use crate::{FieldType, TypeDescription};
use std::collections::HashMap;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Element {
    Scalar(Scalar),
    Text,
    /// Index of the struct.
    Struct(usize),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Container {
    One,
    Array(u64),
    /// With its bound.
    Sequence(Option<u64>),
}

#[derive(Clone, Debug)]
pub(super) struct Member {
    pub name: String,
    pub container: Container,
    pub element: Element,
    /// Bound of a string \[byte\].
    pub text_limit: Option<u64>,
    /// The type as text, for errors.
    pub text: String,
}

#[derive(Clone, Debug)]
pub(super) struct Structure {
    pub name: String,
    pub members: Vec<Member>,
}

/// The positions of a type's fields in CDR.
#[derive(Clone, Debug)]
pub struct Layout {
    /// The first structure is the type itself.
    structures: Vec<Structure>,
}

impl Layout {
    /// The layout of a type.
    ///
    /// # Errors
    /// A field of a type whose encoding differs between vendors (`wstring`), or an array without an element.
    pub fn of(description: &TypeDescription) -> Result<Self, MappingError> {
        let all = || std::iter::once(&description.described).chain(&description.referenced);
        let numbers: HashMap<&str, usize> = all()
            .enumerate()
            .map(|(number, part)| (part.name.as_str(), number))
            .collect();
        let structures = all().map(|part| {
            let members = part.fields.iter().map(|field| {
                member(&field.name, &field.field_type, &numbers).ok_or_else(|| {
                    MappingError::Layout {
                        field: format!("{}.{}", part.name, field.name),
                        found: field.field_type.to_string(),
                    }
                })
            });
            Ok(Structure {
                name: part.name.clone(),
                members: members.collect::<Result<_, MappingError>>()?,
            })
        });
        Ok(Self {
            structures: structures.collect::<Result<_, MappingError>>()?,
        })
    }

    /// Checks that these bytes, CDR with its header, are one message of this type, with at most three bytes of padding.
    ///
    /// # Errors
    /// [`ConvertError`] names the difference.
    pub fn check(&self, bytes: &[u8]) -> Result<(), ConvertError> {
        let mut input = Input::open(bytes)?;
        self.skip_structure(0, &mut input, 0)?;
        input.end()
    }

    pub(super) fn get(&self, number: usize) -> Option<&Structure> {
        self.structures.get(number)
    }

    fn skip_structure(
        &self,
        number: usize,
        input: &mut Input<'_>,
        depth: usize,
    ) -> Result<(), ConvertError> {
        let structure = self.structures.get(number);
        let structure = structure.filter(|_| depth <= DEPTH_LIMIT);
        for member in &structure.ok_or(ConvertError::TooDeep)?.members {
            self.skip(member, input, depth)?;
        }
        Ok(())
    }

    /// Skips a field of the input. Each element takes at least a byte, so that this ends.
    pub(super) fn skip(
        &self,
        member: &Member,
        input: &mut Input<'_>,
        depth: usize,
    ) -> Result<(), ConvertError> {
        let count = match member.container {
            Container::One => 1,
            Container::Array(length) => length,
            Container::Sequence(_) => input.count()?,
        };
        match member.element {
            Element::Scalar(scalar) => input.skip(scalar.size(), count)?,
            Element::Text => {
                for _ in 0..count {
                    input.text()?;
                }
            }
            Element::Struct(number) => {
                for _ in 0..count {
                    self.skip_structure(number, input, depth + 1)?;
                }
            }
        }
        Ok(())
    }

    /// Writes zeros, empty strings and empty sequences.
    pub(super) fn default(
        &self,
        member: &Member,
        output: &mut Output,
        depth: usize,
    ) -> Result<(), ConvertError> {
        let count = match member.container {
            Container::One => 1,
            Container::Array(length) => length,
            Container::Sequence(_) => return output.count(0),
        };
        for _ in 0..count {
            match member.element {
                Element::Scalar(scalar) => output.zero(scalar.size())?,
                Element::Text => output.text(&[], &member.name, member.text_limit)?,
                Element::Struct(number) => {
                    let structure = self.structures.get(number);
                    let structure = structure.filter(|_| depth <= DEPTH_LIMIT);
                    for member in &structure.ok_or(ConvertError::TooDeep)?.members {
                        self.default(member, output, depth + 1)?;
                    }
                }
            }
        }
        Ok(())
    }
}

fn member(name: &str, field_type: &FieldType, numbers: &HashMap<&str, usize>) -> Option<Member> {
    let container = match field_type.type_id / 48 {
        0 => Container::One,
        1 => Container::Array(field_type.capacity),
        2 => Container::Sequence(Some(field_type.capacity)),
        3 => Container::Sequence(None),
        _ => return None,
    };
    // An element without bytes could be repeated without end.
    if container == Container::Array(0) {
        return None;
    }
    let element = match (field_type.type_id % 48, &field_type.nested) {
        (1, Some(nested)) => Element::Struct(*numbers.get(nested.as_str())?),
        (2, _) => Element::Scalar(Scalar::Signed(1)),
        (3 | 13, _) => Element::Scalar(Scalar::Unsigned(1)),
        (4, _) => Element::Scalar(Scalar::Signed(2)),
        (5, _) => Element::Scalar(Scalar::Unsigned(2)),
        (6, _) => Element::Scalar(Scalar::Signed(4)),
        (7, _) => Element::Scalar(Scalar::Unsigned(4)),
        (8, _) => Element::Scalar(Scalar::Signed(8)),
        (9, _) => Element::Scalar(Scalar::Unsigned(8)),
        (10, _) => Element::Scalar(Scalar::Float(4)),
        (11, _) => Element::Scalar(Scalar::Float(8)),
        (15, _) => Element::Scalar(Scalar::Bool),
        (16, _) => Element::Scalar(Scalar::Byte),
        (17 | 21, _) => Element::Text,
        _ => return None,
    };
    Some(Member {
        name: name.to_owned(),
        container,
        element,
        text_limit: Some(field_type.string_capacity).filter(|limit| *limit > 0),
        text: field_type.to_string(),
    })
}
