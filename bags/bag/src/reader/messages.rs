use std::{
    cmp::Reverse,
    collections::{BinaryHeap, HashSet},
    fs::File,
    os::unix::fs::FileExt as _,
    sync::Arc,
};

use bytes::Bytes;
use mcap::records::{MessageHeader, Record, op};
use wm_msgs::Message;

use super::{
    chunk::{Records, decompress},
    file_index::{Channel, FileIndex, Segment, SegmentPlace},
    payload,
    record::parse,
    sqlite::Rows,
};
use crate::{BagError, LatchedMessages, MessageEncoding, Schema, decoding::Decoding};

/// A message of a bag.
#[derive(Clone, Debug)]
pub struct BagMessage {
    /// The full name of the topic.
    pub topic: Arc<str>,
    /// The type: `package/msg/Type`, for protobuf `package.Type`.
    pub type_name: Arc<str>,
    /// Encoding of `data`.
    pub encoding: MessageEncoding,
    /// The type's definition in the bag.
    pub schema: Arc<Schema>,
    /// Time of recording, in ns since the epoch.
    pub log_time_ns: u64,
    /// Time of publication, in ns since the epoch; many recorders repeat the log time.
    pub publish_time_ns: u64,
    /// CDR with its 4-byte header, or protobuf, as recorded; messages that rosbag2 compressed are decompressed.
    pub data: Bytes,
    decoding: Arc<Decoding>,
}

impl PartialEq for BagMessage {
    fn eq(&self, other: &Self) -> bool {
        let parts = |message: &Self| (message.log_time_ns, message.publish_time_ns);
        self.topic == other.topic
            && self.type_name == other.type_name
            && self.schema == other.schema
            && parts(self) == parts(other)
            && self.data == other.data
    }
}

impl Eq for BagMessage {}

impl BagMessage {
    pub(super) fn new(channel: &Channel, header: &MessageHeader, data: Bytes) -> Self {
        Self {
            topic: Arc::clone(&channel.topic.name),
            type_name: Arc::clone(&channel.topic.type_name),
            encoding: channel.topic.encoding,
            schema: Arc::clone(&channel.topic.schema),
            log_time_ns: header.log_time,
            publish_time_ns: header.publish_time,
            data,
            decoding: Arc::clone(&channel.decoding),
        }
    }

    /// Decodes the message by the definition in the bag: fields are matched by name ([`wm_msgs::Mapping`]). If the bag has no
    /// definition, the bytes must be exactly a value of `M`.
    ///
    /// # Errors
    /// The bag has another type, its definition does not fit, or the bytes are invalid.
    pub fn decode<M: Message>(&self) -> Result<M, BagError> {
        let expected = M::ros_name();
        if *self.type_name != expected {
            return Err(BagError::WrongType {
                topic: self.topic.to_string(),
                expected,
                actual: self.type_name.to_string(),
            });
        }
        self.decoding.decode(&self.topic, &self.schema, &self.data)
    }
}

/// Sort key of a message: log time, then its place in the bag.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Place {
    log_time_ns: u64,
    file: usize,
    segment: usize,
    number: usize,
}

/// Limit of queued messages \[bytes\]: chunks that overlap in time are all read at once, and each may have a quarter of
/// this.
const QUEUE_BYTES: usize = 1 << 30;

/// A message in the queue; a copy, so that its chunk can be freed.
#[derive(Debug)]
struct QueuedMessage {
    place: Place,
    channel_id: u16,
    sequence: u32,
    publish_time_ns: u64,
    data: Bytes,
}

impl QueuedMessage {
    fn header(&self) -> MessageHeader {
        MessageHeader {
            channel_id: self.channel_id,
            sequence: self.sequence,
            log_time: self.place.log_time_ns,
            publish_time: self.publish_time_ns,
        }
    }
}

impl PartialEq for QueuedMessage {
    fn eq(&self, other: &Self) -> bool {
        self.place == other.place
    }
}

impl Eq for QueuedMessage {}

impl PartialOrd for QueuedMessage {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for QueuedMessage {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.place.cmp(&other.place)
    }
}

