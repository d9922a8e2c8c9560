use std::collections::HashMap;

use crate::{BagError, BagReader, BagWarning, BagWriter, reader::StoredMessage};

/// A new bag while it gets messages of another.
pub(crate) struct Part {
    pub writer: BagWriter,
    /// Number in it of each file's channels.
    pub numbers: HashMap<(usize, u16), usize>,
    /// What is wrong with the old bag.
    pub warnings: Vec<BagWarning>,
}

impl Part {
    /// A bag with what is noted of the old one.
    pub fn new(
        reader: &BagReader,
        mut writer: BagWriter,
        notes: impl IntoIterator<Item = (String, String)>,
    ) -> Self {
        for (key, note) in notes {
            writer.note(&key, note);
        }
        Self {
            writer,
            numbers: HashMap::new(),
            warnings: reader.warnings().to_vec(),
        }
    }

    /// Adds the channels of the topics that are wanted.
    pub fn add_channels(
        &mut self,
        reader: &BagReader,
        wants: impl Fn(&str) -> bool,
    ) -> Result<(), BagError> {
        for (file, channel) in reader.definitions() {
            if wants(&channel.topic) {
                let number = self.writer.add_channel(channel.clone())?;
                self.numbers.insert((file, channel.id), number);
            }
        }
        Ok(())
    }

    /// The message, or none for a damaged chunk, which becomes a warning.
    pub fn readable(
        &mut self,
        message: Result<StoredMessage, BagError>,
    ) -> Result<Option<StoredMessage>, BagError> {
        match message {
            Ok(message) => Ok(Some(message)),
            Err(
                error @ (BagError::Chunk { .. }
                | BagError::Message { .. }
                | BagError::LogTime { .. }),
            ) => {
                let warning = match error {
                    BagError::Chunk {
                        path: file,
                        offset,
                        reason,
                    } => BagWarning::Damaged {
                        file,
                        offset,
                        reason,
                    },
                    other => BagWarning::MessageSkipped(other.to_string()),
                };
                if !self.warnings.contains(&warning) {
                    self.warnings.push(warning);
                }
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    pub fn write(
        &mut self,
        message: &StoredMessage,
        header: mcap::records::MessageHeader,
    ) -> Result<(), BagError> {
        let Some(number) = self.numbers.get(&(message.file, header.channel_id)) else {
            return Ok(());
        };
        match self.writer.copy(*number, header, &message.data) {
            // rosbag2 has no such time: the others are written.
            Err(error @ BagError::LogTime { .. }) => self.readable(Err(error)).map(drop),
            written => written,
        }
    }
}
