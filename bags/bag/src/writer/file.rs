use std::{
    fs::File,
    io::BufWriter,
    path::PathBuf,
    time::{Duration, Instant},
};

use mcap::{Channel, records::MessageHeader, write::NoSeek};

use super::WriterOptions;
use crate::{BagError, metadata::sync_folder};

/// Contents of the open chunk.
#[derive(Default)]
struct OpenChunk {
    /// Message bytes.
    bytes: u64,
    /// Upper bound of its size on the disk, with indexes \[bytes\].
    disk_bytes: u64,
    /// First and last log time \[ns\].
    span: Option<(u64, u64)>,
}

/// Overhead of a message: opcode and length, header, index entry \[bytes\].
const MESSAGE_OVERHEAD: u64 = 9 + 22 + 16;

/// An MCAP file during writing.
pub(super) struct BagFile {
    path: PathBuf,
    // `NoSeek`: the library builds a chunk in memory and writes it at once, so that a file never ends with an unfilled chunk
    // header.
    mcap: mcap::Writer<NoSeek<BufWriter<File>>>,
    /// The same file, to query its size.
    on_disk: File,
    /// File size at the last flush \[bytes\].
    flushed_bytes: u64,
    /// Interval and time of the last sync to the disk.
    sync_interval: Option<Duration>,
    synced_at: Instant,
    /// File size at the last sync \[bytes\].
    pub(super) synced_bytes: u64,
    /// Channel id in this file, by channel index.
    ids: Vec<u16>,
    chunk: OpenChunk,
    /// First and last log time \[ns\].
    span: Option<(u64, u64)>,
    message_count: u64,
}

pub(super) struct WrittenFile {
    pub path: PathBuf,
    pub size_bytes: u64,
    /// First and last log time \[ns\].
    pub span: Option<(u64, u64)>,
    pub message_count: u64,
}

impl BagFile {
    /// Creates a file that must not exist.
    pub fn create(path: PathBuf, options: &WriterOptions) -> Result<Self, BagError> {
        let io = |source| BagError::io(&path, source);
        let stream = File::create_new(&path).map_err(io)?;
        let on_disk = stream.try_clone().map_err(io)?;
        let mcap = options
            .mcap()
            .create(NoSeek::new(BufWriter::new(stream)))
            .map_err(|source| BagError::Mcap {
                path: path.clone(),
                reason: source,
            })?;
        let mut file = Self {
            path,
            mcap,
            on_disk,
            flushed_bytes: 0,
            sync_interval: options.sync_interval,
            synced_at: Instant::now(),
            synced_bytes: 0,
            ids: Vec::new(),
            chunk: OpenChunk::default(),
            span: None,
            message_count: 0,
        };
        // Even if the process is killed now, the file is valid MCAP.
        file.flush()?;
        if file.sync_interval.is_some() {
            file.sync()?;
            // The folder entry must reach the disk too.
            file.path.parent().map_or(Ok(()), sync_folder)?;
        }
        Ok(file)
    }

    fn mcap_error(&self, source: mcap::McapError) -> BagError {
        BagError::Mcap {
            path: self.path.clone(),
            reason: source,
        }
    }

    /// Adds the next channel of the bag.
    pub fn add(&mut self, channel: &Channel<'_>) -> Result<(), BagError> {
        let schema_id = match &channel.schema {
            Some(schema) => self
                .mcap
                .add_schema(&schema.name, &schema.encoding, &schema.data)
                .map_err(|source| self.mcap_error(source))?,
            // In MCAP, 0 means no schema.
            None => 0,
        };
        let id = self
            .mcap
            .add_channel(
                schema_id,
                &channel.topic,
                &channel.message_encoding,
                &channel.metadata,
            )
            .map_err(|source| self.mcap_error(source))?;
        self.ids.push(id);
        Ok(())
    }

