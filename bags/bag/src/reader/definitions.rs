use std::{
    borrow::Cow,
    collections::{BTreeMap, HashMap},
    sync::Arc,
};

use mcap::records::{self, Record};

/// The schemas and channels of a file. As MCAP specifies, the first definition of an id counts.
#[derive(Debug, Default)]
pub(crate) struct Definitions {
    schemas: HashMap<u16, Arc<mcap::Schema<'static>>>,
    channels: BTreeMap<u16, records::Channel>,
}

impl Definitions {
    /// Adds a schema or a channel; ignores other records.
    pub fn add(&mut self, record: Record<'_>) {
        match record {
            Record::Schema { header, data } => {
                self.schemas.entry(header.id).or_insert_with(|| {
                    Arc::new(mcap::Schema {
                        id: header.id,
                        name: header.name,
                        encoding: header.encoding,
                        data: Cow::Owned(data.into_owned()),
                    })
                });
            }
            Record::Channel(channel) => {
                self.channels.entry(channel.id).or_insert(channel);
            }
            _ => {}
        }
    }

    /// The ids of the channels.
    pub fn ids(&self) -> impl Iterator<Item = u16> + '_ {
        self.channels.keys().copied()
    }

    /// A channel, with its schema if that is defined.
    pub fn channel(&self, id: u16) -> Option<Arc<mcap::Channel<'static>>> {
        let channel = self.channels.get(&id)?;
        Some(Arc::new(mcap::Channel {
            id,
            topic: channel.topic.clone(),
            schema: self.schemas.get(&channel.schema_id).cloned(),
            message_encoding: channel.message_encoding.clone(),
            metadata: channel.metadata.clone(),
        }))
    }
}
