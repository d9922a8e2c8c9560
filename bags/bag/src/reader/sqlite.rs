//! sqlite3 files of rosbag2 (`.db3`), in each version of its schema: `topics` and `messages`, since version 4 (ROS 2 Iron)
//! also `message_definitions`.
//!
//! Files are opened as immutable: without a lock, a journal or other new files.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    os::unix::ffi::OsStrExt as _,
    path::{Path, PathBuf},
    sync::Arc,
};

use bytes::Bytes;
use mcap::records::MessageHeader;
use rusqlite::{Connection, OpenFlags, Row, config::DbConfig, types::ValueRef};
use wm_msgs::Layout;

use super::{
    chunk::MAX_RECORD_BYTES,
    file_index::{FileIndex, Segment, SegmentPlace},
    payload,
    stored_file::StoredFile,
};
use crate::{BagError, BagWarning, QOS_KEY, Schema, SchemaEncoding, TYPE_HASH_KEY, definitions};

/// Limits of a segment: message bytes and rows.
const SEGMENT_BYTES: u64 = 1 << 20;
const SEGMENT_ROWS: usize = 1024;
/// Limit of topics, because channel ids have 16 bits.
const TOPICS_LIMIT: usize = 60_000;

/// A row of the table `topics`.
struct Topic {
    id: i64,
    name: String,
    type_name: String,
    serialization_format: String,
    qos_yaml: String,
    type_hash: String,
}

#[derive(Debug)]
pub(super) struct Rows {
    connection: Connection,
    /// Channel id (from 1) of each topic id.
    channels: HashMap<i64, u16>,
}

impl Rows {
    /// Opens the file for reading.
    pub fn open(stored: &StoredFile) -> Result<Self, BagError> {
        let wrong = |error: rusqlite::Error| BagError::Sqlite {
            path: stored.path.clone(),
            reason: error.to_string(),
        };
        let connection = connect(stored).map_err(wrong)?;
        let topics = read_topics(&connection).map_err(wrong)?;
        if topics.len() > TOPICS_LIMIT {
            return Err(BagError::Sqlite {
                path: stored.path.clone(),
                reason: format!(
                    "expected at most {TOPICS_LIMIT} topics, got {}",
                    topics.len()
                ),
            });
        }
        let channels = topics
            .iter()
            .zip(1..)
            .map(|(topic, number)| (topic.id, number));
        Ok(Self {
            channels: channels.collect(),
            connection,
        })
    }

    /// The messages of these rows, in the order of their ids.
    pub fn read(&self, first: i64, last: i64) -> Result<Vec<(MessageHeader, Bytes)>, String> {
        let read = || -> rusqlite::Result<Vec<(MessageHeader, Bytes)>> {
            let mut statement = self.connection.prepare(
                "SELECT id, topic_id, timestamp, data FROM messages WHERE id BETWEEN ?1 AND ?2 ORDER BY id",
            )?;
            let mut rows = statement.query([first, last])?;
            let mut messages = Vec::new();
            while let Some(row) = rows.next()? {
                // The index reports rows without a time or data.
                let (Some(log_time), Some(data)) = (log_time_ns(row)?, data(row)?) else {
                    continue;
                };
                let header = MessageHeader {
                    // 0 is the id of no channel: rows of unknown topics are reported as undefined.
                    channel_id: self.channels.get(&row.get(1)?).copied().unwrap_or(0),
                    // Wraps: sequence numbers of MCAP have 32 bits.
                    sequence: row.get::<_, i64>(0)? as u32,
                    log_time,
                    publish_time: log_time,
                };
                messages.push((header, Bytes::copy_from_slice(data)));
            }
            Ok(messages)
        };
        read().map_err(|error| error.to_string())
    }
}

fn connect(stored: &StoredFile) -> rusqlite::Result<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY
        | OpenFlags::SQLITE_OPEN_URI
        | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let connection = match stored.copy() {
        // The temporary copy may change: sqlite3 applies the journal.
        Some(copy) if stored.has_journal() => {
            let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
            Connection::open_with_flags(copy, flags)?
        }
        copy => Connection::open_with_flags(uri(copy.unwrap_or(&stored.path)), flags)?,
    };
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true)?;
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false)?;
    connection.set_limit(
        rusqlite::limits::Limit::SQLITE_LIMIT_LENGTH,
        // Fits: 2^28.
        MAX_RECORD_BYTES as i32,
    )?;
    Ok(connection)
}

/// The URI of an immutable file.
fn uri(path: &Path) -> String {
    let plain = |byte: &u8| byte.is_ascii_alphanumeric() || b"/._-".contains(byte);
    // Two slashes at the front would start a host.
    let path: PathBuf = path.components().collect();
    let bytes = path.as_os_str().as_bytes().iter();
    let text: String = bytes
        .map(|byte| match plain(byte) {
            true => char::from(*byte).to_string(),
            false => format!("%{byte:02x}"),
        })
        .collect();
    format!("file:{text}?immutable=1")
}

