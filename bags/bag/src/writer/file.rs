use std::{
    fs::File,
    io::BufWriter,
    path::PathBuf,
    time::{Duration, Instant},
};

use mcap::{Channel, records::MessageHeader, write::NoSeek};

use super::WriterOptions;
use crate::{BagError, metadata::sync_folder};

/// What the open chunk holds.
#[derive(Default)]
struct OpenChunk {
    /// Bytes of its messages.
    bytes: u64,
    /// Most bytes that it takes on the disk, its indexes included, if it does not compress.
    disk_bytes: u64,
    /// The first and the last log time, in ns.
    span: Option<(u64, u64)>,
}

/// What a message takes beside its bytes: opcode and length, its header, and its entry in the index.
const MESSAGE_OVERHEAD: u64 = 9 + 22 + 16;

/// One MCAP file of a bag, while it is written.
pub(super) struct BagFile {
    path: PathBuf,
    // `NoSeek`: the library then builds a chunk in memory and writes it in one go, so that a file never ends in a
    // chunk with an unfilled header.
    mcap: mcap::Writer<NoSeek<BufWriter<File>>>,
    /// The same file, to ask for its size.
    on_disk: File,
    /// Bytes on the disk at the last flush.
    flushed_bytes: u64,
    /// How often finished chunks are waited for to be on the disk, and when they last were.
    sync_interval: Option<Duration>,
    synced_at: Instant,
    /// Bytes that a power cut leaves.
    pub(super) synced_bytes: u64,
    /// Id in this file of each channel of the bag.
    ids: Vec<u16>,
    chunk: OpenChunk,
    /// The first and the last log time, in ns.
    span: Option<(u64, u64)>,
    message_count: u64,
}

/// A file that has been closed.
pub(super) struct WrittenFile {
    pub path: PathBuf,
    pub size_bytes: u64,
    /// The first and the last log time, in ns.
    pub span: Option<(u64, u64)>,
    pub message_count: u64,
}

impl BagFile {
    /// Begins a file that must not exist.
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
        // A process that is killed now leaves an MCAP file, not an empty one.
        file.flush()?;
        if file.sync_interval.is_some() {
            file.sync()?;
            // The file has to be found again, too.
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

    /// Adds the bag's next channel.
    pub fn add(&mut self, channel: &Channel<'_>) -> Result<(), BagError> {
        let schema_id = match &channel.schema {
            Some(schema) => self
                .mcap
                .add_schema(&schema.name, &schema.encoding, &schema.data)
                .map_err(|source| self.mcap_error(source))?,
            // MCAP's way to say that there is none.
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

    /// Whether the message of this time belongs in the next file.
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
        // What the open chunk takes is known once it is compressed.
        self.flush()?;
        Ok(self.flushed_bytes >= most)
    }

    /// Writes a message of the bag's channel of this number; its channel id is set here.
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
        self.span = Some(widened(self.span, header.log_time));
        let (start_ns, end_ns) = widened(self.chunk.span, header.log_time);
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

    /// Closes the open chunk and hands it to the operating system; waits for the disk where that is due.
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

    /// Waits until what was flushed is on the disk.
    fn sync(&mut self) -> Result<(), BagError> {
        let synced = self.on_disk.sync_data();
        synced.map_err(|source| BagError::io(&self.path, source))?;
        self.synced_bytes = self.flushed_bytes;
        // After the wait: a disk that is slower than the interval is not waited for all the time.
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

/// A span of time that takes in one more time.
fn widened(span: Option<(u64, u64)>, time_ns: u64) -> (u64, u64) {
    span.map_or((time_ns, time_ns), |(start, end)| {
        (start.min(time_ns), end.max(time_ns))
    })
}
