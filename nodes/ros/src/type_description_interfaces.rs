//! The messages of package `type_description_interfaces`, with which a node publishes the definitions of its types.
//! Fields and order are those of the `.msg` and `.srv` files of ROS 2 Jazzy to Kilted.

use serde::{Deserialize, Serialize};

/// Request of `GetTypeDescription`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct GetTypeDescriptionRequest {
    pub(crate) type_name: String,
    pub(crate) type_hash: String,
    pub(crate) include_type_sources: bool,
}

impl GetTypeDescriptionRequest {
    /// The service's type.
    pub(crate) const SERVICE: &str = "type_description_interfaces/srv/GetTypeDescription";
    /// Its hash in ROS 2 Jazzy to Lyrical. Its text is not among the suite's definitions.
    pub(crate) const HASH: &str =
        "RIHS01_69b9c19c1021405984cc60dbbb1edceb147a6538b411d812ba6afabeed962cd5";
}

/// Response of `GetTypeDescription`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct GetTypeDescriptionResponse {
    pub(crate) successful: bool,
    pub(crate) failure_reason: String,
    pub(crate) type_description: TypeDescription,
    pub(crate) type_sources: Vec<TypeSource>,
    pub(crate) extra_information: Vec<KeyValue>,
}

/// `TypeDescription`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct TypeDescription {
    pub(crate) type_description: IndividualTypeDescription,
    pub(crate) referenced_type_descriptions: Vec<IndividualTypeDescription>,
}

/// `IndividualTypeDescription`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct IndividualTypeDescription {
    pub(crate) type_name: String,
    pub(crate) fields: Vec<Field>,
}

/// `Field`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Field {
    pub(crate) name: String,
    pub(crate) r#type: FieldType,
    pub(crate) default_value: String,
}

/// `FieldType`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct FieldType {
    pub(crate) type_id: u8,
    pub(crate) capacity: u64,
    pub(crate) string_capacity: u64,
    pub(crate) nested_type_name: String,
}

/// `TypeSource`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct TypeSource {
    pub(crate) type_name: String,
    pub(crate) encoding: String,
    pub(crate) raw_file_contents: String,
}

/// `KeyValue`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct KeyValue {
    pub(crate) key: String,
    pub(crate) value: String,
}
