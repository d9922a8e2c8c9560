use std::{
    cmp::Reverse,
    collections::{BinaryHeap, HashSet},
    fs::File,
    io::{Read as _, Seek as _, SeekFrom},
    sync::Arc,
};

use bytes::Bytes;
use mcap::{
    parse_record,
    records::{MessageHeader, Record, op},
};
use wm_msgs::{Message, cdr};

use super::{
    chunk::{Records, decompressed},
    file_index::{FileIndex, Segment},
};
use crate::BagError;

/// A message of a bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BagMessage {
    /// The topic's full name.
    pub topic: Arc<str>,
    /// The type, as `package/msg/Type`.
    pub type_name: Arc<str>,
    /// When it was recorded, in ns since the epoch.
    pub log_time_ns: u64,
    /// When it was published, in ns since the epoch; many recorders repeat the log time.
    pub publish_time_ns: u64,
    /// CDR with its 4-byte header, as it was recorded.
    pub data: Bytes,
}

impl BagMessage {
    /// The message as a Rust type.
    ///
    /// # Errors
    /// The bag names another type, or the bytes are not of this type.
    pub fn decode<M: Message>(&self) -> Result<M, BagError> {
        let expected = M::ros_name();
        if *self.type_name != expected {
            return Err(BagError::WrongType {
                topic: self.topic.to_string(),
                expected,
                actual: self.type_name.to_string(),
            });
        }
        cdr::from_bytes(&self.data).map_err(|reason| BagError::Cdr {
            topic: self.topic.to_string(),
            reason,
        })
    }
}

/// Where a message comes in the iteration: by log time, then by its place in the bag.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Place {
    log_time_ns: u64,
    file: usize,
    segment_offset: u64,
    number: usize,
}

/// Most bytes of messages that wait for their turn: chunks that cover the same time are all read at once, and each may
/// hold a quarter of this.
const WAITING_BYTES: usize = 1 << 30;

/// A message that waits for its turn; a copy, so that it does not keep its chunk in memory.
#[derive(Debug)]
struct Waiting {
    place: Place,
    channel_id: u16,
    sequence: u32,
    publish_time_ns: u64,
    data: Bytes,
}

impl PartialEq for Waiting {
    fn eq(&self, other: &Self) -> bool {
        self.place == other.place
    }
}

impl Eq for Waiting {}

impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Waiting {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.place.cmp(&other.place)
    }
}

/// The messages of a bag in log-time order; see [`BagReader::messages`](crate::BagReader::messages).
///
/// Chunks are read when the time comes to the first message in them, and dropped after the last. An error names the
/// damaged chunk; the messages of the others still come after it.
#[derive(Debug)]
pub struct Messages {
    index: Arc<Vec<FileIndex>>,
    /// Number of the file and the segment; the next one to read is the last.
    ahead: Vec<(usize, Segment)>,
    waiting: BinaryHeap<Reverse<Waiting>>,
    waiting_bytes: usize,
    /// The file that was read last.
    open: Option<(usize, File)>,
    topics: Option<HashSet<String>>,
    starting_at_ns: u64,
    ending_before_ns: Option<u64>,
}

impl Messages {
    pub(super) fn new(index: Arc<Vec<FileIndex>>) -> Self {
        let mut ahead: Vec<(usize, Segment)> = index
            .iter()
            .enumerate()
            .flat_map(|(number, file)| file.segments.iter().map(move |segment| (number, *segment)))
            .collect();
        ahead.sort_by_key(|(file, segment)| Reverse((segment.start_ns, *file, segment.offset)));
        Self {
            index,
            ahead,
            waiting: BinaryHeap::new(),
            waiting_bytes: 0,
            open: None,
            topics: None,
            starting_at_ns: 0,
            ending_before_ns: None,
        }
    }

    /// Only the messages of these topics. To be called before the first message is taken.
    #[must_use]
    pub fn only_topics<S: AsRef<str>>(mut self, topics: impl IntoIterator<Item = S>) -> Self {
        self.topics = Some(
            topics
                .into_iter()
                .map(|topic| topic.as_ref().to_owned())
                .collect(),
        );
        self
    }

    /// Only the messages at or after this log time, in ns since the epoch. Chunks before it are not read. To be
    /// called before the first message is taken.
    #[must_use]
    pub fn starting_at(mut self, log_time_ns: u64) -> Self {
        self.starting_at_ns = log_time_ns;
        self.ahead
            .retain(|(_, segment)| segment.end_ns >= log_time_ns);
        self
    }

