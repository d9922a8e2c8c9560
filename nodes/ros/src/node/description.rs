//! The definitions of other nodes' types, by their service `~/get_type_description` (REP 2016).

use std::collections::BTreeSet;

use wm_msgs::{Field, FieldType, IndividualType, TypeDescription, cdr};

use super::Node;
use crate::{
    Error,
    backend::Channel,
    type_description_interfaces::{
        GetTypeDescriptionRequest, GetTypeDescriptionResponse, IndividualTypeDescription,
    },
};

impl Node {
    /// Sets the definition of a type, as a bag has it, for publishers that are then made by the type's name. Zenoh connects
    /// only endpoints whose types have the same hash.
    pub fn describe_type(&self, description: &TypeDescription) {
        self.inner.interfaces.describe(description);
    }

    /// The publishers of a topic in other participants that announce the hash of their type: GUID prefix of the
    /// participant, and hash. `topic` is absolute.
    pub fn type_hashes(&self, topic: &str) -> BTreeSet<([u8; 12], String)> {
        let seen = self.inner.backend().seen().into_iter();
        let publishers = seen.filter(|seen| {
            seen.channel == Channel::Topic && seen.is_writer && !seen.is_own && seen.name == topic
        });
        publishers
            .filter_map(|seen| Some((seen.participant, seen.type_hash?)))
            .collect()
    }

    /// The description of the type of this name and hash, `package/msg/Type` and `RIHS01_...`, from a node that uses
    /// it. Waits without a limit: add a timeout. The inner error is the node's reason.
    ///
    /// # Errors
    /// As [`RawClient::call`](crate::RawClient::call), or an answer of another type.
    pub async fn type_description(
        &self,
        node: &str,
        type_name: &str,
        type_hash: &str,
    ) -> Result<Result<TypeDescription, String>, Error> {
        let service = format!("{node}/get_type_description");
        let client = self.raw_client(&service, GetTypeDescriptionRequest::SERVICE)?;
        client.wait_for_service().await;
        let request = GetTypeDescriptionRequest {
            type_name: type_name.to_owned(),
            type_hash: type_hash.to_owned(),
            include_type_sources: false,
        };
        let answer = client.call(cdr::to_bytes(&request)?.into()).await?;
        let answer: GetTypeDescriptionResponse = cdr::from_bytes(&answer)?;
        if !answer.successful {
            return Ok(Err(format!("{service}: {}", answer.failure_reason)));
        }
        let described = answer.type_description;
        let referenced = described.referenced_type_descriptions.into_iter();
        let description = TypeDescription {
            described: individual(described.type_description),
            referenced: referenced.map(individual).collect(),
        };
        let hash = description.hash().to_string();
        Ok(match hash == type_hash {
            true => Ok(description),
            false => Err(format!(
                "{service}: expected a description with the hash {type_hash}, got one with {hash}"
            )),
        })
    }
}

fn individual(part: IndividualTypeDescription) -> IndividualType {
    let fields = part.fields.into_iter().map(|field| {
        let nested = field.r#type.nested_type_name;
        Field {
            name: field.name,
            field_type: FieldType {
                type_id: field.r#type.type_id,
                capacity: field.r#type.capacity,
                string_capacity: field.r#type.string_capacity,
                nested: (!nested.is_empty()).then_some(nested),
            },
        }
    });
    IndividualType {
        name: part.type_name,
        fields: fields.collect(),
    }
}
