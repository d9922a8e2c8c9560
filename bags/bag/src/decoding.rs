//! How the bytes of a channel become values of a Rust type: by the definition that the bag carries.

use std::sync::OnceLock;

use wm_msgs::{DescriptionError, Mapping, Message, TypeDescription, cdr};

use crate::{BagError, Schema, definitions};

/// Representation identifiers of plain CDR, version 2.
const PLAIN_CDR_2: [[u8; 2]; 2] = [[0, 6], [0, 7]];

/// What the definition of a channel says about its messages.
#[derive(Debug)]
pub(crate) enum Fields {
    /// Those of the Rust type.
    Same,
    /// The bag has no definition: bytes that are not exactly a value of the Rust type are refused.
    Unknown,
    /// The bag's definition cannot be understood; as [`Unknown`](Self::Unknown).
    Unreadable(DescriptionError),
    /// Others, matched by name.
    Mapped(Box<Mapping>),
    /// Others, which do not fit.
    Refused(String),
}

impl Fields {
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

/// The decoding of a channel's messages. Every message of the channel has it.
#[derive(Debug, Default)]
pub(crate) struct Decoding {
    fields: OnceLock<Fields>,
}

impl Decoding {
    /// The decoding of messages of this type and definition.
    pub fn new(type_name: &str, schema: &Schema) -> Self {
        let decoding = Self::default();
        // The definitions of other types are compared when somebody decodes one.
        if let Some(ours) = definitions::own_description(type_name) {
            decoding
                .fields
                .get_or_init(|| Fields::of(type_name, schema, &ours));
        }
        decoding
    }

    /// How the definition compares with this suite's type of that name; none for a type that the suite does not have.
    pub fn fields(&self) -> Option<&Fields> {
        self.fields.get()
    }

    /// The value in these bytes; `topic` and `schema` are those of the channel.
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
                let fields = Fields::of(&M::ros_name(), schema, &ours()?);
                self.fields.get_or_init(|| fields)
            }
        };
        let is_version_2 = bytes
            .first_chunk::<2>()
            .is_some_and(|representation| PLAIN_CDR_2.contains(representation));
        match fields {
            Fields::Mapped(mapping) => {
                let converted = mapping.convert(bytes);
                plain(&converted.map_err(|error| refused(error.to_string()))?)
            }
            Fields::Refused(reason) => Err(refused(reason.clone())),
            Fields::Same | Fields::Unknown | Fields::Unreadable(_) if is_version_2 => {
                let ours = ours()?;
                let same = Mapping::new(&ours, &ours);
                let same = same.map_err(|error| refused(error.to_string()))?;
                let converted = same.convert(bytes);
                plain(&converted.map_err(|error| refused(error.to_string()))?)
            }
            Fields::Same | Fields::Unknown | Fields::Unreadable(_) => plain(bytes),
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
    fn values_are_found_by_name_where_the_bag_has_other_fields() {
        let values = [&[2, 0, 0, 0][..], &1f32.to_le_bytes(), &2f32.to_le_bytes()].concat();
        for (text, body) in [
            // Types that the schema names and does not define are known.
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
    fn bytes_without_a_definition_must_fit_exactly() {
        // A field before the values: seven as their number leaves four bytes.
        let shifted = [&HEADER[..], &[7, 0, 0, 0, 7, 0, 0, 0], &[0; 28]].concat();
        for text in ["", "std_msgs/Header header header ;;\n{}\n"] {
            assert!(action(text, &shifted).is_err());
            let fitting = [&HEADER[..], &[0; 4]].concat();
            assert!(action(text, &fitting).unwrap().values.is_empty());
        }
    }

    #[test]
    fn cdr_of_version_2_is_read() {
        // An eight-byte number stands at a multiple of four.
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