/// The messages of a bag in log-time order; see [`BagReader::messages`](crate::BagReader::messages).
///
/// A chunk is read when the iteration reaches its first message, and freed after its last. An error names a damaged
/// chunk; iteration then continues with other chunks.
#[derive(Debug)]
pub struct Messages {
    index: Arc<Vec<FileIndex>>,
    /// Unread segments (file, segment), latest first.
    ahead: Vec<(usize, usize)>,
    queue: BinaryHeap<Reverse<QueuedMessage>>,
    queue_bytes: usize,
    /// The last file read.
    open: Option<(usize, OpenFile)>,
    topics: Option<HashSet<String>>,
    starting_at_ns: u64,
    ending_before_ns: Option<u64>,
    /// Latched messages so far, if the bag has several files.
    latched: LatchedMessages<LatchedOriginal>,
}

/// A latched message, by the values that its repetition shares.
#[derive(Clone, Debug)]
struct LatchedOriginal {
    file: usize,
    sequence: u32,
    publish_time_ns: u64,
    data: Bytes,
}

#[derive(Debug)]
enum OpenFile {
    Mcap(Arc<File>),
    Sqlite(Rows),
}

/// Faults of single messages of a segment.
#[derive(Default)]
struct Problems {
    first: Option<String>,
    count: u64,
}

impl Problems {
    fn add(&mut self, reason: impl FnOnce() -> String) {
        self.first.get_or_insert_with(reason);
        self.count += 1;
    }
}

impl Messages {
    pub(super) fn new(index: Arc<Vec<FileIndex>>) -> Self {
        let mut ahead: Vec<(u64, usize, usize)> = Vec::new();
        for (number, file) in index.iter().enumerate() {
            let segments = file.segments.iter().enumerate();
            ahead.extend(segments.map(|(place, segment)| (segment.start_ns, number, place)));
        }
        ahead.sort_by_key(|place| Reverse(*place));
        Self {
            index,
            ahead: ahead
                .into_iter()
                .map(|(_, file, segment)| (file, segment))
                .collect(),
            queue: BinaryHeap::new(),
            queue_bytes: 0,
            open: None,
            topics: None,
            starting_at_ns: 0,
            ending_before_ns: None,
            latched: LatchedMessages::default(),
        }
    }

    /// Skips the segments without a wanted message.
    fn retain(&mut self, may_hold: impl Fn(&FileIndex, &Segment) -> bool) {
        let index = &self.index;
        self.ahead.retain(|(file, segment)| {
            let file = index.get(*file);
            let segment = file.and_then(|file| Some((file, file.segments.get(*segment)?)));
            segment.is_some_and(|(file, segment)| may_hold(file, segment))
        });
    }

    /// Limits the iteration to these topics. Call before taking the first message.
    #[must_use]
    pub fn only_topics<S: AsRef<str>>(mut self, topics: impl IntoIterator<Item = S>) -> Self {
        let topics: HashSet<String> = topics
            .into_iter()
            .map(|topic| topic.as_ref().to_owned())
            .collect();
        self.retain(|file, segment| {
            let wanted = |id| match file.channels.get(id) {
                Some(channel) => topics.contains(&*channel.topic.name),
                // Messages without a channel must be reported as damage.
                None => !file.skipped.contains_key(id),
            };
            segment
                .channels
                .as_ref()
                .is_none_or(|ids| ids.iter().any(wanted))
        });
        self.topics = Some(topics);
        self
    }

    /// Limits the iteration to messages at or after this log time, in ns since the epoch; earlier chunks are not read. Call
    /// before taking the first message.
    #[must_use]
    pub fn starting_at(mut self, log_time_ns: u64) -> Self {
        self.starting_at_ns = log_time_ns;
        self.retain(|_, segment| segment.end_ns >= log_time_ns);
        self
    }

    /// Limits the iteration to messages before this log time, in ns since the epoch; later chunks are not read. Call before
    /// taking the first message.
    #[must_use]
    pub fn ending_before(mut self, log_time_ns: u64) -> Self {
        self.ending_before_ns = Some(log_time_ns);
        self.retain(|_, segment| segment.start_ns < log_time_ns);
        self
    }

