//! Messages of one definition as messages of another: fields are matched by name.
//!
//! A bag has the definition that its recorder knew. If it differs from this crate's definition, the bytes are read by the
//! bag's definition and written again in the layout of this crate's.
//!
//! - A field of both definitions is copied. Its type must be the same or a wider number (`float32` fits `float64`, `uint8`
//!   fits `int32`). An array fits a sequence, and a nested type fits by the same rules.
//! - A field that only this crate's type has gets zero, an empty string or an empty sequence.
//! - A field that only the bag's type has is dropped.
//!
//! ```
//! use wm_msgs::{Mapping, TypeDescription, cdr, std_msgs};
//!
//! let theirs = TypeDescription::message("std_msgs/msg/Float64", "uint8 unit\nfloat32 data\n", [])?;
//! let mapping = Mapping::new(&theirs, &TypeDescription::of::<std_msgs::Float64>()?)?;
//! assert_eq!(mapping.dropped(), ["unit"]);
//! let bytes = mapping.convert(&[0, 1, 0, 0, 7, 0, 0, 0, 0, 0, 0x20, 0x40])?;
//! assert_eq!(cdr::from_bytes::<std_msgs::Float64>(&bytes)?.data, 2.5);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod error;
mod input;
mod layout;
mod output;
mod scalar;

pub use error::{ConvertError, MappingError};
pub use layout::Layout;

use crate::TypeDescription;
use input::Input;
use layout::{Container, Element, Member};
use output::Output;

/// Limit of nested types, in values and definitions. ROS messages have about ten at most.
pub(crate) const DEPTH_LIMIT: usize = 64;

/// Converts messages of one definition into messages of another.
#[derive(Clone, Debug)]
pub struct Mapping {
    theirs: Layout,
    ours: Layout,
    /// Pairs of structs; the first pair is the messages themselves.
    pairs: Vec<Pair>,
    missing: Vec<String>,
    dropped: Vec<String>,
}

/// The sources of the fields of a struct of ours.
#[derive(Clone, Debug)]
struct Pair {
    theirs: usize,
    ours: usize,
    sources: Vec<Option<Source>>,
}

#[derive(Clone, Copy, Debug)]
struct Source {
    /// Index of their field.
    field: usize,
    /// The pair of the nested types, if the field has a nested type.
    pair: Option<usize>,
}

impl Mapping {
    /// Matches the fields of two definitions: from `theirs` to `ours`.
    ///
    /// # Errors
    /// A field of both whose types do not fit, two nested types of different names, two types without a common field, or a
    /// type whose encoding differs between vendors (`wstring`).
    pub fn new(theirs: &TypeDescription, ours: &TypeDescription) -> Result<Self, MappingError> {
        let mut mapping = Self {
            theirs: Layout::of(theirs)?,
            ours: Layout::of(ours)?,
            pairs: Vec::new(),
            missing: Vec::new(),
            dropped: Vec::new(),
        };
        mapping.pair((0, 0), "", 0)?;
        Ok(mapping)
    }

    /// Paths of the fields that only the target has (`header.frame_id`): they get default values.
    #[must_use]
    pub fn missing(&self) -> &[String] {
        &self.missing
    }

    /// Paths of the fields that only the source has.
    #[must_use]
    pub fn dropped(&self) -> &[String] {
        &self.dropped
    }

    /// A message in the target's layout, as little-endian plain CDR with its header.
    ///
    /// # Errors
    /// Bytes that are not a message of the source's definition, an encapsulation other than plain CDR of version 1 or 2, or
    /// more elements than a bound of the target allows.
    pub fn convert(&self, bytes: &[u8]) -> Result<Vec<u8>, ConvertError> {
        let mut input = Input::open(bytes)?;
        let mut output = Output::default();
        self.structure(0, &mut input, &mut output, 0)?;
        input.end()?;
        Ok(output.into_bytes())
    }