/// The columns of a table; empty if it does not exist. Views are ignored, since they could compute anything.
fn column_names(connection: &Connection, table: &str) -> rusqlite::Result<BTreeSet<String>> {
    let is_table: i64 = connection.query_row(
        "SELECT count(*) FROM sqlite_schema WHERE type = 'table' AND name = ?1 AND sql LIKE 'CREATE TABLE%'",
        [table],
        |row| row.get(0),
    )?;
    if is_table == 0 {
        return Ok(BTreeSet::new());
    }
    let mut statement = connection.prepare("SELECT name FROM pragma_table_info(?1)")?;
    let names = statement.query_map([table], |row| row.get(0))?;
    names.collect()
}

fn read_topics(connection: &Connection) -> rusqlite::Result<Vec<Topic>> {
    let has = column_names(connection, "topics")?;
    // Older versions lack these columns.
    let optional = |name: &'static str| if has.contains(name) { name } else { "NULL" };
    let query = format!(
        "SELECT id, name, type, serialization_format, {}, {} FROM topics ORDER BY id",
        optional("offered_qos_profiles"),
        optional("type_description_hash"),
    );
    let mut statement = connection.prepare(&query)?;
    let topics = statement.query_map([], |row| {
        let text = |column| -> rusqlite::Result<String> {
            // NULL, as in columns that older versions lack.
            Ok(row.get::<_, Option<String>>(column)?.unwrap_or_default())
        };
        Ok(Topic {
            id: row.get(0)?,
            name: text(1)?,
            type_name: text(2)?,
            serialization_format: text(3)?,
            qos_yaml: text(4)?,
            type_hash: text(5)?,
        })
    })?;
    topics.collect()
}

/// The definitions in the file, by type.
fn read_definitions(connection: &Connection) -> rusqlite::Result<BTreeMap<String, Schema>> {
    if column_names(connection, "message_definitions")?.is_empty() {
        return Ok(BTreeMap::new());
    }
    let mut statement = connection.prepare(
        "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions",
    )?;
    let definitions = statement.query_map([], |row| {
        let encoding: String = row.get(1)?;
        let schema = Schema {
            encoding: SchemaEncoding::from(encoding.as_str()),
            text: row.get(2)?,
        };
        Ok((row.get(0)?, schema))
    })?;
    let mut definitions: BTreeMap<String, Schema> = definitions.collect::<Result<_, _>>()?;
    definitions.retain(|_, schema| !schema.text.trim().is_empty());
    Ok(definitions)
}

/// The time of a row; `None` if it is missing or negative.
fn log_time_ns(row: &Row<'_>) -> rusqlite::Result<Option<u64>> {
    let time: Option<i64> = row.get(2)?;
    Ok(time.and_then(|time| u64::try_from(time).ok()))
}

fn data<'a>(row: &'a Row<'_>) -> rusqlite::Result<Option<&'a [u8]>> {
    Ok(match row.get_ref(3)? {
        ValueRef::Blob(data) => Some(data),
        _ => None,
    })
}

/// Indexes a file by one pass over its rows without their data.
pub(super) fn index(
    stored: &StoredFile,
    size_bytes: u64,
) -> Result<(FileIndex, Vec<BagWarning>), BagError> {
    let rows = Rows::open(stored)?;
    let mut index = FileIndex::empty(stored, size_bytes, "sqlite3");
    let mut warnings = Vec::new();
    let wrong = |error: rusqlite::Error| BagError::Sqlite {
        path: stored.path.clone(),
        reason: error.to_string(),
    };
    if column_names(&rows.connection, "messages")
        .map_err(wrong)?
        .is_empty()
    {
        return Err(BagError::NotABag {
            path: stored.path.clone(),
            reason: "it is an sqlite3 file without a table of messages".to_owned(),
        });
    }
    add_channels(&rows, &read_first_messages(&rows), &mut index).map_err(wrong)?;
    index_rows(&rows, &mut index, &mut warnings);
    Ok((index, warnings))
}

/// The first message of each channel, if readable.
fn read_first_messages(rows: &Rows) -> HashMap<u16, Bytes> {
    let ids = || -> rusqlite::Result<Vec<(i64, i64)>> {
        let query = "SELECT topic_id, min(id) FROM messages GROUP BY topic_id";
        let mut statement = rows.connection.prepare(query)?;
        let ids = statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?;
        ids.collect()
    };
    // Read errors are reported by `index_rows`.
    let mut first = HashMap::new();
    for (topic, id) in ids().into_iter().flatten() {
        if let (Some(channel), Ok(mut messages)) = (rows.channels.get(&topic), rows.read(id, id))
            && let Some((_, data)) = messages.pop()
        {
            first.insert(*channel, data);
        }
    }
    first
}

/// A segment to which rows are still added.
struct OpenSegment {
    segment: Segment,
    channels: BTreeSet<u16>,
    rows: usize,
    bytes: u64,
}