    /// Reads a segment and puts its messages among those that wait.
    fn load(&mut self, file: usize, segment: &Segment) -> Result<(), BagError> {
        let index = Arc::clone(&self.index);
        let Some(file_index) = index.get(file) else {
            return Ok(());
        };
        let damaged = |reason: String| BagError::Chunk {
            path: file_index.path.clone(),
            offset: segment.offset,
            reason,
        };
        let bytes = self.read(file, file_index, segment)?;
        let mut outer = Records::new(bytes.clone());
        let records = match outer.next() {
            Some(Ok(record)) if record.opcode == op::CHUNK => {
                Records::new(decompressed(&record.body).map_err(damaged)?)
            }
            _ => Records::new(bytes),
        };
        for (number, record) in records.enumerate() {
            let record = record.map_err(damaged)?;
            if record.opcode != op::MESSAGE {
                continue;
            }
            let parsed = parse_record(op::MESSAGE, &record.body)
                .map_err(|error| damaged(error.to_string()))?;
            let Record::Message { header, data } = parsed else {
                continue;
            };
            let Some(topic) = file_index.channels.get(&header.channel_id) else {
                return Err(damaged(format!(
                    "it has a message of the unknown channel {}",
                    header.channel_id
                )));
            };
            let wanted = header.log_time >= self.starting_at_ns
                && self
                    .ending_before_ns
                    .is_none_or(|end_ns| header.log_time < end_ns)
                && self
                    .topics
                    .as_ref()
                    .is_none_or(|topics| topics.contains(&*topic.name));
            if wanted {
                // What it costs to keep a message, however short.
                let waiting_bytes = self.waiting_bytes + size_of::<Waiting>() + data.len();
                if waiting_bytes > WAITING_BYTES {
                    return Err(BagError::Overlap {
                        path: file_index.path.clone(),
                        offset: segment.offset,
                        limit: WAITING_BYTES,
                    });
                }
                self.waiting_bytes = waiting_bytes;
                self.waiting.push(Reverse(Waiting {
                    place: Place {
                        log_time_ns: header.log_time,
                        file,
                        segment_offset: segment.offset,
                        number,
                    },
                    channel_id: header.channel_id,
                    sequence: header.sequence,
                    publish_time_ns: header.publish_time,
                    data: Bytes::copy_from_slice(&data),
                }));
            }
        }
        Ok(())
    }

    fn read(
        &mut self,
        file: usize,
        index: &FileIndex,
        segment: &Segment,
    ) -> Result<Bytes, BagError> {
        let io = |source| BagError::io(&index.path, source);
        let stream = match &mut self.open {
            Some((number, stream)) if *number == file => stream,
            other => &mut other.insert((file, File::open(&index.path).map_err(io)?)).1,
        };
        stream.seek(SeekFrom::Start(segment.offset)).map_err(io)?;
        // The index holds segments to MAX_RECORD_BYTES or to one record and a stretch, and within the file.
        let mut bytes = vec![0; segment.length as usize];
        stream.read_exact(&mut bytes).map_err(io)?;
        Ok(bytes.into())
    }
}

impl Messages {
    /// Only the messages before this log time, in ns since the epoch. Chunks after it are not read. To be called
    /// before the first message is taken.
    pub(crate) fn ending_before(mut self, log_time_ns: u64) -> Self {
        self.ending_before_ns = Some(log_time_ns);
        self.ahead
            .retain(|(_, segment)| segment.start_ns < log_time_ns);
        self
    }

    fn next_waiting(&mut self) -> Option<Result<Waiting, BagError>> {
        // Every chunk that begins at or before the next message may hold one that comes earlier.
        while let Some((file, segment)) = self.ahead.last().copied() {
            let due = self
                .waiting
                .peek()
                .is_none_or(|Reverse(next)| segment.start_ns <= next.place.log_time_ns);
            if !due {
                break;
            }
            self.ahead.pop();
            if let Err(error) = self.load(file, &segment) {
                return Some(Err(error));
            }
        }
        let Reverse(next) = self.waiting.pop()?;
        self.waiting_bytes -= size_of::<Waiting>() + next.data.len();
        Some(Ok(next))
    }
}

impl Iterator for Messages {
    type Item = Result<BagMessage, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        let next = match self.next_waiting()? {
            Ok(next) => next,
            Err(error) => return Some(Err(error)),
        };
        let topic = self
            .index
            .get(next.place.file)?
            .channels
            .get(&next.channel_id)?;
        Some(Ok(BagMessage {
            topic: Arc::clone(&topic.name),
            type_name: Arc::clone(&topic.type_name),
            log_time_ns: next.place.log_time_ns,
            publish_time_ns: next.publish_time_ns,
            data: next.data,
        }))
    }
}

/// A message with what the file says of it, for who copies it.
#[derive(Debug)]
pub(crate) struct StoredMessage {
    /// Number of its file in the bag.
    pub file: usize,
    /// Channel, sequence number and times.
    pub header: MessageHeader,
    pub data: Bytes,
}

/// [`Messages`] as the files hold them.
#[derive(Debug)]
pub(crate) struct StoredMessages(pub Messages);

impl Iterator for StoredMessages {
    type Item = Result<StoredMessage, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        let next = self.0.next_waiting()?;
        Some(next.map(|next| StoredMessage {
            file: next.place.file,
            header: MessageHeader {
                channel_id: next.channel_id,
                sequence: next.sequence,
                log_time: next.place.log_time_ns,
                publish_time: next.publish_time_ns,
            },
            data: next.data,
        }))
    }
}