    /// Pairs two structs, and adds the paths of unmatched fields; returns the index of the pair.
    fn pair(
        &mut self,
        (theirs, ours): (usize, usize),
        path: &str,
        depth: usize,
    ) -> Result<usize, MappingError> {
        let (Some(their_type), Some(our_type)) = (
            self.theirs.get(theirs).cloned(),
            self.ours.get(ours).cloned(),
        ) else {
            return Err(MappingError::TooDeep(path.to_owned()));
        };
        if depth > DEPTH_LIMIT {
            return Err(MappingError::TooDeep(our_type.name));
        }
        if depth > 0 && their_type.name != our_type.name {
            return Err(MappingError::Nested {
                field: path.to_owned(),
                theirs: their_type.name,
                ours: our_type.name,
            });
        }
        let at = |name: &str| match path {
            "" => name.to_owned(),
            path => format!("{path}.{name}"),
        };
        let number = self.pairs.len();
        self.pairs.push(Pair {
            theirs,
            ours,
            sources: Vec::new(),
        });
        let mut sources = Vec::with_capacity(our_type.members.len());
        for member in &our_type.members {
            let found = their_type
                .members
                .iter()
                .position(|m| m.name == member.name);
            let their_member =
                found.and_then(|field| Some((field, their_type.members.get(field)?)));
            let Some((field, their_member)) = their_member else {
                self.missing.push(at(&member.name));
                sources.push(None);
                continue;
            };
            if !fits(their_member, member) {
                return Err(MappingError::FieldType {
                    field: at(&member.name),
                    theirs: their_member.text.clone(),
                    ours: member.text.clone(),
                });
            }
            let pair = match (their_member.element, member.element) {
                (Element::Struct(theirs), Element::Struct(ours)) => {
                    Some(self.pair((theirs, ours), &at(&member.name), depth + 1)?)
                }
                _ => None,
            };
            sources.push(Some(Source { field, pair }));
        }
        if sources.iter().all(Option::is_none) {
            return Err(MappingError::NothingInCommon {
                name: our_type.name,
                field: path.to_owned(),
            });
        }
        let ours = &our_type.members;
        let extra = their_type.members.iter();
        let extra = extra.filter(|member| ours.iter().all(|m| m.name != member.name));
        self.dropped.extend(extra.map(|member| at(&member.name)));
        if let Some(pair) = self.pairs.get_mut(number) {
            pair.sources = sources;
        }
        Ok(number)
    }

    /// Reads a struct in their layout and writes it in ours.
    fn structure(
        &self,
        number: usize,
        input: &mut Input<'_>,
        output: &mut Output,
        depth: usize,
    ) -> Result<(), ConvertError> {
        let pair = self.pairs.get(number);
        let theirs = pair.and_then(|pair| self.theirs.get(pair.theirs));
        let ours = pair.and_then(|pair| self.ours.get(pair.ours));
        let (Some(pair), Some(theirs), Some(ours), true) =
            (pair, theirs, ours, depth <= DEPTH_LIMIT)
        else {
            return Err(ConvertError::TooDeep);
        };
        // Their fields may have another order than ours.
        let mut places = Vec::with_capacity(theirs.members.len());
        for member in &theirs.members {
            places.push(input.place());
            self.theirs.skip(member, input, depth)?;
        }
        let end = input.place();
        for (member, source) in ours.members.iter().zip(&pair.sources) {
            let from = source.and_then(|source| {
                let (place, field) = (places.get(source.field)?, theirs.members.get(source.field)?);
                Some((*place, field, source.pair))
            });
            match from {
                None => self.ours.default(member, output, depth)?,
                Some((place, field, nested)) => {
                    input.go_to(place);
                    self.member((field, member), nested, input, output, depth)?;
                }
            }
        }
        input.go_to(end);
        Ok(())
    }

    fn member(
        &self,
        (theirs, ours): (&Member, &Member),
        nested: Option<usize>,
        input: &mut Input<'_>,
        output: &mut Output,
        depth: usize,
    ) -> Result<(), ConvertError> {
        let count = match theirs.container {
            Container::One => 1,
            Container::Array(length) => length,
            Container::Sequence(_) => input.count()?,
        };
        if let Container::Sequence(limit) = ours.container {
            if let Some(limit) = limit.filter(|limit| count > *limit) {
                return Err(ConvertError::Bound {
                    field: ours.name.clone(),
                    limit,
                    found: count,
                });
            }
            output.count(count)?;
        }
        match (theirs.element, ours.element) {
            (Element::Scalar(from), Element::Scalar(to)) => {
                input.scalars(from, to, count, output)?;
            }
            (Element::Text, Element::Text) => {
                for _ in 0..count {
                    output.text(input.text()?, &ours.name, ours.text_limit)?;
                }
            }
            _ => {
                for _ in 0..count {
                    let nested = nested.ok_or(ConvertError::TooDeep)?;
                    self.structure(nested, input, output, depth + 1)?;
                }
            }
        }
        Ok(())
    }
}

/// Whether our field holds every value of theirs.
fn fits(theirs: &Member, ours: &Member) -> bool {
    let container = match (theirs.container, ours.container) {
        (Container::One, Container::One) => true,
        (Container::Array(theirs), Container::Array(ours)) => theirs == ours,
        (Container::Array(length), Container::Sequence(limit)) => {
            limit.is_none_or(|limit| length <= limit)
        }
        // The conversion checks the bound of each message.
        (Container::Sequence(_), Container::Sequence(_)) => true,
        _ => false,
    };
    let element = match (theirs.element, ours.element) {
        (Element::Scalar(theirs), Element::Scalar(ours)) => theirs.fits(ours),
        (Element::Text, Element::Text) | (Element::Struct(_), Element::Struct(_)) => true,
        _ => false,
    };
    container && element
}

#[cfg(test)]
mod tests;