impl From<OpenSegment> for Segment {
    fn from(open: OpenSegment) -> Self {
        let channels = Some(open.channels.into_iter().collect());
        Self {
            channels,
            ..open.segment
        }
    }
}

/// Finds the segments and counts the messages.
fn index_rows(rows: &Rows, index: &mut FileIndex, warnings: &mut Vec<BagWarning>) {
    let mut unusable = (0_u64, 0_i64);
    let mut open: Option<OpenSegment> = None;
    let mut read = || -> rusqlite::Result<()> {
        let mut statement = rows.connection.prepare(
            "SELECT id, topic_id, timestamp, length(data), typeof(data) FROM messages ORDER BY id",
        )?;
        let mut found = statement.query([])?;
        while let Some(row) = found.next()? {
            let id: i64 = row.get(0)?;
            let (log_time, kind) = (log_time_ns(row)?, row.get::<_, String>(4)?);
            let (Some(log_time_ns), "blob") = (log_time, kind.as_str()) else {
                unusable.0 += 1;
                unusable.1 = id;
                continue;
            };
            // Lengths are never negative.
            let bytes = u64::try_from(row.get::<_, i64>(3)?).unwrap_or(0);
            let channel = rows.channels.get(&row.get(1)?).copied().unwrap_or(0);
            index.count(channel, log_time_ns);
            match &mut open {
                Some(open) if open.rows < SEGMENT_ROWS && open.bytes + bytes <= SEGMENT_BYTES => {
                    if let SegmentPlace::Rows { last, .. } = &mut open.segment.place {
                        *last = id;
                    }
                    open.segment.start_ns = open.segment.start_ns.min(log_time_ns);
                    open.segment.end_ns = open.segment.end_ns.max(log_time_ns);
                    open.channels.insert(channel);
                    open.rows += 1;
                    open.bytes += bytes;
                }
                full => {
                    let next = OpenSegment {
                        segment: Segment {
                            place: SegmentPlace::Rows {
                                first: id,
                                last: id,
                            },
                            start_ns: log_time_ns,
                            end_ns: log_time_ns,
                            channels: None,
                        },
                        channels: BTreeSet::from([channel]),
                        rows: 1,
                        bytes,
                    };
                    index.segments.extend(full.replace(next).map(Segment::from));
                }
            }
        }
        Ok(())
    };
    let damage = read().err().map(|error| error.to_string());
    index.segments.extend(open.map(Segment::from));
    let mut warn = |row: i64, reason: String| {
        warnings.push(BagWarning::Damaged {
            file: index.file.path.clone(),
            // Negative row ids are valid in sqlite3; warnings show 0.
            offset: u64::try_from(row).unwrap_or(0),
            reason,
        });
    };
    if let Some(reason) = damage {
        let last = index.segments.last().map(|segment| segment.place);
        let row = match last {
            Some(SegmentPlace::Rows { last, .. }) => last,
            _ => 0,
        };
        warn(
            row,
            format!("sqlite3 reads no further than row {row}: {reason}"),
        );
    }
    if let (count @ 1.., row) = unusable {
        warn(
            row,
            format!("{count} row(s) have no time or no message, the last is row {row}"),
        );
    }
}

fn add_channels(
    rows: &Rows,
    first: &HashMap<u16, Bytes>,
    index: &mut FileIndex,
) -> rusqlite::Result<()> {
    let definitions = read_definitions(&rows.connection)?;
    let prefixes = definitions::prefixes();
    for (topic, number) in read_topics(&rows.connection)?.into_iter().zip(1_u16..) {
        let schema = match definitions.get(&topic.type_name) {
            Some(schema) => schema.clone(),
            // Versions before 4 have no definitions: use the one of this machine, if it fits.
            None => definitions::definition(&topic.type_name, &prefixes)
                .filter(|schema| fits(schema, &topic.type_name, first.get(&number)))
                .unwrap_or_else(definitions::unknown),
        };
        let schema = mcap::Schema {
            id: number,
            name: topic.type_name,
            encoding: schema.encoding.as_str().to_owned(),
            data: schema.text.into_bytes().into(),
        };
        index.add_channel(&Arc::new(mcap::Channel {
            id: number,
            topic: topic.name,
            schema: Some(Arc::new(schema)),
            message_encoding: topic.serialization_format,
            metadata: BTreeMap::from([
                (QOS_KEY.to_owned(), topic.qos_yaml),
                (TYPE_HASH_KEY.to_owned(), topic.type_hash),
            ]),
        }));
    }
    Ok(())
}

/// Whether a message fits a definition; true without a message, or for fields of unknown layout.
fn fits(schema: &Schema, type_name: &str, message: Option<&Bytes>) -> bool {
    let Some(message) = message else {
        return true;
    };
    let message = match payload::decompress(message) {
        Some(Ok(plain)) => plain,
        Some(Err(_)) => return false,
        None => message.clone(),
    };
    match schema.description(type_name) {
        Ok(Some(description)) => {
            Layout::of(&description).map_or(true, |layout| layout.check(&message).is_ok())
        }
        _ => false,
    }
}