    /// Whether the message with this log time belongs to the next file.
    pub fn is_full(&mut self, log_time_ns: u64, options: &WriterOptions) -> Result<bool, BagError> {
        let Some((start_ns, _)) = self.span else {
            return Ok(false);
        };
        let passed = Duration::from_nanos(log_time_ns.saturating_sub(start_ns));
        if options.max_file_duration.is_some_and(|most| passed > most) {
            return Ok(true);
        }
        let Some(most) = options.max_file_bytes else {
            return Ok(false);
        };
        if self.flushed_bytes + self.chunk.disk_bytes < most {
            return Ok(false);
        }
        // The size of the open chunk is known once it is compressed.
        self.flush()?;
        Ok(self.flushed_bytes >= most)
    }

    /// Writes a message to the channel with this index; sets the channel id.
    pub fn write(
        &mut self,
        channel: usize,
        mut header: MessageHeader,
        data: &[u8],
        options: &WriterOptions,
    ) -> Result<(), BagError> {
        if let Some(id) = self.ids.get(channel) {
            header.channel_id = *id;
        }
        self.mcap
            .write_to_known_channel(&header, data)
            .map_err(|source| self.mcap_error(source))?;
        self.message_count += 1;
        self.span = Some(extend_span(self.span, header.log_time));
        let (start_ns, end_ns) = extend_span(self.chunk.span, header.log_time);
        self.chunk.span = Some((start_ns, end_ns));
        self.chunk.bytes += data.len() as u64;
        self.chunk.disk_bytes += data.len() as u64 + MESSAGE_OVERHEAD;
        let spans_enough = options
            .chunk_duration
            .is_some_and(|most| Duration::from_nanos(end_ns - start_ns) >= most);
        if self.chunk.bytes >= options.chunk_bytes() || spans_enough {
            self.flush()?;
        }
        Ok(())
    }

    /// Closes the open chunk and passes it to the operating system; syncs it to the disk if the interval has passed.
    pub fn flush(&mut self) -> Result<(), BagError> {
        self.chunk = OpenChunk::default();
        self.mcap
            .flush()
            .map_err(|source| self.mcap_error(source))?;
        self.flushed_bytes = self.size_bytes()?;
        let is_due = |interval| self.synced_at.elapsed() >= interval;
        if self.sync_interval.is_some_and(is_due) && self.synced_bytes < self.flushed_bytes {
            self.sync()?;
        }
        Ok(())
    }

    /// Waits until flushed data is on the disk.
    fn sync(&mut self) -> Result<(), BagError> {
        let synced = self.on_disk.sync_data();
        synced.map_err(|source| BagError::io(&self.path, source))?;
        self.synced_bytes = self.flushed_bytes;
        // Measured after the wait, so that a slow disk is not synced all the time.
        self.synced_at = Instant::now();
        Ok(())
    }

    fn size_bytes(&self) -> Result<u64, BagError> {
        let found = self.on_disk.metadata();
        Ok(found
            .map_err(|source| BagError::io(&self.path, source))?
            .len())
    }

    /// Writes the last chunk and the summary, and waits until the file is on the disk.
    pub fn finish(mut self) -> Result<WrittenFile, BagError> {
        if let Err(source) = self.mcap.finish() {
            return Err(self.mcap_error(source));
        }
        let io = |source| BagError::io(&self.path, source);
        let stream = self
            .mcap
            .into_inner()
            .into_inner()
            .into_inner()
            .map_err(|error| io(error.into_error()))?;
        stream.sync_all().map_err(io)?;
        let size_bytes = stream.metadata().map_err(io)?.len();
        Ok(WrittenFile {
            path: self.path,
            size_bytes,
            span: self.span,
            message_count: self.message_count,
        })
    }
}

fn extend_span(span: Option<(u64, u64)>, time_ns: u64) -> (u64, u64) {
    span.map_or((time_ns, time_ns), |(start, end)| {
        (start.min(time_ns), end.max(time_ns))
    })
}
