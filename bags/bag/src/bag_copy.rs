use std::collections::HashMap;

use crate::{BagError, BagReader, BagWarning, BagWriter, reader::StoredMessage};

/// Limit of warnings with details about chunks and messages of the old bag; further ones are counted.
const MOST_NAMED: usize = 100;

/// Copies messages of a bag to a new one.
pub(crate) struct BagCopy {
    pub writer: BagWriter,
    /// The writer's channel number, by file and channel id.
    numbers: HashMap<(usize, u16), usize>,
    /// Faults of the old bag, and skipped messages.
    pub warnings: Vec<BagWarning>,
    /// Number of warnings with details that [`warn`](Self::warn) added.
    named: usize,
}

impl BagCopy {
    /// A copy with these notes.
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
            named: 0,
        }
    }

    /// Adds a warning about a skipped chunk or message, up to a limit; further ones are counted.
    fn warn(&mut self, warning: BagWarning) {
        if self.warnings.contains(&warning) {
            return;
        }
        match self.warnings.last_mut() {
            Some(BagWarning::MoreSkipped { count }) => *count += 1,
            _ if self.named < MOST_NAMED => {
                self.named += 1;
                self.warnings.push(warning);
            }
            _ => self.warnings.push(BagWarning::MoreSkipped { count: 1 }),
        }
    }

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

    /// The message; `None` and a warning if it is damaged.
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
                self.warn(warning);
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
            // rosbag2 cannot store this time; other messages can be copied.
            Err(error @ BagError::LogTime { .. }) => self.readable(Err(error)).map(drop),
            written => written,
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::{
        BagWarning, BagWriter, CutEnd, CutStart, QosProfile, TopicFilter, WriterOptions, cut,
        type_schema,
    };
    use wm_msgs::{Message as _, std_msgs::String as Text};

    #[test]
    fn skipped_messages_are_named_up_to_a_limit() {
        let scratch = tempfile::tempdir().unwrap();
        let (old, new) = (scratch.path().join("old"), scratch.path().join("new"));
        let mut writer = BagWriter::create(&old, WriterOptions::default()).unwrap();
        let (name, schema) = (Text::ros_name(), type_schema::<Text>());
        let qos = QosProfile::reliable().to_yaml();
        writer.add_topic_raw("/text", &name, &schema, &qos).unwrap();
        // The magic number of zstd without a valid frame.
        let broken = [0x28, 0xb5, 0x2f, 0xfd, 0xff, 0xff];
        for time in 1..=250 {
            writer
                .write_raw("/text", &name, &schema, time, &broken)
                .unwrap();
        }
        writer.finish().unwrap();
        let all = TopicFilter::default();
        let cut = cut(&old, &new, CutStart::Beginning, CutEnd::End, &all).unwrap();
        assert_eq!(cut.summary.message_count, 0);
        assert_eq!(cut.warnings.len(), 101);
        assert_eq!(
            cut.warnings.last(),
            Some(&BagWarning::MoreSkipped { count: 150 })
        );
    }
}