    /// Reads a segment into the queue.
    fn load(&mut self, file: usize, number: usize) -> Result<(), BagError> {
        let index = Arc::clone(&self.index);
        let Some((file_index, segment)) = index
            .get(file)
            .and_then(|file| Some((file, file.segments.get(number)?)))
        else {
            return Ok(());
        };
        let damaged = |reason: String| BagError::Chunk {
            path: file_index.path().to_owned(),
            offset: segment.place.offset(),
            reason,
        };
        // Faulty messages do not prevent reading the others of the segment.
        let mut problems = Problems::default();
        let wants = |messages: &Self, problems: &mut Problems, header: &MessageHeader| {
            let Some(channel) = file_index.channels.get(&header.channel_id) else {
                if !file_index.skipped.contains_key(&header.channel_id) {
                    let id = header.channel_id;
                    problems.add(|| format!("it has a message of the undefined channel {id}"));
                }
                return false;
            };
            if !(segment.start_ns..=segment.end_ns).contains(&header.log_time) {
                problems.add(|| {
                    "the log time of a message is outside the indexed range, so it may be out of order"
                        .into()
                });
            }
            header.log_time >= messages.starting_at_ns
                && messages
                    .ending_before_ns
                    .is_none_or(|end_ns| header.log_time < end_ns)
                && messages
                    .topics
                    .as_ref()
                    .is_none_or(|topics| topics.contains(&*channel.topic.name))
        };
        match segment.place {
            SegmentPlace::Bytes { offset, length } => {
                let bytes = self.bytes(file, file_index, (offset, length))?;
                let mut outer = Records::new(bytes.clone());
                let records = match outer.next() {
                    Some(Ok(record)) if record.opcode == op::CHUNK => {
                        Records::new(decompress(&record.body).map_err(damaged)?)
                    }
                    _ => Records::new(bytes),
                };
                for (place, record) in records.enumerate() {
                    let record = record.map_err(damaged)?;
                    if record.opcode != op::MESSAGE {
                        continue;
                    }
                    match parse(op::MESSAGE, &record.body) {
                        Ok(Record::Message { header, data }) => {
                            if wants(self, &mut problems, &header) {
                                let data = Bytes::copy_from_slice(&data);
                                let place = (file, number, place);
                                self.enqueue(file_index, segment, place, (header, data))?;
                            }
                        }
                        Ok(_) => {}
                        Err(reason) => problems.add(|| reason),
                    }
                }
            }
            SegmentPlace::Rows { first, last } => {
                let rows = self.rows(file, file_index)?;
                let found = rows.read(first, last).map_err(damaged)?;
                for (place, (header, data)) in found.into_iter().enumerate() {
                    if wants(self, &mut problems, &header) {
                        let place = (file, number, place);
                        self.enqueue(file_index, segment, place, (header, data))?;
                    }
                }
            }
        }
        match problems.first {
            Some(first) if problems.count > 1 => {
                let others = problems.count - 1;
                Err(damaged(format!("{first}, and {others} more")))
            }
            Some(first) => Err(damaged(first)),
            None => Ok(()),
        }
    }

    /// Adds a message to the queue.
    fn enqueue(
        &mut self,
        file_index: &FileIndex,
        segment: &Segment,
        (file, number, place): (usize, usize, usize),
        (header, data): (MessageHeader, Bytes),
    ) -> Result<(), BagError> {
        // Each queued message has a fixed cost.
        let queue_bytes = self.queue_bytes + size_of::<QueuedMessage>() + data.len();
        if queue_bytes > QUEUE_BYTES {
            return Err(BagError::Overlap {
                path: file_index.path().to_owned(),
                offset: segment.place.offset(),
                limit: QUEUE_BYTES,
            });
        }
        self.queue_bytes = queue_bytes;
        self.queue.push(Reverse(QueuedMessage {
            place: Place {
                log_time_ns: header.log_time,
                file,
                segment: number,
                number: place,
            },
            channel_id: header.channel_id,
            sequence: header.sequence,
            publish_time_ns: header.publish_time,
            data,
        }));
        Ok(())
    }

    /// Reads bytes of an MCAP file.
    fn bytes(
        &mut self,
        number: usize,
        index: &FileIndex,
        (offset, length): (u64, u64),
    ) -> Result<Bytes, BagError> {
        let io = |source| BagError::io(index.path(), source);
        let file = match &self.open {
            Some((known, OpenFile::Mcap(file))) if *known == number => Arc::clone(file),
            _ => {
                let file = Arc::new(index.file.file().map_err(io)?);
                self.open = Some((number, OpenFile::Mcap(Arc::clone(&file))));
                file
            }
        };
        // Fits: the index bounds segments by MAX_RECORD_BYTES, or one record and STRETCH_BYTES, and by the file.
        let mut bytes = vec![0; length as usize];
        file.read_exact_at(&mut bytes, offset).map_err(io)?;
        Ok(bytes.into())
    }

