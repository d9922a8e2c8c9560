//! Decoding of a channel's messages into Rust types, by the definition in the bag.

use std::sync::OnceLock;

use wm_msgs::{DescriptionError, Mapping, Message, MessageType, TypeDescription, cdr};

use crate::{BagError, Schema};

/// Representation identifiers of plain CDR, version 2.
const PLAIN_CDR_2: [[u8; 2]; 2] = [[0, 6], [0, 7]];

/// Comparison of a channel's definition with the Rust type.
#[derive(Debug)]
pub(crate) enum FieldMatch {
    /// The same fields.
    Same,
    /// The bag has no definition: the bytes must be exactly a value of the Rust type.
    Unknown,
    /// The bag's definition is invalid; decoded as [`Unknown`](Self::Unknown).
    Unreadable(DescriptionError),
    /// Other fields, matched by name.
    Mapped(Box<Mapping>),
    /// Other fields that do not fit.
    Refused(String),
}

impl FieldMatch {
    fn of(type_name: &str, schema: &Schema, ours: &TypeDescription) -> Self {
        match schema.description(type_name) {
            Ok(None) => Self::Unknown,
            Ok(Some(theirs)) if theirs == *ours => Self::Same,
            Ok(Some(theirs)) => match Mapping::new(&theirs, ours) {
                Ok(mapping) => Self::Mapped(Box::new(mapping)),
                Err(error) => Self::Refused(error.to_string()),
            },
            Err(error) => Self::Unreadable(error),
        }
    }
}

/// Decodes the messages of a channel.
#[derive(Debug, Default)]
pub(crate) struct Decoding {
    fields: OnceLock<FieldMatch>,
}

impl Decoding {
    /// A decoder for this type and definition.
    pub fn new(type_name: &str, schema: &Schema) -> Self {
        let decoding = Self::default();
        // Other types are compared at the first call of `decode`. A test of `wm_msgs` describes its types.
        if let Some(Ok(ours)) = MessageType::find(type_name).map(MessageType::description) {
            decoding
                .fields
                .get_or_init(|| FieldMatch::of(type_name, schema, &ours));
        }
        decoding
    }

    /// The comparison with this suite's type of the same name; `None` for types of other packages.
    pub fn fields(&self) -> Option<&FieldMatch> {
        self.fields.get()
    }

    /// Decodes these bytes; `topic` and `schema` are those of the channel.
    pub fn decode<M: Message>(
        &self,
        topic: &str,
        schema: &Schema,
        bytes: &[u8],
    ) -> Result<M, BagError> {
        let refused = |reason: String| BagError::Definition {
            topic: topic.to_owned(),
            type_name: M::ros_name(),
            reason,
        };
        let plain = |bytes: &[u8]| {
            cdr::from_bytes(bytes).map_err(|reason| BagError::Cdr {
                topic: topic.to_owned(),
                reason,
            })
        };
        let ours = || TypeDescription::of::<M>().map_err(|error| refused(error.to_string()));
        let fields = match self.fields.get() {
            Some(fields) => fields,
            None => {
                let fields = FieldMatch::of(&M::ros_name(), schema, &ours()?);
                self.fields.get_or_init(|| fields)
            }
        };
        let is_version_2 = bytes
            .first_chunk::<2>()
            .is_some_and(|representation| PLAIN_CDR_2.contains(representation));
        match fields {
            FieldMatch::Mapped(mapping) => {
                let converted = mapping.convert(bytes);
                plain(&converted.map_err(|error| refused(error.to_string()))?)
            }
            FieldMatch::Refused(reason) => Err(refused(reason.clone())),
            FieldMatch::Same | FieldMatch::Unknown | FieldMatch::Unreadable(_) if is_version_2 => {
                let ours = ours()?;
                let same = Mapping::new(&ours, &ours);
                let same = same.map_err(|error| refused(error.to_string()))?;
                let converted = same.convert(bytes);
                plain(&converted.map_err(|error| refused(error.to_string()))?)
            }
            FieldMatch::Same | FieldMatch::Unknown | FieldMatch::Unreadable(_) => plain(bytes),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::type_schema;
    use wm_msgs::{std_msgs, wm_msgs::Action};

    fn action(text: &str, body: &[u8]) -> Result<Action, BagError> {
        let schema = Schema::ros2msg(text);
        let decoding = Decoding::new("wm_msgs/msg/Action", &schema);
        decoding.decode("/wm/action", &schema, &[&[0, 1, 0, 0], body].concat())
    }

    const HEADER: [u8; 16] = [1, 0, 0, 0, 2, 0, 0, 0, 2, 0, 0, 0, b'b', 0, 0, 0];

    #[test]
    fn fields_are_matched_by_name() {
        let values = [&[2, 0, 0, 0][..], &1f32.to_le_bytes(), &2f32.to_le_bytes()].concat();
        for (text, body) in [
            // The reader adds types that the schema uses and does not define.
            (
                "std_msgs/Header header\nfloat32[] values\n",
                [&HEADER[..], &values].concat(),
            ),
            (
                "Header header\nfloat32[] values\nfloat32 confidence\n",
                [&HEADER[..], &values, &[0; 4]].concat(),
            ),
            (
                "std_msgs/Header header\nuint32 mode\nfloat32[] values\n",
                [&HEADER[..], &[7, 0, 0, 0], &values].concat(),
            ),
            (
                "float32[] values\nstd_msgs/Header header\n",
                [&values[..], &HEADER].concat(),
            ),
            ("float32[] values\n", values.clone()),
        ] {
            assert_eq!(action(text, &body).unwrap().values, [1.0, 2.0], "{text}");
        }
        let error = action("std_msgs/Header header\nfloat64[] values\n", &[]).unwrap_err();
        let error = error.to_string();
        assert!(
            error.contains("/wm/action") && error.contains("float64[]"),
            "{error}"
        );
    }

    #[test]
    fn bytes_without_definition_must_fit_exactly() {
        // An unknown field before the values: the count 7 would leave four bytes.
        let shifted = [&HEADER[..], &[7, 0, 0, 0, 7, 0, 0, 0], &[0; 28]].concat();
        for text in ["", "std_msgs/Header header header ;;\n{}\n"] {
            assert!(action(text, &shifted).is_err());
            let fitting = [&HEADER[..], &[0; 4]].concat();
            assert!(action(text, &fitting).unwrap().values.is_empty());
        }
    }

    #[test]
    fn cdr_version_2_is_read() {
        // In version 2, eight-byte numbers are aligned to four bytes.
        let schema = type_schema::<std_msgs::Float64MultiArray>();
        let decoding = Decoding::new("std_msgs/msg/Float64MultiArray", &schema);
        let body = [
            &[0, 7, 0, 0][..],
            &[0; 8],
            &[1, 0, 0, 0],
            &0.5f64.to_le_bytes(),
        ]
        .concat();
        let array: std_msgs::Float64MultiArray = decoding.decode("/x", &schema, &body).unwrap();
        assert_eq!(array.data, [0.5]);
        let delimited = [&[0, 9, 0, 0][..], &[0; 12]].concat();
        let error = decoding.decode::<std_msgs::Float64MultiArray>("/x", &schema, &delimited);
        assert!(error.unwrap_err().to_string().contains("0x0009"));
    }
}
