use std::collections::BTreeMap;

use prost::Message as _;

/// `tf.train.Example` (tensorflow/core/example/example.proto, feature.proto).
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Example {
    #[prost(message, optional, tag = "1")]
    pub features: Option<Features>,
}

/// `tf.train.Features`.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Features {
    #[prost(btree_map = "string, message", tag = "1")]
    pub feature: BTreeMap<String, Feature>,
}

/// `tf.train.Feature`.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Feature {
    #[prost(oneof = "Kind", tags = "1, 2, 3")]
    pub kind: Option<Kind>,
}

/// The list of a feature.
#[derive(Clone, PartialEq, prost::Oneof)]
pub(super) enum Kind {
    #[prost(message, tag = "1")]
    Bytes(BytesList),
    #[prost(message, tag = "2")]
    Floats(FloatList),
    #[prost(message, tag = "3")]
    Integers(Int64List),
}

/// `tf.train.BytesList`.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct BytesList {
    #[prost(bytes = "vec", repeated, tag = "1")]
    pub value: Vec<Vec<u8>>,
}

/// `tf.train.FloatList`.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct FloatList {
    #[prost(float, repeated, tag = "1")]
    pub value: Vec<f32>,
}

/// `tf.train.Int64List`.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Int64List {
    #[prost(int64, repeated, tag = "1")]
    pub value: Vec<i64>,
}

impl Example {
    /// Parses protobuf bytes.
    pub fn parse(bytes: &[u8]) -> Result<Self, String> {
        Self::decode(bytes).map_err(|error| format!("not a tf.train.Example: {error}"))
    }

    /// Names of the features, in order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.features
            .iter()
            .flat_map(|features| features.feature.keys().map(String::as_str))
    }

    pub fn has(&self, name: &str) -> bool {
        self.kind(name).is_some()
    }

    /// A feature of byte strings.
    pub fn bytes(&self, name: &str) -> Result<&[Vec<u8>], String> {
        match self.kind(name) {
            Some(Kind::Bytes(list)) => Ok(&list.value),
            other => Err(format!(
                "expected feature {name} as byte strings, got {}",
                describe(other)
            )),
        }
    }

    /// A feature of floats.
    pub fn floats(&self, name: &str) -> Result<&[f32], String> {
        match self.kind(name) {
            Some(Kind::Floats(list)) => Ok(&list.value),
            other => Err(format!(
                "expected feature {name} as floats, got {}",
                describe(other)
            )),
        }
    }

    /// A feature of booleans, stored as whole numbers, or as floats in some data sets.
    pub fn booleans(&self, name: &str) -> Result<Vec<bool>, String> {
        match self.kind(name) {
            Some(Kind::Integers(list)) => Ok(list.value.iter().map(|value| *value != 0).collect()),
            Some(Kind::Floats(list)) => Ok(list.value.iter().map(|value| *value != 0.0).collect()),
            other => Err(format!(
                "expected feature {name} as booleans, got {}",
                describe(other)
            )),
        }
    }

    fn kind(&self, name: &str) -> Option<&Kind> {
        self.features.as_ref()?.feature.get(name)?.kind.as_ref()
    }
}

fn describe(kind: Option<&Kind>) -> &'static str {
    match kind {
        None => "no such feature",
        Some(Kind::Bytes(_)) => "byte strings",
        Some(Kind::Floats(_)) => "floats",
        Some(Kind::Integers(_)) => "integers",
    }
}