    fn rows(&mut self, number: usize, index: &FileIndex) -> Result<&Rows, BagError> {
        if !matches!(&self.open, Some((known, OpenFile::Sqlite(_))) if *known == number) {
            let rows = Rows::open(&index.file)?;
            self.open = Some((number, OpenFile::Sqlite(rows)));
        }
        match &self.open {
            Some((_, OpenFile::Sqlite(rows))) => Ok(rows),
            _ => Err(BagError::Empty {
                path: index.path().to_owned(),
                reason: "it cannot be opened again",
            }),
        }
    }

    fn next_queued(&mut self) -> Option<Result<QueuedMessage, BagError>> {
        loop {
            // Chunks that begin at or before the next message may have an earlier one.
            while let Some((file, number)) = self.ahead.last().copied() {
                let file_index = self.index.get(file);
                let segment = file_index.and_then(|file| file.segments.get(number));
                let start_ns = segment.map_or(0, |segment| segment.start_ns);
                let due = self
                    .queue
                    .peek()
                    .is_none_or(|Reverse(next)| start_ns <= next.place.log_time_ns);
                if !due {
                    break;
                }
                self.ahead.pop();
                if let Err(error) = self.load(file, number) {
                    return Some(Err(error));
                }
            }
            let Reverse(next) = self.queue.pop()?;
            self.queue_bytes -= size_of::<QueuedMessage>() + next.data.len();
            if !self.is_repeated(&next) {
                return Some(self.decompress_message(next));
            }
        }
    }

    /// Whether this message repeats a latched message of an earlier file: same sequence number, publish time and bytes.
    fn is_repeated(&mut self, next: &QueuedMessage) -> bool {
        if self.index.len() < 2 {
            return false;
        }
        let file = self.index.get(next.place.file);
        let channel = file.and_then(|file| file.channels.get(&next.channel_id));
        let Some(channel) = channel.filter(|channel| channel.is_latched) else {
            return false;
        };
        let name = &channel.topic.name;
        let is_moved = next.publish_time_ns != next.place.log_time_ns;
        let is_same = |known: &LatchedOriginal| {
            known.file < next.place.file
                && known.sequence == next.sequence
                && known.publish_time_ns == next.publish_time_ns
                && known.data == next.data
        };
        let came = self
            .latched
            .iter()
            .any(|(topic, known)| topic == name && is_same(known));
        if is_moved && came {
            return true;
        }
        let message = LatchedOriginal {
            file: next.place.file,
            sequence: next.sequence,
            publish_time_ns: next.publish_time_ns,
            data: next.data.clone(),
        };
        self.latched.add(name, &next.data, message);
        false
    }

    /// Decompresses the message if rosbag2 compressed it.
    fn decompress_message(&self, mut next: QueuedMessage) -> Result<QueuedMessage, BagError> {
        if let Some(data) = payload::decompress(&next.data) {
            let file = self.index.get(next.place.file);
            let channel = file.and_then(|file| file.channels.get(&next.channel_id));
            next.data = data.map_err(|reason| BagError::Message {
                topic: channel.map_or_else(String::new, |known| known.topic.name.to_string()),
                log_time_ns: next.place.log_time_ns,
                reason,
            })?;
        }
        Ok(next)
    }
}

impl Iterator for Messages {
    type Item = Result<BagMessage, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        let next = match self.next_queued()? {
            Ok(next) => next,
            Err(error) => return Some(Err(error)),
        };
        let file = self.index.get(next.place.file)?;
        let channel = file.channels.get(&next.channel_id)?;
        let header = next.header();
        Some(Ok(BagMessage::new(channel, &header, next.data)))
    }
}

/// A message with its header in the file, for copies.
#[derive(Debug)]
pub(crate) struct StoredMessage {
    /// Number of the file in the bag.
    pub file: usize,
    /// Channel, sequence number and times.
    pub header: MessageHeader,
    pub data: Bytes,
}

#[derive(Debug)]
pub(crate) struct StoredMessages(pub Messages);

impl Iterator for StoredMessages {
    type Item = Result<StoredMessage, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        let next = self.0.next_queued()?;
        Some(next.map(|next| StoredMessage {
            file: next.place.file,
            header: next.header(),
            data: next.data,
        }))
    }
}
