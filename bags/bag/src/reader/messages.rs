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
    chunk::{Records, decompressed},
    file_index::{Channel, FileIndex, Segment, SegmentPlace},
    payload,
    record::parse,
    sqlite::Rows,
};
use crate::{BagError, Latched, MessageEncoding, Schema, decoding::Decoding};

/// A message of a bag.
#[derive(Clone, Debug)]
pub struct BagMessage {
    /// The topic's full name.
    pub topic: Arc<str>,
    /// The type, as `package/msg/Type`; of protobuf as `package.Type`.
    pub type_name: Arc<str>,
    /// How `data` is encoded.
    pub encoding: MessageEncoding,
    /// The type's definition, as the bag carries it.
    pub schema: Arc<Schema>,
    /// When it was recorded, in ns since the epoch.
    pub log_time_ns: u64,
    /// When it was published, in ns since the epoch; many recorders repeat the log time.
    pub publish_time_ns: u64,
    /// CDR with its 4-byte header, or protobuf, as it was recorded; decompressed, if rosbag2 compressed it.
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

    /// The message as a Rust type, by the definition that the bag carries: fields are matched by name
    /// ([`wm_msgs::Mapping`]). If the bag has no definition, the bytes have to be exactly a value of the type.
    ///
    /// # Errors
    /// The bag names another type, its definition does not fit, or the bytes are not of it.
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

/// Where a message comes in the iteration: by log time, then by its place in the bag.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Place {
    log_time_ns: u64,
    file: usize,
    segment: usize,
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

impl Waiting {
    fn header(&self) -> MessageHeader {
        MessageHeader {
            channel_id: self.channel_id,
            sequence: self.sequence,
            log_time: self.place.log_time_ns,
            publish_time: self.publish_time_ns,
        }
    }
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
    /// Number of the file and of the segment in it; the next one to read is the last.
    ahead: Vec<(usize, usize)>,
    waiting: BinaryHeap<Reverse<Waiting>>,
    waiting_bytes: usize,
    /// The file that was read last.
    open: Option<(usize, Open)>,
    topics: Option<HashSet<String>>,
    starting_at_ns: u64,
    ending_before_ns: Option<u64>,
    /// The messages of latched topics that came, of a bag with several files.
    latched: Latched<Came>,
}

/// A message that came, by what a repetition of it has too.
#[derive(Clone, Debug)]
struct Came {
    file: usize,
    sequence: u32,
    publish_time_ns: u64,
    data: Bytes,
}

/// A file that is open.
#[derive(Debug)]
enum Open {
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
            waiting: BinaryHeap::new(),
            waiting_bytes: 0,
            open: None,
            topics: None,
            starting_at_ns: 0,
            ending_before_ns: None,
            latched: Latched::default(),
        }
    }

    /// Keeps the segments ahead that may hold a wanted message.
    fn retain(&mut self, may_hold: impl Fn(&FileIndex, &Segment) -> bool) {
        let index = &self.index;
        self.ahead.retain(|(file, segment)| {
            let file = index.get(*file);
            let segment = file.and_then(|file| Some((file, file.segments.get(*segment)?)));
            segment.is_some_and(|(file, segment)| may_hold(file, segment))
        });
    }

    /// Only the messages of these topics. To be called before the first message is taken.
    #[must_use]
    pub fn only_topics<S: AsRef<str>>(mut self, topics: impl IntoIterator<Item = S>) -> Self {
        let topics: HashSet<String> = topics
            .into_iter()
            .map(|topic| topic.as_ref().to_owned())
            .collect();
        self.retain(|file, segment| {
            let wanted = |id| match file.channels.get(id) {
                Some(channel) => topics.contains(&*channel.topic.name),
                // A message without a channel is damage, which is named.
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

    /// Only the messages at or after this log time, in ns since the epoch. Chunks before it are not read. To be
    /// called before the first message is taken.
    #[must_use]
    pub fn starting_at(mut self, log_time_ns: u64) -> Self {
        self.starting_at_ns = log_time_ns;
        self.retain(|_, segment| segment.end_ns >= log_time_ns);
        self
    }

    /// Reads a segment and puts its messages among those that wait.
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
        // The other messages of the segment are read all the same.
        let mut problems = Problems::default();
        let wants = |messages: &Self, problems: &mut Problems, header: &MessageHeader| {
            let Some(channel) = file_index.channels.get(&header.channel_id) else {
                if !file_index.skipped.contains_key(&header.channel_id) {
                    let id = header.channel_id;
                    problems.add(|| format!("it has a message of the unknown channel {id}"));
                }
                return false;
            };
            if !(segment.start_ns..=segment.end_ns).contains(&header.log_time) {
                problems.add(|| {
                    "the file's indexes deny the log time of a message, which may come late".into()
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
                        Records::new(decompressed(&record.body).map_err(damaged)?)
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
                                self.wait(file_index, segment, place, (header, data))?;
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
                        self.wait(file_index, segment, place, (header, data))?;
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

    /// Puts a message among those that wait.
    fn wait(
        &mut self,
        file_index: &FileIndex,
        segment: &Segment,
        (file, number, place): (usize, usize, usize),
        (header, data): (MessageHeader, Bytes),
    ) -> Result<(), BagError> {
        // What it costs to keep a message, however short.
        let waiting_bytes = self.waiting_bytes + size_of::<Waiting>() + data.len();
        if waiting_bytes > WAITING_BYTES {
            return Err(BagError::Overlap {
                path: file_index.path().to_owned(),
                offset: segment.place.offset(),
                limit: WAITING_BYTES,
            });
        }
        self.waiting_bytes = waiting_bytes;
        self.waiting.push(Reverse(Waiting {
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

    /// Bytes of an MCAP file.
    fn bytes(
        &mut self,
        number: usize,
        index: &FileIndex,
        (offset, length): (u64, u64),
    ) -> Result<Bytes, BagError> {
        let io = |source| BagError::io(index.path(), source);
        let file = match &self.open {
            Some((known, Open::Mcap(file))) if *known == number => Arc::clone(file),
            _ => {
                let file = Arc::new(index.file.file().map_err(io)?);
                self.open = Some((number, Open::Mcap(Arc::clone(&file))));
                file
            }
        };
        // The index holds segments to MAX_RECORD_BYTES or to one record and a stretch, and within the file.
        let mut bytes = vec![0; length as usize];
        file.read_exact_at(&mut bytes, offset).map_err(io)?;
        Ok(bytes.into())
    }

    /// The rows of an sqlite3 file.
    fn rows(&mut self, number: usize, index: &FileIndex) -> Result<&Rows, BagError> {
        if !matches!(&self.open, Some((known, Open::Sqlite(_))) if *known == number) {
            let rows = Rows::open(&index.file)?;
            self.open = Some((number, Open::Sqlite(rows)));
        }
        match &self.open {
            Some((_, Open::Sqlite(rows))) => Ok(rows),
            _ => Err(BagError::Empty {
                path: index.path().to_owned(),
                reason: "it cannot be opened again",
            }),
        }
    }
}

impl Messages {
    /// Only the messages before this log time, in ns since the epoch. Chunks after it are not read. To be called
    /// before the first message is taken.
    #[must_use]
    pub fn ending_before(mut self, log_time_ns: u64) -> Self {
        self.ending_before_ns = Some(log_time_ns);
        self.retain(|_, segment| segment.start_ns < log_time_ns);
        self
    }

    fn next_waiting(&mut self) -> Option<Result<Waiting, BagError>> {
        loop {
            // Every chunk that begins at or before the next message may hold one that comes earlier.
            while let Some((file, number)) = self.ahead.last().copied() {
                let file_index = self.index.get(file);
                let segment = file_index.and_then(|file| file.segments.get(number));
                let start_ns = segment.map_or(0, |segment| segment.start_ns);
                let due = self
                    .waiting
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
            let Reverse(next) = self.waiting.pop()?;
            self.waiting_bytes -= size_of::<Waiting>() + next.data.len();
            if !self.is_repeated(&next) {
                return Some(self.plain(next));
            }
        }
    }

    /// Whether a later file begins with this message once more: its sequence number, publish time and bytes are those of
    /// one that came before.
    fn is_repeated(&mut self, next: &Waiting) -> bool {
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
        let is_same = |known: &Came| {
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
        let message = Came {
            file: next.place.file,
            sequence: next.sequence,
            publish_time_ns: next.publish_time_ns,
            data: next.data.clone(),
        };
        self.latched.keep(name, &next.data, message);
        false
    }

    /// The message, decompressed if rosbag2 compressed it by itself.
    fn plain(&self, mut next: Waiting) -> Result<Waiting, BagError> {
        if let Some(data) = payload::decompressed(&next.data) {
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
        let next = match self.next_waiting()? {
            Ok(next) => next,
            Err(error) => return Some(Err(error)),
        };
        let file = self.index.get(next.place.file)?;
        let channel = file.channels.get(&next.channel_id)?;
        let header = next.header();
        Some(Ok(BagMessage::new(channel, &header, next.data)))
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
            header: next.header(),
            data: next.data,
        }))
    }
}
